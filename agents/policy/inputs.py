"""Inputs of a policy, chosen by name from what a residual agent observes.

An environment may come to show more than a policy was trained on: the policy goes on with what it knows.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from agents.policy.network import NetworkPolicy
from beltarm_env.arrays import Flags, Singles
from beltarm_env.observation import Entry


def chosen_names(entries: object, offered: Sequence[Entry]) -> tuple[str, ...]:
    """Names of a policy's inputs, checked against what the environment and the base offer.

    Args:
        entries: Name, unit, scale and bound of each input, as a bundle has them.
        offered: All entries that there are.

    Raises:
        ValueError: If there is none, or one that does not exist or is of another unit, scale or bound; names it.
    """
    if not isinstance(entries, list) or not entries:
        raise ValueError(f"its observation entries must be a list of at least one, got {entries!r}")
    known = {entry.name: entry for entry in offered}
    for given in entries:
        if not isinstance(given, list) or len(given) != len(Entry._fields):
            raise ValueError(f"an observation entry must be name, unit, scale and bound, got {given!r}")
        name, *rest = given
        if not isinstance(name, str) or name not in known:
            raise ValueError(f"there is no observation entry {name!r} for its sensors and knowledge")
        if rest != (now := list(known[name][1:])):
            raise ValueError(f"its observation entry {name!r} has unit, scale and bound {rest}, here it has {now}")
    return tuple(name for name, *_ in entries)


class SelectedInputs:
    """A policy that is given some of the observation's entries, in its own order.

    Args:
        policy: The policy.
        names: Names of its inputs, in order.
        offered: All entries of the observation, in order.
    """

    def __init__(self, policy: NetworkPolicy, names: Sequence[str], offered: Sequence[Entry]) -> None:
        self.policy = policy
        self._offered = len(offered)
        all_names = [entry.name for entry in offered]
        self.columns = np.array([all_names.index(name) for name in names])
        """Place of each input in the observation."""

    def predict(
        self,
        observation: Singles,
        state: Singles | None = None,
        episode_start: Flags | None = None,
        deterministic: bool = True,
    ) -> tuple[Singles, Any]:
        """Residuals for observations of shape (n, entries), see `NetworkPolicy.predict`.

        Raises:
            ValueError: If the observations have another shape.
        """
        if observation.ndim != 2 or observation.shape[1] != self._offered:
            raise ValueError(
                f"the policy chooses from {self._offered} entries, got shape {observation.shape}: run it with the "
                "--sensors that it was trained with"
            )
        return self.policy.predict(observation[:, self.columns], state, episode_start, deterministic)
