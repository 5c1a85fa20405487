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
from baselines.estimation.observer import Estimate, StickSlipObserver
from baselines.estimation.tracking import Track
from baselines.planning.plan import Plans
from baselines.reading import Reading, sample_of
from beltarm_env import ArmParams
from beltarm_env.arrays import Flags, Floats
from beltarm_env.engine import compiled

ADDED = 0
"""Entry of a law's row: torque beside the feedback's at the last sample [N m]."""


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
    """Base of controllers with an observer; a subclass names its `gains_type` and `feedback_law`, and writes `_known`.

    Args:
        gains: Of this type; those before tuning if not given.
        params: The design model.
    """

    gains_type: ClassVar[type[Any]]
    feedback_law: ClassVar[Callable[..., float]]
    """`feedback_law(design, now, begins, ahead, disturbance, row)`: motor torque [N m] of one sample of one arm, before
    it is cut at its limit, from what is constant, a `Sample`, whether an episode begins, x when the command acts, shape
    (4,), and d [N m]. Writes the row, its memory, in which nothing counts where an episode begins."""
    observer: ClassVar[type[StickSlipObserver]] = StickSlipObserver
    row_size: ClassVar[int] = 1

    def __init__(self, gains: Any = None, params: ArmParams | None = None) -> None:
        super().__init__(params)
        self.gains = gains or self.gains_type()
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
        law, ahead, disturbance = type(self).feedback_law, estimate.ahead, estimate.disturbance
        _run_law(law, self._design, reading, begins, ahead, disturbance, rows, torques)
        return torques, ObserverMemory(estimate, rows, plans)

    def _planned(self, plans: Plans | None, reading: Reading, begins: Flags, rows: Floats) -> Plans | None:
        """Plans of n arms; what the laws need of them is written to their rows."""
        return plans
