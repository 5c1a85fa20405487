"""Policies as folders: a trained residual policy in one file, loaded without executing anything, and its card.

    policy.safetensors   weights of the network that acts, and in the header what the policy is and how it came about,
                         with a SHA-256 of both (`agents.tensor_file`, `agents.policy.description`)
    README.md            the same as a card to read, see `agents.policy.card`; it is not read here

A policy is either what was saved or refused. Replacing its file is the instant at which it is replaced.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from agents.policy.card import CARD, POLICY_FILE, card
from agents.policy.description import BundleError, BundleSpec, spec_of
from agents.policy.network import NetworkPolicy
from agents.policy.weights import Weights
from agents.residual.bases import make_base
from agents.residual.controller import ResidualController
from agents.tensor_file import MAX_BYTES, packed, read_packed
from baselines.tools.files import read_regular, write_atomically, write_text
from baselines.tools.schema import in_a_line

POLICIES = Path(__file__).resolve().parents[1] / "policies"
"""Folder of the shipped policies that see the encoder alone: METHOD/SEED, each the folder of a policy."""
FELT_POLICIES = POLICIES.with_name("policies_accelerometer")
"""Folder of those that have an accelerometer, which are ranked with none of the others."""


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
    write_atomically(folder / POLICY_FILE, lambda temporary: temporary.write_bytes(data))


def annotate(folder: Path, **provenance: Any) -> None:
    """Add entries to a policy's provenance.

    Raises:
        BundleError: If there is no sound policy.
    """
    weights, spec, _ = read_weights(folder)
    save_bundle(folder, replace(spec, provenance={**spec.provenance, **provenance}), weights)


def load_controller(folder: Path | str) -> ResidualController:
    """Load a policy as a controller on the environment's observation; raises the errors of `read_weights`."""
    weights, spec, _ = read_weights(folder)
    policy = NetworkPolicy(weights, spec.columns(), len(spec.offered()))
    return ResidualController(make_base(spec.base, spec.sensors), policy, spec.residual)


def read_spec(folder: Path | str) -> tuple[BundleSpec, dict[str, Any]]:
    """Read a policy's description, also as JSON has it; raises the errors of `read_weights`."""
    _, spec, content = read_weights(folder)
    return spec, content


def read_weights(folder: Path | str) -> tuple[Weights, BundleSpec, dict[str, Any]]:
    """Read a policy whole: its weights, and its description, also as JSON has it.

    Raises:
        BundleError: If it is missing, damaged, foreign, or made for other gains than the checkout's.
    """
    path = Path(folder) / POLICY_FILE
    try:
        content, arrays = read_packed(path, "policy")
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
    return weights, spec, content


def bundle_files(folder: Path) -> dict[str, bytes]:
    """Content of the file that a policy is loaded from, by name; raises the errors of `read_weights`."""
    read_weights(folder)
    return {POLICY_FILE: read_regular(folder / POLICY_FILE, MAX_BYTES)}
