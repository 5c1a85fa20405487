"""The paper's controller, as published and retuned: computed torque, PD, torsional-velocity feedback, (7) to (11).

    tau_m = M_a1 u_1 + V_a1 theta_a' + tau_c sign(theta_a_ref') - K_4 theta_s'                    (11)
    u_1 = theta_a_ref'' + K_v (theta_a_ref' - theta_a') + K_p (theta_a_ref - theta_a)              (9)

with nominal parameters. The paper gives no law for the sign of its friction term tau_c; here it is the sign of the
reference speed, which is known without noise. The torsional velocity theta_s' comes, as in the paper, from a dynamic
simulation of the arm. What that runs on the paper does not say; here it is encoder data.

**Simulation.** Between two samples the encoder tells nothing but the mean speed, so the joint is taken to move at
constant speed v. The torsion theta_s = theta_1 - phi then oscillates freely,

    theta_s'' + 2 lambda theta_s' + w^2 theta_s = 0,   w^2 = K_s / M2(theta_1),   2 lambda = D_s / M2(theta_1),

and where v changes from one sample to the next, theta_s' changes by the same amount. Both are solved exactly. As in
(5b) the term with M2' is left out.

**Retuned.** The structure of (11), with the design model's parameters and theta_s' simulated in the same way:

    tau_m = M(theta_ref) u_1 + 1/2 M2' theta_ref'^2 / G + V_a1 theta_a' + tau_f - K_4 theta_s'

- M(theta) = M_a1 + M2(theta) / G^2 is the inertia of motor and links, as in (4), where (11) has the motor's alone. With
  the term of M2' this is the exact inverse dynamics of a rigid arm; see `baselines.models.rigid_arm`.
- tau_f has a law at rest. It follows the push of the feedback, M (K_v ... + K_p ...) - K_4 theta_s', so that neither
  the PD nor the vibration feedback is swallowed by stiction. With Table 2's gains and no such law the motor can rest
  up to tau_c / (M_a1 K_p) = 20 rad away, 13 degrees at the joint.
- What is fed forward is that of a dead time later (`baselines.models.linear`), when the command acts.
- All gains are tuned.

K_4 damps as long as the PD is slower than the mode: one that holds the motor despite friction holds it against K_4 too.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from baselines.controller import ScalarController, own_gains
from baselines.gains import Gains, tunable
from baselines.models.friction import FrictionGains, compensated
from baselines.models.linear import turning_load
from baselines.models.rigid_arm import inertia_at, motor_errors, rigid_torque, task_motion
from baselines.reading import Sample
from baselines.servo.pid import Servo, ServoDesign
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arm import Plant
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled, inlined
from beltarm_env.physics.trigonometry import exponential, sine_cosine

TORSION, TORSION_RATE, JOINT_SPEED = range(3)
"""Entries of the memory: theta_s [rad] and theta_s' [rad/s] simulated, and theta_1' as measured [rad/s]."""


_ANY = -sys.float_info.max, sys.float_info.max  # range of a gain that only has to be finite


@dataclass(frozen=True)
class PaperGains(Gains):
    """Feedback gains; the defaults are Table 2. K_p = omega_n^2 and K_v = 2 xi omega_n with omega_n = 5, xi = 2."""

    torsion_speed: float = tunable(0.15, *_ANY)  # K_4  [N m s/rad]  of theta_s'; 0 switches vibration suppression off
    angle: float = tunable(25.0, *_ANY)  # K_p  [1/s^2]
    speed: float = tunable(20.0, *_ANY)  # K_v  [1/s]


@inlined
def next_torsion(
    torsion: float, rate: float, speed_change: float, joint_angle: float, plant: Plant
) -> tuple[float, float]:
    """Torsion [rad] and its rate [rad/s] one control period later.

    Args:
        torsion: theta_s [rad].
        rate: theta_s' [rad/s].
        speed_change: Change of the joint's mean speed between the last two periods [rad/s].
        joint_angle: theta_1 [rad].
        plant: The arm.
    """
    m2, _ = turning_load(joint_angle, 0.0, plant)
    decay, square = 0.5 * plant.damping / m2, plant.stiffness / m2
    frequency = math.sqrt(square - decay * decay)
    rate = rate + speed_change
    envelope = exponential(-decay * CONTROL_PERIOD)
    sine, cosine = sine_cosine(frequency * CONTROL_PERIOD)
    cosine, sine = envelope * cosine, envelope * sine / frequency
    return (torsion * (cosine + decay * sine) + rate * sine, rate * (cosine - decay * sine) - torsion * square * sine)


@inlined
def simulated_rate(joint_speed: float, joint_angle: float, begins: bool, plant: Plant, memory: Floats) -> float:
    """Simulated theta_s' [rad/s] at this sample; it and the torsion are zero where a move begins.

    Args:
        joint_speed: Measured theta_1' [rad/s].
        joint_angle: Measured theta_1 [rad].
        begins: Whether a move begins.
        plant: The arm.
        memory: Written, shape (3,).
    """
    torsion, rate = 0.0, 0.0
    if not begins:
        change = joint_speed - memory[JOINT_SPEED]
        torsion, rate = next_torsion(memory[TORSION], memory[TORSION_RATE], change, joint_angle, plant)
    memory[TORSION], memory[TORSION_RATE], memory[JOINT_SPEED] = torsion, rate, joint_speed
    return rate


class PaperDesign(NamedTuple):
    """What the law knows."""

    plant: Plant  # of the nominal arm
    gains: Any  # named tuple, see `Gains.numbers`


@compiled
def paper_law(design: PaperDesign, now: Sample, begins: bool, memory: Floats) -> float:
    """Eq. (11) [N m] for one arm, see `LawKernel`."""
    plant, gains, speed = design.plant, design.gains, now.motor_speed
    joint_angle = now.reference_angle - now.angle_error / plant.gear
    rate = simulated_rate(speed / plant.gear, joint_angle, begins, plant, memory)
    feedback = gains.speed * now.speed_error + gains.angle * now.angle_error
    u_1 = plant.gear * now.reference_acceleration + feedback
    friction = plant.viscous_friction * speed + plant.coulomb_friction * np.sign(now.reference_speed)
    return u_1 / plant.inverse_motor_inertia + friction - gains.torsion_speed * rate


class PaperController(ScalarController):
    """Eq. (11) on encoder observations. `PaperController(gains=PaperGains(torsion_speed=0))` is the rigid ablation.

    Args:
        params: The nominal arm, all that the controller knows of the plant.
        gains: Feedback gains.
    """

    profile = None
    needs_vibration = True
    arm_law = staticmethod(paper_law)
    memory_size = 3

    def __init__(self, params: ArmParams | None = None, gains: PaperGains | None = None) -> None:
        super().__init__(params or ArmParams())
        self._gains = own_gains(gains, PaperGains)
        self._design = PaperDesign(self.params.plant(), self._gains.numbers())


def rigid_controller(params: ArmParams | None = None) -> PaperController:
    """Controller of the paper without vibration feedback, K_4 = 0: computed torque and PD for a rigid arm."""
    return PaperController(params, PaperGains(torsion_speed=0.0))


@dataclass(frozen=True)
class RetunedGains(FrictionGains):
    """Gains of (11)."""

    torsion_speed: float = tunable(0.002, 1e-4, 2.0, log=True)  # K_4  [N m s/rad]
    angle: float = tunable(400.0, 1.0, 10_000.0, log=True)  # K_p  [1/s^2]
    speed: float = tunable(20.0, 1.0, 1000.0, log=True)  # K_v  [1/s]


@compiled
def retuned_law(design: ServoDesign, now: Sample, begins: bool, memory: Floats) -> float:
    """Motor torque [N m] for one arm, with the memory of `simulated_rate`; see `LawKernel`."""
    plant, gains, speed = design.plant, design.gains, now.motor_speed
    rate = simulated_rate(speed / plant.gear, now.motor_angle / plant.gear, begins, plant, memory)
    wanted, led = task_motion(now, 0.0), task_motion(now, design.lead)
    error, speed_error = motor_errors(now, wanted, plant.gear)
    servo = inertia_at(wanted.angle, plant) * (gains.speed * speed_error + gains.angle * error)
    push = servo - gains.torsion_speed * rate
    friction, _ = compensated(led, push, plant.gear, design.compensation)
    return rigid_torque(led, plant) + plant.viscous_friction * speed + friction + push


class RetunedController(Servo):
    """Eq. (11) with the inertia of the links, stiction compensated, and gains of its own."""

    gains_type = RetunedGains
    needs_vibration = True
    arm_law = staticmethod(retuned_law)
    memory_size = PaperController.memory_size
