"""Controller that is watched by an observer: it acts as it would alone, and its memory holds the estimates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agents.observer.network import Estimate, Observer
from agents.residual.informed import InformedBase, InformedMemory
from baselines.reading import chosen
from beltarm_env import observation as layout
from beltarm_env.arrays import Flags, Singles
from beltarm_env.rollout import Controller


@dataclass(frozen=True, slots=True)
class WatchedMemory:
    """Memory of a `WatchedController`."""

    informed: InformedMemory
    estimate: Estimate  # of the last sample at which one was due
    observer: Singles  # the observer's own memory, (n, width)
    age: NDArray[np.int64]  # samples since the episode's start, (n,)


class WatchedController:
    """A controller with an observer beside it, as one controller with the same torques.

    Args:
        controller: What acts, with any sensors; one that identifies its arm shares its belief with the observer.
        observer: What watches.
    """

    def __init__(self, controller: Controller, observer: Observer) -> None:
        self.informed = InformedBase(controller, observer.knowledge)
        self.observer = observer
        self.params = self.informed.params

    def predict(
        self,
        observation: Singles,
        state: WatchedMemory | None = None,
        episode_start: Flags | None = None,
        deterministic: bool = True,
    ) -> tuple[Singles, WatchedMemory]:
        """The controller's torque, and a memory whose `estimate` is the observer's; see `Controller`."""
        count = len(observation)
        if state is None:
            episode_start = np.ones(count, np.bool_)
        informed = self.informed.advance(observation, state.informed if state else None, episode_start)
        age = np.zeros(count, np.int64) if state is None else state.age
        age = age if episode_start is None else np.where(episode_start, 0, age)
        due = age % self.observer.hold == 0
        if state is not None and not due.any():
            return informed.action, WatchedMemory(informed, state.estimate, state.observer, age + 1)
        seen = self.informed.seen(observation[:, : layout.size("encoder")], informed)  # which comes first in all tiers
        estimate, memory = self.observer.observe(seen, state.observer if state else None, episode_start)
        if state is not None and not due.all():
            estimate = Estimate(*(chosen(due, new, old) for new, old in zip(estimate, state.estimate, strict=True)))
            memory = chosen(due, memory, state.observer)
        return informed.action, WatchedMemory(informed, estimate, memory, age + 1)
