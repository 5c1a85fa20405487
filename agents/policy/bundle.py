"""Policy bundles: a trained residual policy as a folder of three files, loaded without executing anything.

    policy.json                what the policy is and how it came about; names the weights and their SHA-256
    weights-XXXX.safetensors   of the network that acts: numbers, no code
    README.md                  the same as a card to read, see `agents.policy.card`

`policy.json` carries a hash of its own content (`agents.policy.manifest`), so that a bundle is either what was saved or
refused. Weights are written first, under a name of their own; replacing `policy.json` is the instant at which a bundle
is replaced.

`entries` in it names the policy's inputs, in order: they are picked by name from what the environment shows and the
agent is told, which may be more than when the policy was trained. What they mean goes with `observation.LAYOUT`.

A residual is worth something only on the base, and with the knowledge, that it was trained with: gains of the base and
doubts of the identification are part of a bundle, and where the checkout has others, it is refused. So it is where arm
and drive are of another `edition`.
"""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load as load_arrays
from safetensors.numpy import save as save_arrays

from agents.policy.card import CARD, MANIFEST, card
from agents.policy.inputs import SelectedInputs, chosen_names
from agents.policy.manifest import ALGORITHMS, FORMAT, MAX_BYTES, VERSION, BundleError, content_hash, read_manifest
from agents.policy.network import NetworkPolicy
from agents.policy.weights import ActorShape, Weights
from agents.residual.bases import base_settings, changed_settings, make_base, settings_hash
from agents.residual.controller import ResidualController, ResidualSettings
from agents.residual.knowledge import ENTRIES as TOLD
from baselines.tools.files import read_regular, write_atomically, write_text
from baselines.tools.schema import in_a_line
from beltarm_env.observation import ENTRIES, LAYOUT, Entry
from beltarm_env.task.ranges import EDITION

POLICIES = Path(__file__).resolve().parents[1] / "policies"
"""Folder of the shipped policies that see the encoder alone: METHOD/SEED, each a bundle."""
FELT_POLICIES = POLICIES.with_name("policies_accelerometer")
"""Folder of those that have an accelerometer, which are ranked with none of the others."""


@dataclass(frozen=True, slots=True)
class BundleSpec:
    """Description of a policy: all that its bundle holds besides weights."""

    algorithm: str  # see `ALGORITHMS`
    base: str  # name of the base controller, see `agents.residual.bases.BASES`
    residual: ResidualSettings
    hidden: tuple[int, ...]  # width of the hidden layers
    activation: str = "tanh"
    sensors: str = "encoder"
    lstm: int = 0  # width of the LSTM, 0 for none
    gru: int = 0  # width of the GRU, 0 for none
    standardised: bool = False  # whether the network standardises its inputs
    provenance: dict[str, Any] = field(default_factory=dict)  # how it was trained
    inputs: tuple[str, ...] | None = None  # names of the entries that the policy is given, in order; None for all

    def offered(self) -> tuple[Entry, ...]:
        """All entries that a policy with these sensors and this knowledge can be given."""
        return (*ENTRIES[self.sensors], *TOLD[self.residual.knowledge])

    def entries(self) -> list[list[Any]]:
        """Name, unit, scale and bound of the policy's inputs, in order."""
        by_name = {entry.name: list(entry) for entry in self.offered()}
        return [by_name[name] for name in (by_name if self.inputs is None else self.inputs)]

    def shape(self) -> ActorShape:
        """Layers of the policy's network.

        Raises:
            ValueError: If they are not of a size that is allowed.
        """
        squashed = ALGORITHMS[self.algorithm]
        hidden, inputs = tuple(self.hidden), len(self.entries())
        return ActorShape(inputs, hidden, self.activation, squashed, self.lstm, self.gru, self.standardised)


def save_bundle(folder: Path, spec: BundleSpec, weights: Weights) -> str:
    """Write a bundle; one at the same place is replaced.

    Returns:
        Its content hash.

    Raises:
        ValueError: If the weights are not finite, not those of the spec, or take more than `MAX_BYTES`.
        OSError: If the folder cannot be written; an older bundle in it stays valid.
    """
    if weights.shape != spec.shape():
        raise ValueError(f"the weights are of {weights.shape}, the bundle's layers are {spec.shape()}")
    require_finite(weights, "the policy")
    data = save_arrays({name: np.ascontiguousarray(array) for name, array in weights.arrays.items()})
    if len(data) > MAX_BYTES:
        raise ValueError(f"a bundle's weights take at most {MAX_BYTES} bytes, these {len(data)}: use smaller layers")
    digest = hashlib.sha256(data).hexdigest()
    name = f"weights-{digest[:12]}.safetensors"
    settings = base_settings(spec.base, spec.residual.knowledge)
    content = {
        "format": FORMAT,
        "version": VERSION,
        "layout": LAYOUT,
        "edition": EDITION,
        **{name: value for name, value in asdict(spec).items() if name != "inputs"},  # which `entries` says
        "hidden": list(spec.hidden),
        "base_settings": settings,
        "base_hash": settings_hash(settings),
        "entries": spec.entries(),
        "weights": {"file": name, "sha256": digest},
    }
    write_atomically(folder / name, lambda path: path.write_bytes(data))
    _write_manifest(folder, content)
    for other in folder.glob("weights-*.safetensors"):
        if other.name != name:
            other.unlink()
    return content["content_hash"]


def annotate(folder: Path, **provenance: Any) -> None:
    """Add entries to a bundle's provenance.

    Raises:
        BundleError: If there is no sound bundle.
    """
    _, content = read_spec(folder)
    content["provenance"].update(provenance)
    _write_manifest(folder, content)


def _write_manifest(folder: Path, content: dict[str, Any]) -> None:
    content["content_hash"] = content_hash(content)
    write_text(folder / MANIFEST, json.dumps(content, indent=2, allow_nan=False) + "\n")
    write_text(folder / CARD, card(content))


def read_spec(folder: Path | str) -> tuple[BundleSpec, dict[str, Any]]:
    """Read the description in a bundle, and its whole manifest, without loading weights.

    Raises:
        BundleError: If it is missing, damaged, foreign, or made for other gains than the checkout's.
    """
    manifest = Path(folder) / MANIFEST
    content = read_manifest(Path(folder))
    try:
        spec = _spec_of(content)
    except ValueError as error:
        raise BundleError(f"{manifest} does not fit this release: {in_a_line(error)}") from None
    settings = base_settings(spec.base, spec.residual.knowledge)
    if content.get("base_hash") != settings_hash(settings):
        before = content.get("base_settings")
        changes = changed_settings(before, settings) if before else "unknown gains"
        raise BundleError(f"{manifest} was trained on another {spec.base!r} ({in_a_line(changes)}): train it again")
    return spec, content


def _spec_of(content: dict[str, Any]) -> BundleSpec:
    """Read the description in a manifest's content; raises ValueError if this release cannot."""
    known = {name: content[name] for name in BundleSpec.__slots__ if name != "inputs"}
    known |= {"residual": ResidualSettings(**content["residual"]), "hidden": tuple(content["hidden"])}
    spec = BundleSpec(**known)
    if content["layout"] != LAYOUT:
        raise ValueError(f"it was made for observation layout {content['layout']!r}, this release has {LAYOUT}")
    if content["entries"] != spec.entries():
        spec = replace(spec, inputs=chosen_names(content["entries"], spec.offered()))
    spec.shape()
    file = content["weights"]["file"]
    if not re.fullmatch(r"weights-\w+\.safetensors", file):
        raise ValueError(f"its weights must be a file weights-XXXX.safetensors beside it, got {file!r}")
    return spec


def load_controller(folder: Path | str) -> ResidualController:
    """Load a bundle as a controller on the environment's observation; raises the errors of `read_weights`."""
    weights, spec, _ = read_weights(folder)
    network = NetworkPolicy(weights)
    policy = network if spec.inputs is None else SelectedInputs(network, spec.inputs, spec.offered())
    return ResidualController(make_base(spec.base, spec.sensors), policy, spec.residual)


def read_weights(folder: Path | str) -> tuple[Weights, BundleSpec, dict[str, Any]]:
    """Read a bundle whole: its weights, its description and its manifest.

    Raises:
        BundleError: If it is missing, damaged, or foreign.
    """
    spec, content = read_spec(folder)
    path = Path(folder) / content["weights"]["file"]
    data = _read_file(path, content)
    try:
        weights = Weights(spec.shape(), load_arrays(data))
    except (SafetensorError, KeyError, TypeError, ValueError) as error:
        words = in_a_line(error)
        raise BundleError(f"{path} does not hold the weights that {MANIFEST} describes: {words}") from None
    require_finite(weights, str(path))
    return weights, spec, content


def _read_file(path: Path, content: dict[str, Any]) -> bytes:
    try:
        data = read_regular(path, MAX_BYTES)
    except OSError as error:
        why = error.strerror or error
        raise BundleError(f"the weights of {path.parent} cannot be read ({why}): {path.name}") from None
    if hashlib.sha256(data).hexdigest() != content["weights"]["sha256"]:
        raise BundleError(f"{path} is damaged: its SHA-256 is not the one in {MANIFEST}; copy it again")
    return data


def bundle_files(folder: Path) -> dict[str, bytes]:
    """Content of the files that a policy is loaded from, by name.

    Raises:
        BundleError: If one is missing or damaged.
    """
    _, content = read_spec(folder)
    name = content["weights"]["file"]
    return {MANIFEST: read_regular(folder / MANIFEST, MAX_BYTES), name: _read_file(folder / name, content)}


def require_finite(weights: Weights, owner: str) -> None:
    """Raise a `BundleError` if some weights are no finite numbers."""
    if name := weights.not_finite():
        raise BundleError(f"{owner} has weights that are not finite numbers, in {name}")
