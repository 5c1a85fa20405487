"""What tuned servos have in common: the design model, and gains as the numbers that a kernel reads."""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple

from baselines.controller import ScalarController
from baselines.models.actuator import dead_time
from baselines.models.friction import Compensation, FrictionGains
from beltarm_env import ArmParams
from beltarm_env.arm import Plant


class ServoDesign(NamedTuple):
    """What the law of a servo knows."""

    plant: Plant  # of the design model
    compensation: Compensation
    lead: float  # dead time T [s]
    gains: Any  # named tuple, see `Gains.numbers`


class Servo(ScalarController):
    """Base of tuned servos; a subclass names its `gains_type`, `arm_law` and `memory_size`.

    Args:
        gains: Of this type; those before tuning if not given.
        params: The design model.
    """

    gains_type: ClassVar[type[FrictionGains]]

    def __init__(self, gains: Any = None, params: ArmParams | None = None) -> None:
        super().__init__(params)
        self.gains: Any = gains or self.gains_type()
        self._design = self._known()

    def _known(self) -> Any:
        """What the law knows; a law that needs more than its gains has a design of its own around this one."""
        p = self.params
        return ServoDesign(p.plant(), self.gains.compensation(p), dead_time(p), self.gains.numbers())
