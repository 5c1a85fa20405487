"""Residuals and policy bundles that are refused, and loading them, which executes nothing."""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
import pickle
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from refusals import refused
from safetensors.torch import load_file
from safetensors.torch import save as save_tensors

import agents.policy.bundle
from agents.policy.actor import Actor
from agents.policy.bundle import (
    FORMAT,
    MANIFEST,
    MAX_BYTES,
    VERSION,
    BundleError,
    BundleSpec,
    load_controller,
    read_spec,
    save_bundle,
)
from agents.policy.weights import MAX_LAYERS, MAX_WIDTH, Weights
from agents.residual.bases import settings_hash
from agents.residual.controller import ResidualController, ResidualSettings
from agents.residual.env import ResidualEnv, ResidualVecEnv
from baselines import CONTROLLERS
from beltarm_env import BeltArmEnv, BeltArmVectorEnv, observation
from beltarm_env.observation import ENTRIES

NAN, INF = math.nan, math.inf


# Residuals


@pytest.mark.parametrize("value", [0, -0.1, 2.1, NAN, INF, "0.5", None, True], ids=repr)
def test_residual_limit(value: Any):
    words = ("limit", repr(value), "(0, 2]")
    refused((ValueError, TypeError), words, lambda: ResidualSettings(limit=value))


@pytest.mark.parametrize("value", [0, -1, 101, 4.0, "4", None, True], ids=repr)
def test_residual_hold(value: Any):
    words = ("hold", repr(value), "whole", "1 to 100")
    refused((ValueError, TypeError), words, lambda: ResidualSettings(hold=value))


@pytest.mark.parametrize("mode", ["NextStep", "Disabled"])
def test_residual_batch_needs_same_step_reset(mode: str):
    envs = BeltArmVectorEnv(2, autoreset_mode=mode)
    words = (repr(mode), "SameStep")
    refused(ValueError, words, lambda: ResidualVecEnv(envs, CONTROLLERS["paper"](), ResidualSettings()))


def test_residual_of_another_environment():
    with pytest.raises((TypeError, ValueError), match="BeltArm"):
        ResidualEnv(gym.make("CartPole-v1"), CONTROLLERS["paper"](), ResidualSettings())


@pytest.mark.parametrize("residual", [[NAN], [INF], [0.1, 0.2], "0.5", []], ids=repr)
def test_bad_residuals(residual: Any):
    env = ResidualEnv(BeltArmEnv(), CONTROLLERS["paper"](), ResidualSettings())
    refused(ResetNeeded, ("reset()",), lambda: env.step(np.zeros(1, np.float32)))
    env.reset(seed=0)
    with pytest.raises(ValueError):
        env.step(residual)


@pytest.mark.parametrize("shape", [(3,), (1, 1), (2, 1), (3, 2), ()], ids=str)
def test_residuals_of_another_shape(shape: tuple[int, ...]):
    envs = ResidualVecEnv(
        BeltArmVectorEnv(3, autoreset_mode="SameStep"), CONTROLLERS["paper"](), ResidualSettings(), stagger=False
    )
    envs.reset()
    refused(ValueError, (str(shape), "(3, 1)"), lambda: envs.step(np.zeros(shape, np.float32)))


def test_residuals_that_are_not_finite():
    envs = ResidualVecEnv(
        BeltArmVectorEnv(2, autoreset_mode="SameStep"), CONTROLLERS["paper"](), ResidualSettings(), stagger=False
    )
    envs.reset()
    refused(ValueError, ("nan", "finite"), lambda: envs.step(np.array([[0.0], [NAN]], np.float32)))


# Policy bundles


SPEC = BundleSpec("ppo", "paper", ResidualSettings(), (4, 3), provenance={"seed": 1})


def new_weights(spec: BundleSpec = SPEC) -> Weights:
    return Actor(spec.shape()).weights()


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    folder = tmp_path / "policy"
    save_bundle(folder, SPEC, new_weights())
    load_controller(folder)
    return folder


def weights(bundle: Path) -> Path:
    (path,) = bundle.glob("*.safetensors")
    return path


def edit(bundle: Path, *, rehash: bool, **changes: Any) -> None:
    """Change the manifest, with a fitting content hash (a foreign program's) or without (a hand's)."""
    content = json.loads((bundle / MANIFEST).read_text())
    content.update(changes)
    if rehash:
        content["content_hash"] = agents.policy.bundle.content_hash(content)
    (bundle / MANIFEST).write_text(json.dumps(content))


def drop(bundle: Path, key: str) -> None:
    content = json.loads((bundle / MANIFEST).read_text())
    del content[key]
    content["content_hash"] = agents.policy.bundle.content_hash(content)
    (bundle / MANIFEST).write_text(json.dumps(content))


def flip_a_bit(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(data)


def foreign_weights(bundle: Path) -> None:
    """Weights of another network, with fitting hashes."""
    other, spec = bundle.parent / "other", BundleSpec("ppo", "paper", ResidualSettings(), (5,))
    save_bundle(other, spec, new_weights(spec))
    manifest = json.loads((other / MANIFEST).read_text())
    shutil.copy(weights(other), bundle)
    edit(bundle, rehash=True, weights=manifest["weights"])


def not_weights(bundle: Path, data: bytes) -> None:
    (bundle / "weights-x.safetensors").write_bytes(data)
    edit(bundle, rehash=True, weights={"file": "weights-x.safetensors", "sha256": hashlib.sha256(data).hexdigest()})


def name_weights(bundle: Path, name: object) -> None:
    manifest = json.loads((bundle / MANIFEST).read_text())
    edit(bundle, rehash=True, weights={**manifest["weights"], "file": name})


class Exploit:
    """Its pickle, loaded, creates a file."""

    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> Any:
        return (Path.touch, (self.target,))


def nan_weights(bundle: Path) -> None:
    """Weights with a NaN, and fitting hashes."""
    tensors = load_file(weights(bundle))
    next(iter(tensors.values())).view(-1)[0] = NAN
    not_weights(bundle, save_tensors(tensors))


def double_weights(bundle: Path) -> None:
    not_weights(bundle, save_tensors({name: value.double() for name, value in load_file(weights(bundle)).items()}))


def four_bit_weights(bundle: Path) -> None:
    """Weights in a type of the format's that PyTorch does not have."""
    header = json.dumps({"layers.0.weight": {"dtype": "F4", "shape": [2], "data_offsets": [0, 1]}}).encode()
    not_weights(bundle, len(header).to_bytes(8, "little") + header + b"\0")


def other_gains(bundle: Path) -> None:
    settings = json.loads((bundle / MANIFEST).read_text())["base_settings"]
    settings["gains"]["angle"] += 1
    edit(bundle, rehash=True, base_settings=settings, base_hash=settings_hash(settings))


def other_doubts(bundle: Path) -> None:
    settings = json.loads((bundle / MANIFEST).read_text())["base_settings"]
    settings["doubts"]["swing"] = 0.5
    edit(bundle, rehash=True, base_settings=settings, base_hash=settings_hash(settings))


def change_entry(bundle: Path, field: int, value: object) -> None:
    entries = json.loads((bundle / MANIFEST).read_text())["entries"]
    entries[0][field] = value
    edit(bundle, rehash=True, entries=entries)


def add_entry(bundle: Path, entry: Sequence[Any]) -> None:
    entries = json.loads((bundle / MANIFEST).read_text())["entries"]
    edit(bundle, rehash=True, entries=[*entries, list(entry)])


DAMAGES: dict[str, tuple[Callable[[Path], Any], tuple[str, ...]]] = {
    "no folder": (shutil.rmtree, ("no policy bundle", MANIFEST)),
    "no manifest": (lambda b: (b / MANIFEST).unlink(), ("no policy bundle", MANIFEST)),
    "manifest is a folder": (
        lambda b: ((b / MANIFEST).unlink(), (b / MANIFEST).mkdir()),
        (MANIFEST, "cannot be read"),
    ),
    "manifest is a device": (
        lambda b: ((b / MANIFEST).unlink(), (b / MANIFEST).symlink_to(os.devnull)),
        (MANIFEST, "cannot be read", "no regular file"),
    ),
    "manifest is a pipe": (
        lambda b: ((b / MANIFEST).unlink(), os.mkfifo(b / MANIFEST)),
        (MANIFEST, "cannot be read", "no regular file"),
    ),
    "weights are a pipe": (
        lambda b: (path := weights(b), path.unlink(), os.mkfifo(path)),
        ("weights-", "cannot be read", "no regular file"),
    ),
    "weights are a device": (
        lambda b: (path := weights(b), path.unlink(), path.symlink_to("/dev/zero")),
        ("weights-", "cannot be read", "no regular file"),
    ),
    "empty manifest": (lambda b: (b / MANIFEST).write_text(""), (MANIFEST, "cannot be read")),
    "truncated manifest": (
        lambda b: (b / MANIFEST).write_text((b / MANIFEST).read_text()[:200]),
        (MANIFEST, "cannot be read"),
    ),
    "binary manifest": (lambda b: (b / MANIFEST).write_bytes(b"\xff\xfe\x00"), (MANIFEST, "cannot be read")),
    "a list": (lambda b: (b / MANIFEST).write_text("[1, 2]"), (MANIFEST, FORMAT)),
    "another program's file": (lambda b: (b / MANIFEST).write_text('{"format": "onnx"}'), (MANIFEST, FORMAT)),
    "newer version": (lambda b: edit(b, rehash=True, version=99), ("99", str(VERSION), "version")),
    "trained on another drive": (lambda b: edit(b, rehash=True, edition=1), (MANIFEST, "edition 1", "train it again")),
    "no version": (lambda b: drop(b, "version"), ("None", str(VERSION), "version")),
    "edited by hand": (lambda b: edit(b, rehash=False, base="rigid"), (MANIFEST, "changed", "hash")),
    "provenance edited": (lambda b: edit(b, rehash=False, provenance={}), (MANIFEST, "changed", "hash")),
    "weights named otherwise": (
        lambda b: edit(b, rehash=False, weights={"file": "x", "sha256": ""}),
        (MANIFEST, "changed", "hash"),
    ),
    "another algorithm": (lambda b: edit(b, rehash=True, algorithm="dqn"), (MANIFEST, "does not fit")),
    "another base": (lambda b: edit(b, rehash=True, base="lqr"), (MANIFEST, "does not fit")),
    "base of a wrong type": (lambda b: edit(b, rehash=True, base=["paper"]), (MANIFEST, "does not fit")),
    "another activation": (lambda b: edit(b, rehash=True, activation="gelu"), (MANIFEST, "does not fit")),
    "other sensors": (lambda b: add_entry(b, ENTRIES["tip"][-1]), (MANIFEST, "does not fit", "no", "'tip_speed'")),
    "unknown sensors": (lambda b: edit(b, rehash=True, sensors="sonar"), (MANIFEST, "does not fit", "sonar")),
    "entries that are words": (lambda b: edit(b, rehash=True, entries=["speed"]), (MANIFEST, "does not fit", "speed")),
    "no entries": (lambda b: edit(b, rehash=True, entries=[]), (MANIFEST, "does not fit", "at least one")),
    "an entry without a name": (lambda b: add_entry(b, [[], "-", 1.0, 1.0]), (MANIFEST, "does not fit", "[]")),
    "another layout version": (lambda b: edit(b, rehash=True, layout=99), (MANIFEST, "does not fit", "layout 99", "2")),
    "inputs of another scale": (
        lambda b: change_entry(b, 2, 3.0),
        (MANIFEST, "does not fit", "motor_angle_error", "3.0", "1.5"),
    ),
    "inputs of another unit": (lambda b: change_entry(b, 1, "deg"), (MANIFEST, "motor_angle_error", "deg", "rad")),
    "inputs of another bound": (lambda b: change_entry(b, 3, 5.0), (MANIFEST, "motor_angle_error", "5.0", "200.0")),
    "gains of the base": (other_gains, (MANIFEST, "'paper'", "gains.angle", "train it again")),
    "doubts of the identification": (other_doubts, (MANIFEST, "doubts.swing was 0.5", "train it again")),
    "no settings of the base": (
        lambda b: edit(b, rehash=True, base_settings=3, base_hash=""),
        ("base_settings must be an object",),
    ),
    "provenance of a wrong type": (lambda b: edit(b, rehash=True, provenance=[]), (MANIFEST, "does not fit")),
    "huge layers": (
        lambda b: edit(b, rehash=True, hidden=[10**9, 10**9]),
        (MANIFEST, "does not fit", str(MAX_WIDTH), str(10**9)),
    ),
    "very many layers": (
        lambda b: edit(b, rehash=True, hidden=[1] * 10**5),
        (MANIFEST, "does not fit", str(MAX_LAYERS), str(10**5)),
    ),
    "huge LSTM": (lambda b: edit(b, rehash=True, lstm=10**9), (MANIFEST, "does not fit", "LSTM", str(10**9))),
    "huge GRU": (lambda b: edit(b, rehash=True, gru=10**9), (MANIFEST, "does not fit", "GRU", str(10**9))),
    "two memories": (lambda b: edit(b, rehash=True, gru=4, lstm=4), (MANIFEST, "does not fit", "an LSTM or a GRU")),
    "a GRU that is not in the weights": (lambda b: edit(b, rehash=True, gru=4), ("weights-", "does not hold")),
    "an LSTM that is not in the weights": (lambda b: edit(b, rehash=True, lstm=4), ("weights-", "does not hold")),
    "weights in double precision": (double_weights, ("weights-x", "float64", "float32")),
    "weights of four bits": (four_bit_weights, ("weights-x", "does not hold")),
    "weights of NaN": (nan_weights, ("weights-x", "not finite")),
    "weights elsewhere": (lambda b: name_weights(b, "../elsewhere.safetensors"), ("../elsewhere", "beside it")),
    "weights at an absolute path": (lambda b: name_weights(b, "/etc/passwd"), ("/etc/passwd", "beside it")),
    "weights named by a number": (lambda b: name_weights(b, 7), ("weights: file must be a text", "7")),
    "weights with a NUL in their name": (lambda b: name_weights(b, "weights-\0.safetensors"), ("beside it",)),
    "huge manifest": (
        lambda b: (b / MANIFEST).write_text(" " * (MAX_BYTES + 1)),
        (MANIFEST, "cannot be read", str(MAX_BYTES)),
    ),
    "huge weights": (lambda b: os.truncate(weights(b), MAX_BYTES + 1), ("weights-", "cannot be read", str(MAX_BYTES))),
    "deeply nested manifest": (lambda b: (b / MANIFEST).write_text("[" * 10**5), (MANIFEST, "cannot be read")),
    "limit out of range": (
        lambda b: edit(b, rehash=True, residual={"limit": 5.0, "hold": 4, "knowledge": "belief"}),
        (MANIFEST, "does not fit", "5.0", "(0, 2]"),
    ),
    "unknown residual setting": (
        lambda b: edit(b, rehash=True, residual={"limit": 0.5, "hold": 4, "knowledge": "belief", "gain": 1.0}),
        (MANIFEST, "does not fit", "gain"),
    ),
    "no residual": (lambda b: drop(b, "residual"), (MANIFEST, "does not fit", "residual")),
    "no weights in the manifest": (lambda b: drop(b, "weights"), (MANIFEST, "weights")),
    "layers that are words": (lambda b: edit(b, rehash=True, hidden=["wide"]), (MANIFEST, "does not fit", "wide")),
    "layers that are one number": (lambda b: edit(b, rehash=True, hidden=64), (MANIFEST, "does not fit")),
    "negative layers": (lambda b: edit(b, rehash=True, hidden=[-4]), (MANIFEST, "does not fit", "-4")),
    "other layers": (lambda b: edit(b, rehash=True, hidden=[8, 8]), ("weights-", MANIFEST)),
    "no weights": (lambda b: weights(b).unlink(), ("weights-", "cannot be read")),
    "truncated weights": (lambda b: os.truncate(weights(b), 100), ("weights-", "damaged", "SHA-256")),
    "one bit of the weights": (lambda b: flip_a_bit(weights(b)), ("weights-", "damaged", "SHA-256")),
    "weights that are none": (lambda b: not_weights(b, b"\x80\x04pickled"), ("weights-x", "does not hold")),
    "empty weights": (lambda b: not_weights(b, b""), ("weights-x", "does not hold")),
    "weights of another network": (foreign_weights, ("weights-", "does not hold")),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_bundles(bundle: Path, damage: str):
    break_it, words = DAMAGES[damage]
    break_it(bundle)
    refused(BundleError, words, lambda: load_controller(bundle))


PLACES = {
    "edition": (True, 2.5),
    "layout": ("2", None, [2]),
    "algorithm": ({}, ["ppo"], None, 1),
    "base": ({"paper": 1}, None),
    "residual": ([], "belief", None, {"limit": NAN}, {"hold": 10**400}, {"knowledge": ["belief"]}, {"limit": 0.5}),
    "hidden": (None, "44", [[4]], [4.5], {"4": 3}, [NAN]),
    "activation": ([], {}, 3),
    "sensors": ([], {}, None),
    "lstm": ("0", None, NAN, [0]),
    "gru": ("0", None, INF, {}),
    "standardised": (0, "yes", None),
    "base_settings": ({"gains": 3}, {"gains": {"a\nb": 1.0}}, {"doubts": {"swing": "0.5"}}, {"gains": {"angle": NAN}}),
    "base_hash": (3, []),
    "entries": (None, "speed", [3], [["motor_angle_error"]], [{}], {"a": 1}),
    "weights": (None, [], "weights-x.safetensors", {"file": []}, {"file": "weights-x.safetensors", "sha256": 3}),
    "provenance": (
        *(None, "none", {"run": 3}, {"run": []}, {"run": {"steps": "5"}}, {"run": {"steps": NAN}}, {"seed": NAN}),
        *(
            {"run": {"seconds": INF}},
            {"run": {"steps": 10**400}},
            {"config": 3},
            {"config": {"seed": [1]}},
            {"note": INF},
        ),
        *(
            {"config": {"randomization": []}},
            {"versions": 3},
            {"versions": {"numpy": 2}},
            {"command": 3},
            {"commit": {}},
        ),
        *({"curve": 3}, {"curve": [3]}, {"curve": [[1, 2]]}, {"curve": [["a", "b", "c"]]}, {"validation_of_base": [1]}),
        *({"reached": 3}, {"reached": {"validation": {"cost": 1.0}}}, {"command": "\ud800"}),
    ),
}


@pytest.mark.parametrize("place", PLACES)
def test_manifests_that_are_not_as_they_should_be(place: str, bundle: Path):
    """In one line, before anything reads them: not as a traceback, and not by numbers that JSON does not have."""
    for value in PLACES[place]:
        edit(bundle, rehash=True, **{place: value})
        with pytest.raises(BundleError, match=MANIFEST) as caught:
            read_spec(bundle)
        assert "\n" not in str(caught.value), value


MOST = 10**15


@pytest.mark.parametrize(
    ("provenance", "allowed"),
    [
        ({"run": {"steps": MOST, "seconds": MOST}}, True),
        ({"run": {"steps": 0, "seconds": 0.0}}, True),
        ({"run": {"steps": MOST + 1}}, False),
        ({"run": {"seconds": MOST + 1}}, False),
        ({"run": {"steps": -1}}, False),
        ({"run": {"seconds": -1e-9}}, False),
        ({"curve": [[0, 0.0, -1.5], [MOST, 1e15, 3]]}, True),
        ({"curve": [[0, 0.0]]}, False),
        ({"curve": [[0, 0.0, 1.0, 1.0]]}, False),
    ],
)
def test_how_far_a_training_may_have_gone(provenance: dict[str, Any], allowed: bool, bundle: Path):
    edit(bundle, rehash=True, provenance=provenance)
    if allowed:
        assert read_spec(bundle)[0].provenance == provenance
    else:
        refused(BundleError, (MANIFEST, "does not fit"), lambda: read_spec(bundle))


def test_a_manifest_of_a_megabyte_is_read_and_no_larger_one(bundle: Path):
    text = (bundle / MANIFEST).read_text()
    (bundle / MANIFEST).write_text(text.ljust(10**6))
    read_spec(bundle)
    (bundle / MANIFEST).write_text(text.ljust(10**6 + 1))
    refused(BundleError, (MANIFEST, "cannot be read"), lambda: read_spec(bundle))


def test_bundles_are_written_with_finite_numbers_alone(tmp_path: Path):
    spec = replace(SPEC, provenance={"curve": [[0, 1.0, NAN]]})
    refused(ValueError, ("not JSON compliant",), lambda: save_bundle(tmp_path, spec, new_weights()))


def test_what_a_machine_is_sent_of_a_bundle_is_the_bundle(bundle: Path):
    os.mkfifo(bundle / "more.json")
    assert list(agents.policy.bundle.bundle_files(bundle)) == [MANIFEST, weights(bundle).name]


def test_a_file_is_no_bundle(tmp_path: Path):
    (tmp_path / "policy.zip").write_bytes(b"PK")
    with pytest.raises(BundleError, match=r"policy\.zip"):
        load_controller(tmp_path / "policy.zip")


def test_loading_executes_nothing(bundle: Path):
    """Pickles in place of the weights and of the manifest are refused and not run."""
    target = bundle.parent / "executed"
    not_weights(bundle, pickle.dumps(Exploit(target)))
    refused(BundleError, ("weights-x", "does not hold"), lambda: load_controller(bundle))
    (bundle / MANIFEST).write_bytes(pickle.dumps(Exploit(target)))
    refused(BundleError, (MANIFEST, "cannot be read"), lambda: load_controller(bundle))
    assert not target.exists()
    pickle.loads(pickle.dumps(Exploit(target)))
    assert target.exists(), "the exploit should work where a pickle is loaded"


def test_policies_that_are_not_saved(bundle: Path):
    before = read_spec(bundle)
    broken = new_weights()
    next(iter(broken.arrays.values()))[:] = NAN
    refused(BundleError, ("not finite", "layers.0.weight"), lambda: save_bundle(bundle, SPEC, broken))
    wide = BundleSpec("ppo", "paper", ResidualSettings(), (600, 600))
    refused(ValueError, (str(MAX_BYTES), "smaller layers"), lambda: save_bundle(bundle, wide, new_weights(wide)))
    refused(ValueError, ("(600, 600)", "(4, 3)"), lambda: save_bundle(bundle, wide, new_weights()))
    assert read_spec(bundle) == before


@pytest.mark.parametrize("files_written", [0, 1])
def test_a_bundle_that_cannot_be_replaced_stays_valid(
    bundle: Path, monkeypatch: pytest.MonkeyPatch, files_written: int
):
    """The disk fills up at the weights, or between the weights and the manifest."""
    old = load_controller(bundle)
    seen = np.ones((2, observation.size()), np.float32)
    expected = old.predict(seen)[0]
    rename, calls = os.replace, []

    def replace_then_fail(*arguments: Any) -> None:
        calls.append(arguments)
        if len(calls) > files_written:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        rename(*arguments)

    monkeypatch.setattr(os, "replace", replace_then_fail)
    with pytest.raises(OSError, match="No space"):
        save_bundle(bundle, SPEC, new_weights())
    monkeypatch.undo()
    again = load_controller(bundle)
    assert isinstance(again, ResidualController)
    assert np.array_equal(again.predict(seen)[0], expected)
    assert not [name for name in os.listdir(bundle) if name.startswith(".")]
    save_bundle(bundle, SPEC, new_weights())
    assert len(os.listdir(bundle)) == 3
