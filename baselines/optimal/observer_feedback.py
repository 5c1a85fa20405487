"""Base of controllers that feed back what the stick-slip observer estimates: one law for one arm.

The observer simulates its model for many arms side by side, which takes less than half the time.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from baselines.controller import ClassicalController, run_law
from baselines.estimation.observer import Estimate, StickSlipObserver, Track
from baselines.planning.plan import Plans
from baselines.reading import Reading
from beltarm_env import ArmParams
from beltarm_env.arrays import Flags, Floats

AHEAD, DISTURBANCE, ADDED, OWN = slice(4), 4, 5, 6
"""Entries of a law's row: what is estimated, x when the command acts and d [N m]; torque beside the feedback's at the
last sample [N m]; and from `OWN` on what the law keeps besides."""


class ObservedArm(NamedTuple):
    """Memory of observer and law of one arm, written in place."""

    track: Track
    row: Floats  # of the law


@dataclass(frozen=True)
class ObserverMemory:
    """Estimates of n arms, the memory of their laws, and their plans."""

    estimate: Estimate
    rows: Floats  # shape (n, size)
    plans: Plans | None  # of a controller that plans


class ObserverController(ClassicalController[ObserverMemory]):
    """Base of controllers with an observer; a subclass names its `gains_type` and `feedback_law`, and writes `_known`.

    Args:
        gains: Of this type; those before tuning if not given.
        params: The design model.
    """

    gains_type: ClassVar[type[Any]]
    feedback_law: ClassVar[Callable[..., float]]
    """See `LawKernel.law`; its memory is a row, of which only the estimates count where an episode begins."""
    observer: ClassVar[type[StickSlipObserver]] = StickSlipObserver
    row_size: ClassVar[int] = OWN

    def __init__(self, gains: Any = None, params: ArmParams | None = None) -> None:
        super().__init__(params)
        self.gains: Any = gains or self.gains_type()
        self._observer = self.observer(self.params, self.gains.noise())
        self._design = self._known()

    @abstractmethod
    def _known(self) -> Any:
        """What the law knows: a named tuple of numbers and arrays."""

    def law(self, reading: Reading, begins: Flags, memory: ObserverMemory | None) -> tuple[Floats, ObserverMemory]:
        """Torque [N m] of one sample, see `ClassicalController`."""
        count, torques = len(begins), np.empty(len(begins))
        estimate = self._observer.update(memory.estimate if memory else None, reading, begins)
        rows = memory.rows.copy() if memory else np.zeros((count, self.row_size))
        plans = self._planned(memory.plans if memory else None, reading, begins, rows)
        rows[:, AHEAD], rows[:, DISTURBANCE] = estimate.ahead, estimate.disturbance
        run_law(type(self).feedback_law, self._design, reading, begins, rows, torques)
        return torques, ObserverMemory(estimate, rows, plans)

    def _planned(self, plans: Plans | None, reading: Reading, begins: Flags, rows: Floats) -> Plans | None:
        """Plans of n arms; what the laws need of them is written to their rows."""
        return plans
