"""Policies that correct the same controller, as one controller: each acts on an equal share of the arms.

Base and identification, which are the same for all of them, run once for the whole batch. An arm moves as it does with
its policy alone, bit for bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from agents.policy.bundle import BundleSpec, load_controller, read_spec
from agents.residual.controller import Policy, ResidualController
from beltarm_env.arrays import Flags, Singles


class SharedPolicies:
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
        rows, policies = len(observation), len(self.policies)
        if rows % policies:
            raise ValueError(f"{policies} policies share rows equally, got {rows}: give a multiple of {policies}")
        residuals, memories = [], []
        for k, policy in enumerate(self.policies):
            own = slice(k * rows // policies, (k + 1) * rows // policies)
            begins = None if episode_start is None else episode_start[own]
            memory = None if state is None else state[own]
            residual, following = policy.predict(observation[own], memory, begins, deterministic)
            residuals.append(residual)
            memories.append(following)
        return np.concatenate(residuals), None if memories[0] is None else np.concatenate(memories)


def are_alike(folders: Sequence[Path]) -> bool:
    """Whether policies differ in their weights alone, and can be loaded together.

    Raises:
        BundleError: If one is missing, damaged or foreign.
    """
    specs = [_without_origin(read_spec(folder)[0]) for folder in folders]
    return all(spec == specs[0] for spec in specs)


def load_together(folders: Sequence[Path]) -> tuple[ResidualController, BundleSpec]:
    """Load policies as one controller, whose batches they share equally; also return the description of the first.

    Raises:
        BundleError: If one is missing, damaged or foreign.
        ValueError: If they differ in more than their weights.
    """
    spec, *others = [read_spec(folder)[0] for folder in folders]
    for folder, other in zip(folders[1:], others, strict=True):
        if _without_origin(other) != _without_origin(spec):
            raise ValueError(f"{folder} is not built as {folders[0]}: load each by itself")
    first, *more = [load_controller(folder) for folder in folders]
    if not more:
        return first, spec
    policies = SharedPolicies([controller.policy for controller in (first, *more)])
    return ResidualController(first.informed.base, policies, spec.residual), spec


def _without_origin(spec: BundleSpec) -> BundleSpec:
    return replace(spec, provenance={})
