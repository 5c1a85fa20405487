"""What MuJoCo can express of the real drive: latency, current loop, torque constant and drift of friction.

The rest would need torques and friction that change with the motor's angle or speed within MuJoCo's steps, or a tendon
whose stiffness changes with its length: it is refused.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from beltarm_env.arm import DRIVE_EFFECTS, FIELDS, ArmParams
from beltarm_env.arrays import Floats
from beltarm_env.timing import CONTROL_PERIOD

EXPRESSIBLE = ("current_loop_time_constant", "command_latency", "torque_constant_error", "friction_drift")
"""Fields of `DRIVE_EFFECTS` that the MuJoCo arm has; the others have to be zero."""
_SHORTEST = 1e-12  # pieces of time that are rounding of the latency's share of a sample [s]


def check_expressible(table: Floats) -> None:
    """Check that MuJoCo can express the drives of some arms: rows as the fields of `ArmParams`, shape (n, fields).

    Raises:
        ValueError: If an arm has an effect that it cannot.
    """
    largest = {name: float(table[:, FIELDS.index(name)].max()) for name in DRIVE_EFFECTS if name not in EXPRESSIBLE}
    refused = [f"{name}={value:g}" for name, value in largest.items() if value > 0]
    if refused:
        raise ValueError(
            f'model="mujoco" cannot express {", ".join(refused)}: set to 0 what it cannot, for example by '
            'randomization="ideal", or take model="lagrangian"'
        )


class Actuator:
    """Commands on their way to the motor, and its torque, as means over MuJoCo's steps.

    A command that is given at a sample acts T_c = (m + f) T later, so within a sample the target of the current loop is
    (1 + k) times the command of m + 1 samples ago, and from f T on that of m samples ago. The loop follows by

        T_i dtau/dt = target - tau,

    whose mean over a step dt is target + (tau - target) T_i / dt (1 - e^(-dt / T_i)). With that for a control the motor
    gets the exact momentum, however short T_i is; what is left, where the motor is within a step, is of second order in
    dt and does not add up. MuJoCo's own `filterexact` is exact in Euler's steps alone: after one RK4 step of
    dt = 0.75 T_i it is at 0.37 instead of 0.53, and its force is the one at a step's beginning, of first order; and
    `filter` is unstable where dt is more than 2.8 T_i.
    """

    def __init__(self, params: ArmParams) -> None:
        """Begin an episode, with a motor without torque and commands of zero before it."""
        self._lag = params.current_loop_time_constant
        self._gain = 1 + params.torque_constant_error
        late = params.command_latency / CONTROL_PERIOD
        whole = math.floor(late)
        self._split = (late - whole) * CONTROL_PERIOD
        self._commands = [0.0] * (whole + 2)  # of m + 1 samples ago to this one
        self.torque = 0.0
        """Torque of the motor now, tau [N m]."""

    def means(self, command: float, longest: float) -> Iterator[tuple[float, int, float]]:
        """Yield the steps of a sample with a new command [N m]: length [s], how many, and their mean torque [N m].

        Args:
            command: Torque commanded at the sample's beginning [N m].
            longest: Step [s] that the pieces of a sample are cut into, or a shorter one.
        """
        self._commands = [*self._commands[1:], command]
        for duration, demand in zip((self._split, CONTROL_PERIOD - self._split), self._commands[:2], strict=True):
            if duration < _SHORTEST:
                continue
            count = max(math.ceil(duration / longest - 1e-9), 1)
            target = self._gain * demand
            if self._lag == 0:
                self.torque = target
                yield duration / count, count, target
                continue
            dt = duration / count
            gone = -math.expm1(-dt / self._lag)  # share of the difference that a step takes away
            for _ in range(count):
                behind = self.torque - target
                self.torque = target + behind * (1 - gone)
                yield dt, 1, target + behind * self._lag / dt * gone
