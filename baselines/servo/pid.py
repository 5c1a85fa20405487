"""Motor servo along a motion planned at the move's start: computed torque, friction compensation and PID.

    tau_m = M(theta_r) theta_r'' G + 1/2 M2' theta_r'^2 / G + V_a1 G theta_r' + tau_f + push
    push = M(theta_r) (K_p (e + K_i integral of e dt) + K_v e'),    e = G theta_r - theta_a

with the planned joint angle theta_r [rad], the inertia M = M_a1 + M2 / G^2 at the motor shaft, and tau_f as in
`baselines.models.friction`. What is fed forward is that of a dead time later (`baselines.models.actuator`), when the
command acts; the errors are of now. The derivative acts on the measured speed; differenced over a sample, that is the
filtered derivative of the angle. The integral holds still while the torque is at its limit and the error would drive it
further (conditional integration: Åström and Hägglund, *PID Controllers*, 1995, section 3.5).

The PID ignores the belt: those who plan the motion see to it that it is not excited. `PidServo` follows any motion of
the joint with its torque, `RampServo` one whose speed is a sum of ramps, with the torque of a rigid arm.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from baselines.controller import ClassicalController
from baselines.gains import tunable
from baselines.models.actuator import dead_time
from baselines.models.friction import FrictionGains, commanded_direction, dry_friction, friction_level
from baselines.models.ramps import Ramps, motion_at
from baselines.models.rigid_arm import Motion, RigidArm, motor_errors
from baselines.reading import Reading, chosen
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arrays import Flags, Floats


@dataclass(frozen=True)
class PidGains(FrictionGains):
    """Gains of the motor's servo."""

    angle: float = tunable(1600.0, 10.0, 100_000.0, log=True)  # K_p  [1/s^2]
    speed: float = tunable(120.0, 5.0, 1000.0, log=True)  # K_v  [1/s]
    integral: float = tunable(2.0, 0.01, 100.0, log=True)  # K_i  [1/s]


Planned = TypeVar("Planned", bound=tuple[Any, ...])
"""A plan: a named tuple of arrays, the arms first."""


@dataclass(frozen=True, slots=True)
class PidMemory(Generic[Planned]):
    """Memory from sample to sample."""

    integral: Floats  # of the motor's angle error [rad s], shape (n,)
    planned: Planned


class PidServo(ClassicalController[PidMemory[Planned]]):
    """PID along a planned motion; a subclass writes `plan` and `motion`.

    Args:
        gains: Of the servo.
        params: The design model.
    """

    def __init__(self, gains: PidGains, params: ArmParams | None) -> None:
        super().__init__(params)
        self._gains = gains
        self._arm = RigidArm(self.params)
        self._row = self.params.row()
        self._lead = dead_time(self.params)

    @abstractmethod
    def plan(self, moves: Floats) -> Planned:
        """Plan for moves of shape (n, 4): start, goal [rad], duration, ramp time [s]."""

    @abstractmethod
    def motion(self, planned: Planned, start: Floats, time: Floats) -> tuple[Motion, Floats]:
        """Motion of the joint, and its motor torque [N m] but for dry friction, of n arms.

        Args:
            planned: Their plan.
            start: Joint angles before the move [rad], shape (n,).
            time: Since the move's start [s], shape (n,).
        """

    def law(
        self, reading: Reading, begins: Flags, memory: PidMemory[Planned] | None
    ) -> tuple[Floats, PidMemory[Planned]]:
        """Torque [N m] of one sample, see `ClassicalController`."""
        integral, planned = self._recall(memory, begins, reading)
        time, start = CONTROL_PERIOD * reading.step.astype(np.float64), reading.move[:, 0]
        wanted, _ = self.motion(planned, start, time)
        led, torque = self.motion(planned, start, time + self._lead)
        error, speed_error = motor_errors(reading, wanted, self.params)
        p, gains, inertia = self.params, self._gains, self._arm.inertia(wanted.angle)
        push = inertia * (gains.angle * (error + gains.integral * integral) + gains.speed * speed_error)
        level = gains.friction * friction_level(dry_friction(self._row), p.gear_ratio * led.speed)
        torque = torque + level * commanded_direction(led, push, gains.rest_width) + push
        winding = (np.abs(torque) > p.torque_limit) & (torque * error > 0)
        return torque, PidMemory(np.where(winding, integral, integral + CONTROL_PERIOD * error), planned)

    def _recall(self, memory: PidMemory[Planned] | None, begins: Flags, now: Reading) -> tuple[Floats, Planned]:
        """Integral and plan at this sample: zero and a new one where an episode begins."""
        if memory is None:
            return np.zeros(len(begins)), self.plan(now.move)
        if not begins.any():
            return memory.integral, memory.planned
        pairs = zip(self.plan(now.move), memory.planned, strict=True)
        planned = type(memory.planned)(*(chosen(begins, *pair) for pair in pairs))
        return np.where(begins, 0.0, memory.integral), planned


class RampServo(PidServo[Ramps]):
    """PID along planned ramps; a subclass writes `plan`.

    Args:
        gains: Of the servo.
        params: The design model.
        smooth: Whether ramps are smooth rather than linear.
    """

    def __init__(self, gains: PidGains, params: ArmParams | None, smooth: bool) -> None:
        super().__init__(gains, params)
        self._smooth = smooth

    def motion(self, planned: Ramps, start: Floats, time: Floats) -> tuple[Motion, Floats]:
        """Motion along the ramps, and the torque of a rigid arm, see `PidServo`."""
        wanted = motion_at(planned, start, time, self._smooth)
        viscous = self.params.motor_viscous_friction * self.params.gear_ratio * wanted.speed
        return wanted, self._arm.torque(wanted) + viscous
