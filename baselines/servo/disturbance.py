"""Disturbance observer and torsion-torque feedback around a PD servo of the motor.

**Observer** (Ohnishi 1987). The motor's nominal equation, with everything but known torques as a load,

    M_a1 theta_a'' = tau_m - tau_known - tau_d,

is solved for tau_d over each sample, with speeds as the encoder gives them, and filtered by Q(s) = g / (s + g), exactly
discretised: d += (1 - exp(-g dt)) (tau_m - tau_known - M_a1 delta theta_a' / dt - d). Added to the torque it rejects
the load as far as Q passes it. Known torques are viscous friction, dry friction by the commanded direction, and what
moves the links of a rigid arm on the reference, both a dead time later (`baselines.models.linear`), when the command
acts; so tau_d is next to zero on an arm like the design model that does not vibrate.

**Torsion-torque feedback** (resonance ratio control: Yuki, Murakami and Ohnishi 1993). On a vibrating arm the load is
the reaction of the belt, tau_b / G. A second filter with the cut-off g_r > g passes the mode too; what it has beyond
the first, r, is fed back so that the reaction counts K_r times:

    tau_m = M_a1 G theta_ref'' + push + tau_known + d
    push = M_a1 (K_p e + K_v e') - (K_r - 1) r

The motor then answers the belt like one of inertia M_a1 / K_r, which a soft PD can damp. The ideal ratio between the
mode with the motor free and with the motor held, H = sqrt(1 + K_r M2 / (G^2 M_a1)) = sqrt(5), would take K_r = 28 at 90
and 195 at 0 degrees, times the noise of the speed; K_r is one tunable number for all angles.

**Friction.** Where the motor sticks, friction hides the load, and the observer would integrate the servo's torque until
the motor breaks away. It may do so where the motor is off its goal; where the push is within the width that is not
meant to break it away (`baselines.models.friction`), both filters are frozen, and r = 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from baselines.gains import tunable
from baselines.models.friction import FrictionGains, compensated
from baselines.models.rigid_arm import link_torque, motor_errors, task_motion
from baselines.reading import Sample
from baselines.servo.pid import Servo, ServoDesign
from beltarm_env import CONTROL_PERIOD
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled, inlined

LOAD, FAST_LOAD, MOTOR_SPEED, KNOWN, HELD = range(5)
"""Entries of the memory: tau_d passed by g and by g_r [N m], the motor's speed at the last sample [rad/s], the known
torque since then [N m], and 1 where the last push was not meant to break the motor away."""


@dataclass(frozen=True)
class DisturbanceGains(FrictionGains):
    """Gains of servo and observer."""

    angle: float = tunable(200.0, 1.0, 10_000.0, log=True)  # K_p  [1/s^2]
    speed: float = tunable(80.0, 1.0, 1000.0, log=True)  # K_v  [1/s]
    observer: float = tunable(15.0, 0.1, 500.0, log=True)  # g  [rad/s]  what the observer rejects
    reaction: float = tunable(80.0, 5.0, 2000.0, log=True)  # g_r  [rad/s]  what it passes of the belt's reaction
    reaction_gain: float = tunable(3.0, 0.1, 300.0, log=True)  # K_r  [-]  1 leaves the reaction as it is


class DisturbanceDesign(NamedTuple):
    """What the law knows."""

    servo: ServoDesign
    share: float  # 1 - exp(-g dt)
    fast_share: float  # the same of g_r


@inlined
def _observe(design: DisturbanceDesign, now: Sample, memory: Floats) -> None:
    """Advance both filters to this sample."""
    accelerating = (now.motor_speed - memory[MOTOR_SPEED]) / (design.servo.plant.inverse_motor_inertia * CONTROL_PERIOD)
    latest = now.last_command - memory[KNOWN] - accelerating
    if memory[HELD] > 0.0 and now.motor_speed == 0.0:
        memory[FAST_LOAD] = memory[LOAD]
    else:
        memory[LOAD] += design.share * (latest - memory[LOAD])
        memory[FAST_LOAD] += design.fast_share * (latest - memory[FAST_LOAD])


@compiled
def disturbance_law(design: DisturbanceDesign, now: Sample, begins: bool, memory: Floats) -> float:
    """Motor torque [N m] for one arm, see `LawKernel`; nothing is known of the load where a move begins."""
    plant, gains = design.servo.plant, design.servo.gains
    if begins:
        memory[LOAD], memory[FAST_LOAD] = 0.0, 0.0
    else:
        _observe(design, now, memory)
    wanted, led = task_motion(now, 0.0), task_motion(now, design.servo.lead)
    error, speed_error = motor_errors(now, wanted, plant.gear)
    servo = (gains.angle * error + gains.speed * speed_error) / plant.inverse_motor_inertia
    push = servo - (gains.reaction_gain - 1) * (memory[FAST_LOAD] - memory[LOAD])
    friction, direction = compensated(led, push, plant.gear, design.servo.compensation)
    known = friction + plant.viscous_friction * now.motor_speed + link_torque(led, plant)
    memory[MOTOR_SPEED], memory[KNOWN], memory[HELD] = now.motor_speed, known, 1.0 if abs(direction) < 1 else 0.0
    return plant.gear * led.acceleration / plant.inverse_motor_inertia + push + known + memory[LOAD]


class DisturbanceController(Servo):
    """PD with disturbance observer and torsion-torque feedback."""

    gains_type = DisturbanceGains
    arm_law = staticmethod(disturbance_law)
    memory_size = 5

    def _known(self) -> DisturbanceDesign:
        share, fast_share = (float(1 - np.exp(-g * CONTROL_PERIOD)) for g in (self.gains.observer, self.gains.reaction))
        return DisturbanceDesign(super()._known(), share, fast_share)
