"""Disturbance observer and torsion-torque feedback around a PD servo of the motor.

**Observer** (Ohnishi 1987). The motor's nominal equation, with everything but known torques as a load,

    M_a1 theta_a'' = tau_m - tau_known - tau_d,

is solved for tau_d over each sample, with speeds as the encoder gives them, and filtered by Q(s) = g / (s + g), exactly
discretised: d += (1 - exp(-g dt)) (tau_m - tau_known - M_a1 delta theta_a' / dt - d). Added to the torque it rejects
the load as far as Q passes it. Known torques are viscous friction, dry friction by the commanded direction, and what
moves the links of a rigid arm on the reference, both a dead time later (`baselines.models.actuator`), when the command
acts; so tau_d is next to zero on an arm like the design model that does not vibrate.

**Torsion-torque feedback** (resonance ratio control: Yuki, Murakami and Ohnishi 1993). On a vibrating arm the load is
the reaction of the belt, tau_b / G. A second filter with the cut-off g_r > g passes the mode too; what it has beyond
the first, r, is fed back so that the reaction counts K_r times:

    tau_m = M_a1 G theta_ref'' + push + tau_known + d
    push = M_a1 (K_p e + K_v e') - (K_r - 1) r

The motor then answers the belt like one of inertia M_a1 / K_r, which a soft PD can damp. It raises the ratio between
the mode with the motor free and with the motor held to H = sqrt(1 + K_r M2 / (G^2 M_a1)); the ideal is H = sqrt(5).
Here the geared motor is 7 to 49 times as inert as the links: that would take K_r = 28 at 90 and 195 at 0 degrees, times
the noise of a speed of which one count is 0.044 N m. K_r is one tunable number for all angles.

**Friction.** To the observer an error in tau_c is a load: it gets rid of it, at its pace, and g_r > g keeps it from
being multiplied by K_r for long. Where the motor sticks, friction hides the load altogether, and the observer would
integrate the servo's torque until the motor breaks away. It may do so where the motor is off its goal; but where the
push is within the width that is not meant to break it away (`baselines.models.friction`), both filters are frozen, and
r = 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.controller import ClassicalController
from baselines.gains import tunable
from baselines.models.actuator import dead_time
from baselines.models.friction import FrictionGains, commanded_direction, dry_friction, friction_level
from baselines.models.ramps import task_motion
from baselines.models.rigid_arm import RigidArm, motor_errors
from baselines.reading import Reading
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arrays import Flags, Floats


@dataclass(frozen=True)
class DisturbanceGains(FrictionGains):
    """Gains of servo and observer."""

    angle: float = tunable(200.0, 1.0, 10_000.0, log=True)  # K_p  [1/s^2]
    speed: float = tunable(80.0, 1.0, 1000.0, log=True)  # K_v  [1/s]
    observer: float = tunable(15.0, 0.1, 500.0, log=True)  # g  [rad/s]  what the observer rejects
    reaction: float = tunable(80.0, 5.0, 2000.0, log=True)  # g_r  [rad/s]  what it passes of the belt's reaction
    reaction_gain: float = tunable(3.0, 0.1, 300.0, log=True)  # K_r  [-]  1 leaves the reaction as it is


@dataclass(frozen=True, slots=True)
class DisturbanceMemory:
    """Memory from sample to sample; arrays of shape (n,)."""

    load: Floats  # d: tau_d passed by g [N m]
    fast_load: Floats  # tau_d passed by g_r [N m]
    motor_speed: Floats  # of the last sample [rad/s]
    known: Floats  # known torque since the last sample [N m]
    held: Flags  # whether the last push was not meant to break the motor away


class DisturbanceController(ClassicalController[DisturbanceMemory]):
    """PD with disturbance observer and torsion-torque feedback.

    Args:
        gains: Of servo and observer.
        params: The design model.
    """

    def __init__(self, gains: DisturbanceGains | None = None, params: ArmParams | None = None) -> None:
        super().__init__(params)
        self.gains = gains or DisturbanceGains()
        self._arm = RigidArm(self.params)
        self._row = self.params.row()
        self._lead = dead_time(self.params)
        self._share = 1 - np.exp(-self.gains.observer * CONTROL_PERIOD)
        self._fast_share = 1 - np.exp(-self.gains.reaction * CONTROL_PERIOD)

    def law(
        self, reading: Reading, begins: Flags, memory: DisturbanceMemory | None
    ) -> tuple[Floats, DisturbanceMemory]:
        """Torque [N m] of one sample, see `ClassicalController`."""
        p, gains = self.params, self.gains
        load, fast_load = self._observe(memory, begins, reading)
        wanted, led = task_motion(reading), task_motion(reading, self._lead)
        error, speed_error = motor_errors(reading, wanted, p)
        servo = p.motor_inertia * (gains.angle * error + gains.speed * speed_error)
        push = servo - (gains.reaction_gain - 1) * (fast_load - load)
        direction = commanded_direction(led, push, gains.rest_width)
        level = gains.friction * friction_level(dry_friction(self._row), p.gear_ratio * led.speed)
        friction = level * direction + p.motor_viscous_friction * reading.motor_speed
        known = friction + self._arm.link_torque(led)
        torque = p.motor_inertia * p.gear_ratio * led.acceleration + push + known + load
        return torque, DisturbanceMemory(load, fast_load, reading.motor_speed, known, np.abs(direction) < 1)

    def _observe(self, memory: DisturbanceMemory | None, begins: Flags, now: Reading) -> tuple[Floats, Floats]:
        """Load estimates of both filters at this sample [N m]; zero at an episode's start."""
        if memory is None:
            return np.zeros(len(begins)), np.zeros(len(begins))
        accelerating = self.params.motor_inertia * (now.motor_speed - memory.motor_speed) / CONTROL_PERIOD
        latest = now.last_command - memory.known - accelerating
        stuck = memory.held & (now.motor_speed == 0.0)
        load = np.where(stuck, memory.load, memory.load + self._share * (latest - memory.load))
        fast_load = np.where(stuck, load, memory.fast_load + self._fast_share * (latest - memory.fast_load))
        return np.where(begins, 0.0, load), np.where(begins, 0.0, fast_load)
