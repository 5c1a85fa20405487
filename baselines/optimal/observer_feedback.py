"""Base of controllers that feed back what the stick-slip observer estimates: one law for one arm."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np

from baselines.controller import TunedController, run_law
from baselines.estimation.observer import ESTIMATE_SIZE, Correction, Measured, correct, observe
from baselines.reading import Reading
from beltarm_env.arrays import Flags, Floats
from beltarm_env.simulation import ArmSimulation

ADDED, OWN = ESTIMATE_SIZE, ESTIMATE_SIZE + 1
"""Entries of a law's memory after the estimate: torque beside the feedback's at the last sample [N m]; and from `OWN`
on what the law keeps besides."""


class ObserverController(TunedController[Any]):
    """Base of controllers with an observer; a subclass names its `feedback_law`, and knows the design of `observer`."""

    needs_servo = True
    feedback_law: ClassVar[Callable[..., float]]
    """See `LawKernel.law`; of its memory only the estimate counts where a move begins."""
    correction: ClassVar[Correction] = staticmethod(correct)
    memory_size: ClassVar[int] = OWN
    _simulation: ArmSimulation | None = None  # of as many arms as there were so far

    def law(self, reading: Reading, begins: Flags, memory: Any) -> tuple[Floats, Any]:
        """Torque [N m] of one sample, see `ClassicalController`."""
        rows = self._observed(reading, begins, memory)
        return self._torques(reading, begins, rows), rows

    def _observed(self, reading: Reading, begins: Flags, memory: Floats | None) -> Floats:
        """Copy of the laws' memory, shape (n, memory_size), with the estimates of this sample."""
        count = len(begins)
        rows = np.zeros((count, self.memory_size)) if memory is None else memory.copy()
        simulation, self._simulation = self._simulation, None  # while it is in use: another thread makes its own
        if simulation is None or len(simulation.limits) < count:
            simulation = ArmSimulation(self.params, count)
        measured = self._measured(reading, begins, rows)
        observe(type(self).correction, self._design.observer, measured, begins, rows, simulation.room)
        self._simulation = simulation
        return rows

    def _measured(self, reading: Reading, begins: Flags, rows: Floats) -> Measured:
        """What the observer reads; what it has to remember of that is written to the laws' memory."""
        return Measured(reading.motor_angle, reading.last_command)

    def _torques(self, reading: Reading, begins: Flags, rows: Floats) -> Floats:
        torques = np.empty(len(begins))
        run_law(type(self).feedback_law, self._design, reading, begins, rows, torques)
        return torques
