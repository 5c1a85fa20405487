"""The paper's controller: computed torque, PD and torsional-velocity feedback, eqs. (7) to (11).

    tau_m = M_a1 u_1 + V_a1 theta_a' + tau_c sign(theta_a_ref') - K_4 theta_s'                    (11)
    u_1 = theta_a_ref'' + K_v (theta_a_ref' - theta_a') + K_p (theta_a_ref - theta_a)              (9)

with nominal parameters. The paper gives no law for the sign of its friction term tau_c; here it is the sign of the
reference speed, which is known without noise. The torsional velocity theta_s' comes, as in the paper, from a dynamic
simulation of the arm that runs beside the plant on encoder data: see `TorsionSimulation`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.controller import ClassicalController
from baselines.models.rigid_arm import RigidArm
from baselines.reading import Reading
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arrays import Flags, Floats


@dataclass(frozen=True, slots=True)
class PaperGains:
    """Feedback gains; the defaults are Table 2. K_p = omega_n^2 and K_v = 2 xi omega_n with omega_n = 5, xi = 2."""

    torsion_speed: float = 0.15  # K_4  [N m s/rad]  of theta_s'; 0 switches vibration suppression off
    angle: float = 25.0  # K_p  [1/s^2]
    speed: float = 20.0  # K_v  [1/s]

    def __post_init__(self) -> None:
        """Refuse gains that are not finite.

        Raises:
            ValueError: Naming the gain.
        """
        for name in self.__slots__:
            if not np.isfinite(value := getattr(self, name)):
                raise ValueError(f"PaperGains.{name} must be finite, got {value!r}")


class TorsionSimulation:
    """Simulation of the arm behind the belt, driven by the measured joint angle.

    Between two samples the encoder tells nothing but the mean speed, so the joint is taken to move at constant speed v.
    The torsion theta_s = theta_1 - phi then oscillates freely,

        theta_s'' + 2 lambda theta_s' + w^2 theta_s = 0,   w^2 = K_s / M2(theta_1),   2 lambda = D_s / M2(theta_1),

    and where v changes from one sample to the next, theta_s' changes by the same amount. Both are solved exactly. As in
    (5b) the term with M2' is left out.
    """

    def __init__(self, params: ArmParams) -> None:
        self._plant, self._arm = params.plant(), RigidArm(params)

    def follow(
        self, memory: PaperMemory | None, begins: Flags, joint_speed: Floats, joint_angle: Floats
    ) -> PaperMemory:
        """Advance torsion and rate to this sample; at an episode's start both are zero.

        Args:
            memory: From the last sample; None at the beginning.
            begins: Which arms begin an episode, shape (n,).
            joint_speed: Measured theta_1' [rad/s], shape (n,).
            joint_angle: Measured theta_1 [rad], shape (n,).
        """
        if memory is None:
            return PaperMemory(np.zeros_like(joint_speed), np.zeros_like(joint_speed), joint_speed)
        torsion, rate = self.advance(memory.torsion, memory.torsion_rate, joint_speed - memory.joint_speed, joint_angle)
        if begins.any():
            torsion, rate = np.where(begins, 0.0, torsion), np.where(begins, 0.0, rate)
        return PaperMemory(torsion, rate, joint_speed)

    def advance(
        self, torsion: Floats, rate: Floats, speed_change: Floats, joint_angle: Floats
    ) -> tuple[Floats, Floats]:
        """Torsion [rad] and its rate [rad/s] one control period later.

        Args:
            torsion: theta_s [rad], shape (n,).
            rate: theta_s' [rad/s], shape (n,).
            speed_change: Change of the joint's mean speed between the last two periods [rad/s], shape (n,).
            joint_angle: theta_1 [rad], shape (n,).
        """
        plant = self._plant
        m2 = self._arm.link_inertia(joint_angle)
        decay = 0.5 * plant.damping / m2
        square = plant.stiffness / m2
        frequency = np.sqrt(square - decay * decay)
        rate = rate + speed_change
        envelope, phase = np.exp(-decay * CONTROL_PERIOD), frequency * CONTROL_PERIOD
        cosine, sine = envelope * np.cos(phase), envelope * np.sin(phase) / frequency
        return (
            torsion * (cosine + decay * sine) + rate * sine,
            rate * (cosine - decay * sine) - torsion * square * sine,
        )


@dataclass(frozen=True, slots=True)
class PaperMemory:
    """Memory from sample to sample; arrays of shape (n,)."""

    torsion: Floats  # simulated theta_s [rad]
    torsion_rate: Floats  # simulated theta_s' [rad/s]
    joint_speed: Floats  # measured theta_1' of the last sample [rad/s]


class PaperController(ClassicalController[PaperMemory]):
    """Eq. (11) on encoder observations. `PaperController(gains=PaperGains(torsion_speed=0))` is the rigid ablation.

    Args:
        params: The nominal arm, all that the controller knows of the plant.
        gains: Feedback gains.
    """

    def __init__(self, params: ArmParams | None = None, gains: PaperGains | None = None) -> None:
        super().__init__(params or ArmParams())
        self.gains = gains or PaperGains()
        self._simulation = TorsionSimulation(self.params)

    def law(self, reading: Reading, begins: Flags, memory: PaperMemory | None) -> tuple[Floats, PaperMemory]:
        """Torque [N m] of one sample, see `ClassicalController`."""
        p, gains = self.params, self.gains
        error, speed = reading.angle_error, reading.motor_speed
        joint_angle = reading.reference_angle - error / p.gear_ratio
        memory = self._simulation.follow(memory, begins, speed / p.gear_ratio, joint_angle)
        u_1 = p.gear_ratio * reading.reference_acceleration + gains.speed * reading.speed_error + gains.angle * error
        torque = (
            p.motor_inertia * u_1
            + p.motor_viscous_friction * speed
            + p.coulomb_friction * np.sign(reading.reference_speed)
            - gains.torsion_speed * memory.torsion_rate
        )
        return torque, memory


def rigid_controller(params: ArmParams | None = None) -> PaperController:
    """Controller of the paper without vibration feedback, K_4 = 0: computed torque and PD for a rigid arm."""
    return PaperController(params, PaperGains(torsion_speed=0.0))
