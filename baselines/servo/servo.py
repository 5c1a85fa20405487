"""What tuned servos have in common: the design model, and gains as the numbers that a kernel reads."""

from __future__ import annotations

from typing import Any, NamedTuple

from baselines.controller import ScalarController, TunedController
from baselines.models.actuator import dead_time
from baselines.models.friction import Compensation
from beltarm_env.arm import Plant
from beltarm_env.arrays import Floats


class ServoDesign(NamedTuple):
    """What the law of a servo knows."""

    plant: Plant  # of the design model
    compensation: Compensation
    lead: float  # dead time T [s]
    gains: Any  # named tuple, see `Gains.numbers`


class Servo(TunedController[Floats], ScalarController):
    """Base of tuned servos; a subclass names its `gains_type`, `arm_law` and `memory_size`."""

    def _known(self) -> Any:
        """What the law knows; a law that needs more than its gains has a design of its own around this one."""
        p = self.params
        return ServoDesign(p.plant(), self.gains.compensation(p), dead_time(p), self.gains.numbers())
