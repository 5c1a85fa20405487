"""Policies as folders: a trained residual policy in one file, loaded without executing anything, and its card.

    policy.safetensors   weights of the network that acts; in the header what the policy is, with a SHA-256 of both
    README.md            the same as a card to read; it is not read here

See `agents.tensor_file` and `agents.policy.description`. A policy is either what was saved or refused. Replacing its
file is the instant at which it is replaced.

The card is Markdown after YAML for the Hugging Face Hub, with the fields of `huggingface_hub.ModelCardData`. That class
is not used, since training needs no package of the Hub: it writes the scores of an offered policy (`eval.exports.hub`).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import jinja2
import numpy as np

from agents.policy.description import NO_SETTINGS, BundleError, BundleSpec, spec_of
from agents.policy.network import NetworkPolicy
from agents.policy.weights import Weights
from agents.residual.bases import make_base
from agents.residual.controller import ResidualController
from agents.tensor_file import MAX_BYTES, packed, unpacked
from baselines.tools.files import read_regular, write_bytes, write_text
from baselines.tools.schema import in_a_line
from beltarm_env.task.ranges import resolve_ranges
from beltarm_env.timing import CONTROL_PERIOD

POLICIES = Path(__file__).resolve().parents[1] / "policies"
"""Folder of the shipped policies that see the encoder alone: METHOD/SEED, each the folder of a policy."""
ACCELEROMETER_POLICIES = POLICIES.with_name("policies_accelerometer")
"""Folder of those that have an accelerometer, which are ranked with none of the others."""
ENVIRONMENT = "BeltArm-v0"
POLICY_FILE = "policy.safetensors"
CARD = "README.md"
_ROWS = 12  # of the learning curve
_TEMPLATES = jinja2.Environment(
    loader=jinja2.FileSystemLoader(Path(__file__).parent),
    keep_trailing_newline=True,
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
)


class Bundle(NamedTuple):
    """Content of a policy's folder."""

    weights: Weights
    spec: BundleSpec
    content: dict[str, Any]  # the same description as JSON has it
    data: bytes  # of the file that all of this was read from


def save_bundle(folder: Path, spec: BundleSpec, weights: Weights) -> None:
    """Write a policy and its card, the policy last; one at the same place is replaced.

    Raises:
        ValueError: If the weights are not those of the spec, or take more than `MAX_BYTES`.
        OSError: If the folder cannot be written; an older policy in it stays valid.
    """
    if weights.shape != spec.shape():
        raise ValueError(f"the weights are of {weights.shape}, the policy's layers are {spec.shape()}")
    content = spec.content()
    data = packed("policy", content, weights.arrays)
    write_text(folder / CARD, card(content))
    write_bytes(folder / POLICY_FILE, data)


def annotate(folder: Path, **provenance: Any) -> None:
    """Add entries to a policy's provenance.

    Raises:
        BundleError: If there is no sound policy.
    """
    bundle = read_bundle(folder)
    save_bundle(folder, replace(bundle.spec, provenance={**bundle.spec.provenance, **provenance}), bundle.weights)


def read_bundle(folder: Path | str) -> Bundle:
    """Read a policy whole.

    Raises:
        BundleError: If it is missing, damaged, foreign, or trained on another base.
    """
    path = Path(folder) / POLICY_FILE
    try:
        data = read_regular(path, MAX_BYTES)
        content, arrays = unpacked(data, "policy")
    except FileNotFoundError:
        message = f"no policy at {folder}: {POLICY_FILE} is missing; a policy is a folder such as runs/ppo/best"
        raise BundleError(message) from None
    except (OSError, ValueError) as error:
        raise BundleError(f"{path} cannot be read ({in_a_line(error)}); copy or save it again") from None
    spec = spec_of(content, path)
    try:
        weights = Weights(spec.shape(), arrays)
    except ValueError as error:
        raise BundleError(f"{path} does not hold the weights that it describes: {in_a_line(error)}") from None
    return Bundle(weights, spec, content, data)


def read_spec(folder: Path | str) -> tuple[BundleSpec, dict[str, Any]]:
    """Read a policy's description, also as JSON has it; raises the errors of `read_bundle`."""
    bundle = read_bundle(folder)
    return bundle.spec, bundle.content


def load_controller(*folders: Path | str) -> ResidualController:
    """Load a policy as a controller on the environment's observation.

    Of several policies, which may differ in their weights alone, each acts on an equal share of the arms. Base and
    identification then run once for the whole batch, and an arm moves as it does with its policy alone, bit for bit.

    Raises:
        BundleError: As `read_bundle`.
        ValueError: If policies differ in more than their weights.
    """
    bundles = [read_bundle(folder) for folder in folders]
    spec = bundles[0].spec
    for folder, bundle in zip(folders, bundles, strict=True):
        if _built(bundle.spec) != _built(spec):
            raise ValueError(f"{folder} is not built as {folders[0]}: load each by itself")
    weights, columns = [bundle.weights for bundle in bundles], spec.columns()
    policy = NetworkPolicy(*weights, columns=columns, observed=len(spec.offered()))
    return ResidualController(make_base(spec.base, spec.sensors, spec.base_gains), policy, spec.residual)


def _built(spec: BundleSpec) -> BundleSpec:
    """What a policy is, without how it came about."""
    return replace(spec, provenance={})


def told_apart(ours: BundleSpec, theirs: BundleSpec) -> str | None:
    """What keeps two policies from being training seeds of one method, in words; None if they are.

    They have another seed, and all else alike. What only one of them says of its training does not count.
    """
    said, others = ({**spec.provenance.get("config", {}), **asdict(_built(spec))} for spec in (ours, theirs))
    both = (said.keys() & others.keys()) - {*NO_SETTINGS, "validation_every"}
    for name in sorted(both, key=lambda name: (name == "seed", name)):
        if (said[name] == others[name]) == (name == "seed"):
            return in_a_line(f"{name} {said[name]} and {others[name]}", 80)
    return None


# Card


@dataclass(frozen=True, slots=True)
class Offer:
    """What a card says besides the description, of a policy that is offered to others."""

    repo_id: str = ""  # ORG/NAME on the Hub
    license: str = ""  # as the Hub names it, such as "mit"
    scores: str = ""  # and where the policy loses: Markdown
    citation: str = ""  # how to cite it: BibTeX


def model_name(content: dict[str, Any]) -> str:
    """Name of a policy as the Hub's agents are called, from its description."""
    return f"{content['algorithm']}-{ENVIRONMENT}"


def card(content: dict[str, Any], offer: Offer | None = None) -> str:
    """Format a description as a card: what the policy is, how it is loaded, its training, and what is offered."""
    offer, provenance = offer or Offer(), content["provenance"]
    config, curve = provenance.get("config", {}), provenance.get("curve", [])
    moves = config.get("moves", 1)
    return _TEMPLATES.get_template("card.md.j2").render(
        environment=ENVIRONMENT,
        period=CONTROL_PERIOD,
        policy_file=POLICY_FILE,
        policy=content,
        residual=content["residual"],
        provenance=provenance,
        offer=offer,
        software={"beltarm": provenance.get("version"), **provenance.get("versions", {})},
        seed=config.get("seed"),
        curve=[curve[k] for k in np.linspace(0, len(curve) - 1, min(len(curve), _ROWS)).round().astype(int)],
        moves=moves,
        ranges=resolve_ranges(config["randomization"], moves) if "randomization" in config else {},
    )
