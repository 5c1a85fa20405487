"""What reads files of others, each with sound files and with damage to them.

Half of what carries a hash gets a fitting one, as from a foreign program, so that what is behind the hash is reached.
"""

import json
import pickle
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import numpy as np
from bundles import SPEC, new_weights
from safetensors.numpy import save

from agents import tensor_file
from agents.learners.ppo import PpoConfig
from agents.policy.bundle import POLICY_FILE, read_bundle, save_bundle
from agents.runs.checkpoint import RunFolder
from agents.tensor_file import unpacked
from baselines.tools.files import sealed
from eval.comparison.schema import read_results
from tests.stress import damage

_RESULTS = Path(__file__).resolve().parents[2] / "docs" / "results" / "comparison" / "results.json"
Damaged = tuple[dict[str, bytes], bool]
"""Files by name, and whether they may mean something else than the sound ones: their hashes fit, or they have none."""


class Reader(NamedTuple):
    read: damage.Read  # what the files mean
    damaged: Callable[[Random], Damaged]


def _of_json(
    read: Callable[[], object], path: Path, content: Any, rehash: Callable[[Any], object] | None = None
) -> Reader:
    """Reader of a file of JSON, whose hash `rehash` makes fit, if it has one."""
    path.write_text(json.dumps(content))

    def damaged(rng: Random) -> Damaged:
        written, fits = content, rehash is None
        if rng.random() < 0.75:
            written = damage.damaged_content(rng, content)
            if rehash is not None and rng.random() < 0.7:
                rehash(written)
                fits = True
        text = json.dumps(written).encode()
        return {path.name: text if rng.random() < 0.7 else damage.damaged_text(rng, text, path.parent)}, fits

    return Reader(read, damaged)


def _policy(folder: Path) -> Reader:
    origin = {"command": "x", "run": {"steps": 3, "seconds": 1.0}, "curve": [[0, 1.0, 2.0]], "config": {"seed": 1}}
    save_bundle(folder, replace(SPEC, provenance=origin), new_weights())
    path = folder / POLICY_FILE
    data = path.read_bytes()
    content, tensors = unpacked(data, "policy")

    def damaged(rng: Random) -> Damaged:
        if rng.random() < 0.5:
            return {POLICY_FILE: damage.damaged_weights(rng, data, folder)}, False
        description, fits = damage.damaged_content(rng, content), rng.random() < 0.7
        if fits:
            description["sha256"] = tensor_file.digest_of(description, tensors)
        return {POLICY_FILE: save(tensors, metadata={"policy": json.dumps(description)})}, fits

    def read() -> object:
        weights, _, description, _ = read_bundle(folder)
        return description, {name: array.tolist() for name, array in weights.arrays.items()}

    return Reader(read, damaged)


def _run(folder: Path) -> tuple[RunFolder, PpoConfig]:
    """Folder of a run that has only begun, and options to resume it."""
    config, run = PpoConfig(out=folder, resume=True), RunFolder(folder)
    run.note(config)
    run.save({"weights": np.arange(100.0)}, {"curve": [{"steps": 0, "cost": 1.0}], "scores": "", "best_cost": 1.0})
    return run, config


def _checkpoint(folder: Path) -> Reader:
    run, _ = _run(folder)
    data = run.checkpoint.read_bytes()

    def damaged(rng: Random) -> Damaged:
        if rng.random() < 0.5:
            return {run.checkpoint.name: damage.damaged_bytes(rng, data, folder)}, False
        content = damage.damaged_content(rng, pickle.loads(data))
        return {run.checkpoint.name: sealed(pickle.dumps(content))}, True

    return Reader(lambda: run.load(lambda state: state["weights"].sum()), damaged)


def _results(folder: Path) -> Reader:
    content, path = json.loads(_RESULTS.read_text()), folder / "results.json"
    for part in ("rows", "paired", "primary"):
        content[part] = content[part][:2]
    return _of_json(partial(read_results, path), path, content)


_ALL = (_policy, _checkpoint, _results)
READERS: dict[str, Callable[[Path], Reader]] = {make.__name__[1:]: make for make in _ALL}
"""Makes sound files in an empty folder, and what reads them."""
