"""Policies as folders: a trained residual policy in one file, loaded without executing anything, and its card.

    policy.safetensors   weights of the network that acts; in the header what the policy is, with a SHA-256 of both
    README.md            the same as a card to read; it is not read here

See `agents.tensor_file`, `agents.policy.description` and `agents.policy.card`. A policy is either what was saved or
refused. Replacing its file is the instant at which it is replaced.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agents.policy.card import CARD, POLICY_FILE, card
from agents.policy.description import BundleError, BundleSpec, spec_of
from agents.policy.network import NetworkPolicy
from agents.policy.weights import Weights
from agents.residual.bases import make_base
from agents.residual.controller import Policy, ResidualController
from agents.tensor_file import MAX_BYTES, packed, unpacked
from baselines.tools.files import read_regular, write_bytes, write_text
from baselines.tools.schema import in_a_line
from beltarm_env.arrays import Flags, Singles

POLICIES = Path(__file__).resolve().parents[1] / "policies"
"""Folder of the shipped policies that see the encoder alone: METHOD/SEED, each the folder of a policy."""
ACCELEROMETER_POLICIES = POLICIES.with_name("policies_accelerometer")
"""Folder of those that have an accelerometer, which are ranked with none of the others."""


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
        if not _are_alike(bundle.spec, spec):
            raise ValueError(f"{folder} is not built as {folders[0]}: load each by itself")
    policies = [NetworkPolicy(bundle.weights, spec.columns(), len(spec.offered())) for bundle in bundles]
    policy = policies[0] if len(policies) == 1 else PoliciesSideBySide(policies)
    return ResidualController(make_base(spec.base, spec.sensors, spec.base_gains), policy, spec.residual)


def are_alike(folders: Sequence[Path | str]) -> bool:
    """Whether policies differ in their weights alone; raises the errors of `read_bundle`."""
    specs = [read_spec(folder)[0] for folder in folders]
    return all(_are_alike(spec, specs[0]) for spec in specs)


def _are_alike(spec: BundleSpec, other: BundleSpec) -> bool:
    return replace(spec, provenance={}) == replace(other, provenance={})


class PoliciesSideBySide:
    """Policies of which each has an equal share of the rows, in order.

    Args:
        policies: At least one, all with memories of one shape, rows first, or none of them with any.
    """

    def __init__(self, policies: Sequence[Policy]) -> None:
        self.policies = tuple(policies)

    def predict(
        self,
        observation: Singles,
        state: Singles | None = None,
        episode_start: Flags | None = None,
        deterministic: bool = True,
    ) -> tuple[Singles, Any]:
        """Residuals of shape (n, 1) for observations of shape (n, entries), see `Policy`.

        Raises:
            ValueError: If n is no multiple of the number of policies.
        """
        rows, count = len(observation), len(self.policies)
        if rows % count:
            raise ValueError(f"{count} policies share rows equally, got {rows}: give a multiple of {count}")
        residuals, memories = [], []
        for k, policy in enumerate(self.policies):
            share = slice(k * rows // count, (k + 1) * rows // count)
            begins = None if episode_start is None else episode_start[share]
            memory = None if state is None else state[share]
            residual, following = policy.predict(observation[share], memory, begins, deterministic)
            residuals.append(residual)
            memories.append(following)
        return np.concatenate(residuals), None if memories[0] is None else np.concatenate(memories)
