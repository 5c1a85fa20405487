"""Motor servo along a motion planned at the move's start: computed torque, friction compensation and PID.

    tau_m = M(theta_r) theta_r'' G + 1/2 M2' theta_r'^2 / G + V_a1 G theta_r' + tau_f + push
    push = M(theta_r) (K_p (e + K_i integral of e dt) + K_v e'),    e = G theta_r - theta_a

with the planned joint angle theta_r [rad], the inertia M = M_a1 + M2 / G^2 at the motor shaft, and tau_f as in
`baselines.models.friction`. What is fed forward is that of a dead time later (`baselines.models.actuator`), when the
command acts; the errors are of now. The derivative acts on the measured speed; differenced over a sample, that is the
filtered derivative of the angle. The integral holds still while the torque is at its limit and the error would drive it
further (conditional integration: Åström and Hägglund, *PID Controllers*, 1995, section 3.5).

The PID ignores the belt: `SmoothController` and `ShapingController` plan motions that do not excite it.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np

from baselines.controller import ClassicalController
from baselines.gains import tunable
from baselines.models.actuator import dead_time
from baselines.models.friction import FrictionGains, commanded_direction, friction_level
from baselines.models.ramps import Ramps, motion_at
from baselines.models.rigid_arm import RigidArm, motor_errors
from baselines.reading import Reading, chosen
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arrays import Flags, Floats


@dataclass(frozen=True)
class PidGains(FrictionGains):
    """Gains of the motor's servo."""

    angle: float = tunable(1600.0, 10.0, 100_000.0, log=True)  # K_p  [1/s^2]
    speed: float = tunable(120.0, 5.0, 1000.0, log=True)  # K_v  [1/s]
    integral: float = tunable(2.0, 0.01, 100.0, log=True)  # K_i  [1/s]


@dataclass(frozen=True, slots=True)
class PidMemory:
    """Memory from sample to sample."""

    integral: Floats  # of the motor's angle error [rad s], shape (n,)
    ramps: Ramps  # as planned


class PidServo(ClassicalController[PidMemory]):
    """PID along planned ramps; a subclass writes `plan`.

    Args:
        gains: Of the servo.
        params: The design model.
        smooth: Whether ramps are smooth rather than linear.
    """

    def __init__(self, gains: PidGains, params: ArmParams | None, smooth: bool) -> None:
        super().__init__(params)
        self._gains, self._smooth = gains, smooth
        self._arm = RigidArm(self.params)
        self._row = self.params.row()
        self._lead = dead_time(self.params)

    @abstractmethod
    def plan(self, moves: Floats) -> Ramps:
        """Ramps for moves of shape (n, 4): start, goal [rad], duration, ramp time [s]."""

    def law(self, reading: Reading, begins: Flags, memory: PidMemory | None) -> tuple[Floats, PidMemory]:
        """Torque [N m] of one sample, see `ClassicalController`."""
        integral, ramps = self._recall(memory, begins, reading)
        time = CONTROL_PERIOD * reading.step.astype(np.float64)
        wanted, led = (motion_at(ramps, reading.move[:, 0], time + lead, self._smooth) for lead in (0.0, self._lead))
        error, speed_error = motor_errors(reading, wanted, self.params)
        p, gains, inertia = self.params, self._gains, self._arm.inertia(wanted.angle)
        push = inertia * (gains.angle * (error + gains.integral * integral) + gains.speed * speed_error)
        viscous = p.motor_viscous_friction * p.gear_ratio * led.speed
        level = gains.friction * friction_level(self._row, p.gear_ratio * led.speed)
        friction = level * commanded_direction(led, push, gains.rest_width)
        torque = self._arm.torque(led) + viscous + friction + push
        winding = (np.abs(torque) > p.torque_limit) & (torque * error > 0)
        return torque, PidMemory(np.where(winding, integral, integral + CONTROL_PERIOD * error), ramps)

    def _recall(self, memory: PidMemory | None, begins: Flags, now: Reading) -> tuple[Floats, Ramps]:
        """Integral and plan at this sample: zero and a new one where an episode begins."""
        if memory is None:
            return np.zeros(len(begins)), self.plan(now.move)
        if not begins.any():
            return memory.integral, memory.ramps
        ramps = Ramps(*(chosen(begins, *pair) for pair in zip(self.plan(now.move), memory.ramps, strict=True)))
        return np.where(begins, 0.0, memory.integral), ramps
