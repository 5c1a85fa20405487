"""Policy bundles: a trained residual policy as a folder of two files, loaded without pickle.

    policy.json             what the policy is and how it came about; names the weights and their SHA-256
    weights-XXXX.safetensors

`policy.json` carries a hash of its own content, so that a bundle is either what was saved or refused. Weights are
written first, under a name of their own; replacing `policy.json` is the instant at which a bundle is replaced.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from gymnasium import spaces
from safetensors import SafetensorError
from safetensors.torch import load as load_weights
from safetensors.torch import save as save_weights
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy

from agents.residual import EXTRA_ENTRIES, ResidualController, ResidualSettings, residual_observation_space
from baselines import CONTROLLERS
from baselines.files import write_atomically, write_text
from beltarm_env.observation import ENTRIES

FORMAT = "beltarm-policy"
VERSION = 1
MANIFEST = "policy.json"
ACTIVATIONS = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU, "elu": torch.nn.ELU}
_ALGORITHMS = ("ppo",)


class BundleError(ValueError):
    """A policy bundle that is missing, damaged, or not one of this project's."""


@dataclass(frozen=True, slots=True)
class BundleSpec:
    """What a policy is, besides its weights."""

    algorithm: str  # "ppo"
    base: str  # name of the base controller, see `baselines.CONTROLLERS`
    residual: ResidualSettings
    hidden: tuple[int, ...]  # width of the hidden layers
    activation: str = "tanh"
    sensors: str = "encoder"
    provenance: dict[str, Any] = field(default_factory=dict)  # how it was trained

    def entries(self) -> list[str]:
        """Names of the policy's inputs, in order."""
        return [entry.name for entry in ENTRIES[self.sensors]] + list(EXTRA_ENTRIES)


def build_policy(spec: BundleSpec) -> BasePolicy:
    """An untrained policy of the given kind."""
    return ActorCriticPolicy(
        residual_observation_space(spec.sensors),
        spaces.Box(-1.0, 1.0, (1,)),
        lambda _: 0.0,
        net_arch=list(spec.hidden),
        activation_fn=ACTIVATIONS[spec.activation],
    )


def save_bundle(folder: Path, spec: BundleSpec, policy: BasePolicy) -> str:
    """Write a bundle, replacing one that is there.

    Returns:
        Its content hash.

    Raises:
        OSError: If the folder cannot be written; an older bundle in it stays valid.
    """
    weights = save_weights({name: value.contiguous() for name, value in policy.state_dict().items()})
    digest = hashlib.sha256(weights).hexdigest()
    name = f"weights-{digest[:12]}.safetensors"
    content = {
        "format": FORMAT,
        "version": VERSION,
        **asdict(spec),
        "hidden": list(spec.hidden),
        "entries": spec.entries(),
        "weights": {"file": name, "sha256": digest},
    }
    content["content_hash"] = _content_hash(content)
    write_atomically(folder / name, lambda path: path.write_bytes(weights))
    write_text(folder / MANIFEST, json.dumps(content, indent=2) + "\n")
    for other in folder.glob("weights-*.safetensors"):
        if other.name != name:
            other.unlink()
    return content["content_hash"]


def annotate(folder: Path, **provenance: Any) -> None:
    """Add to the provenance of a bundle, once more is known of the run that it came from.

    Raises:
        BundleError: If there is no sound bundle.
    """
    _, content = read_spec(folder)
    content["provenance"].update(provenance)
    content["content_hash"] = _content_hash(content)
    write_text(folder / MANIFEST, json.dumps(content, indent=2) + "\n")


def _content_hash(content: dict[str, Any]) -> str:
    rest = {key: value for key, value in content.items() if key != "content_hash"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def read_spec(folder: Path) -> tuple[BundleSpec, dict[str, Any]]:
    """What a bundle says it is, and its whole manifest, without loading weights.

    Raises:
        BundleError: If it is missing, damaged, or foreign.
    """
    manifest = folder / MANIFEST
    try:
        content = json.loads(manifest.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise BundleError(f"no policy bundle at {folder}: {MANIFEST} is missing") from None
    except (OSError, ValueError) as error:
        raise BundleError(f"{manifest} cannot be read ({error}); save the policy again") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise BundleError(f"{manifest} is not a {FORMAT} bundle")
    if content.get("version") != VERSION:
        raise BundleError(f"{manifest} has version {content.get('version')!r}, this release reads {VERSION}")
    if content.get("content_hash") != _content_hash(content):
        raise BundleError(f"{manifest} was changed after it was saved: its content hash does not match")
    try:
        spec = BundleSpec(
            algorithm=content["algorithm"],
            base=content["base"],
            residual=ResidualSettings(**content["residual"]),
            hidden=tuple(content["hidden"]),
            activation=content["activation"],
            sensors=content["sensors"],
            provenance=content["provenance"],
        )
        if not all(isinstance(width, int) and 0 < width <= 65536 for width in spec.hidden):
            raise ValueError(f"hidden layers must have a whole positive width, got {list(spec.hidden)}")
        if not isinstance(content["weights"]["file"], str) or not isinstance(content["weights"]["sha256"], str):
            raise ValueError("it does not name its weights")
        known = spec.algorithm in _ALGORITHMS and spec.base in CONTROLLERS and spec.activation in ACTIVATIONS
        if not known or spec.entries() != content["entries"]:
            raise ValueError("it was made for another algorithm, base controller or observation layout")
    except (KeyError, TypeError, ValueError) as error:
        raise BundleError(f"{manifest} does not fit this release: {error}") from None
    return spec, content


def load_controller(folder: Path) -> tuple[ResidualController, BundleSpec]:
    """Load a bundle as a controller on the environment's observation.

    Raises:
        BundleError: If it is missing, damaged, or foreign.
    """
    spec, content = read_spec(folder)
    path = folder / Path(content["weights"]["file"]).name
    try:
        data = path.read_bytes()
    except OSError as error:
        raise BundleError(f"the weights of {folder} cannot be read ({error.strerror}): {path.name}") from None
    if hashlib.sha256(data).hexdigest() != content["weights"]["sha256"]:
        raise BundleError(f"{path} is damaged: its SHA-256 is not the one in {MANIFEST}; copy it again")
    policy = build_policy(spec)
    try:
        policy.load_state_dict(load_weights(data))
    except (SafetensorError, RuntimeError) as error:
        raise BundleError(f"{path} does not hold the weights that {MANIFEST} describes: {error}") from None
    policy.set_training_mode(False)
    base = CONTROLLERS[spec.base]()
    return ResidualController(base, policy, spec.residual), spec
