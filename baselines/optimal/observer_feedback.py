"""Base of controllers that feed back what the stick-slip observer estimates: one law for one arm.

Of many arms, the observer simulates its model side by side, which takes less than half the time of one after the other;
all else is a loop over the law.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from baselines.controller import ClassicalController
from baselines.estimation.observer import Estimate, Noise, StickSlipObserver, Track
from baselines.reading import Reading, sample_of
from beltarm_env import ArmParams
from beltarm_env.arrays import Flags, Floats
from beltarm_env.engine import compiled

ADDED = 0
"""Entry of a law's row: torque beside the feedback's at the last sample [N m]."""


class FeedbackLaw(NamedTuple):
    """Law for one arm whose state is estimated."""

    law: Callable[..., float]
    """`law(design, now, begins, ahead, disturbance, row)`: motor torque [N m] of one sample, before it is cut at its
    limit, from what is constant, a `Sample`, whether an episode begins, x when the command acts, shape (4,), and d
    [N m]. Writes the row, its memory, in which nothing counts where an episode begins."""
    design: Any  # named tuple of numbers and arrays


class ObservedArm(NamedTuple):
    """Memory of observer and law of one arm, written in place."""

    track: Track
    row: Floats  # of the law


@dataclass(frozen=True)
class ObserverMemory:
    """Estimates of n arms, and the memory of their laws."""

    estimate: Estimate
    rows: Floats  # shape (n, size)


@compiled
def _run_law(
    law: Callable[..., float],
    design: Any,
    reading: Reading,
    begins: Flags,
    ahead: Floats,
    disturbances: Floats,
    rows: Floats,
    torques: Floats,
) -> None:
    for i in range(len(begins)):
        torques[i] = law(design, sample_of(reading, i), begins[i], ahead[i], disturbances[i], rows[i])


class ObserverController(ClassicalController[ObserverMemory]):
    """Base of controllers with an observer; a subclass writes `feedback_law`.

    Args:
        noise: Process noise of the observer.
        params: The design model.
    """

    observer: ClassVar[type[StickSlipObserver]] = StickSlipObserver
    row_size: ClassVar[int] = 1

    def __init__(self, noise: Noise, params: ArmParams | None) -> None:
        super().__init__(params)
        self._observer = self.observer(self.params, noise)

    @abstractmethod
    def feedback_law(self) -> FeedbackLaw:
        """The law for one arm, with a row of `row_size` entries."""

    def law(self, reading: Reading, begins: Flags, memory: ObserverMemory | None) -> tuple[Floats, ObserverMemory]:
        """Torque [N m] of one sample, see `ClassicalController`."""
        estimate = self._observer.update(memory.estimate if memory else None, reading, begins)
        rows = memory.rows.copy() if memory else np.zeros((len(begins), self.row_size))
        return self._torques(reading, begins, estimate, rows), ObserverMemory(estimate, rows)

    def _torques(self, reading: Reading, begins: Flags, estimate: Estimate, rows: Floats) -> Floats:
        """Torques of n arms [N m]; their rows are written."""
        torques = np.empty(len(begins))
        _run_law(*self.feedback_law(), reading, begins, estimate.ahead, estimate.disturbance, rows, torques)
        return torques
