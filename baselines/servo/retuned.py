"""The paper's controller with the inertia of the links, a friction law at rest, and tuned gains.

The structure is that of (11): computed torque, PD and torsional-velocity feedback,

    tau_m = M(theta_ref) u_1 + 1/2 M2' theta_ref'^2 / G + V_a1 theta_a' + tau_f - K_4 theta_s'
    u_1 = theta_a_ref'' + K_v (theta_a_ref' - theta_a') + K_p (theta_a_ref - theta_a)                       (9)

with the design model's parameters, and theta_s' from the paper's simulation of the arm on encoder data
(`TorsionSimulation`).
Different from `PaperController`:

- M(theta) = M_a1 + M2(theta) / G^2 is the inertia of motor and links, as in (4), where (11) has the motor's alone. With
  the term of M2' this is the exact inverse dynamics of a rigid arm; see `baselines.models.rigid_arm`.
- tau_f has a law at rest. It follows the push of the feedback, M (K_v ... + K_p ...) - K_4 theta_s', so that neither
  the PD nor the vibration feedback is swallowed by stiction. With Table 2's gains and no such law the motor can rest
  up to tau_c / (M_a1 K_p) = 20 rad away, 13 degrees at the joint.
- What is fed forward is that of a dead time later (`baselines.models.actuator`), when the command acts.
- All gains are tuned.

What they trade: K_4 damps by accelerating the motor against theta_s', which it can as long as the PD is slower than the
mode. A PD that is stiff enough to hold the motor on its reference despite friction holds it against K_4 as well.
"""

from __future__ import annotations

from dataclasses import dataclass

from baselines.controller import ClassicalController
from baselines.gains import tunable
from baselines.models.actuator import dead_time
from baselines.models.friction import FrictionGains, commanded_direction, dry_friction, friction_level
from baselines.models.ramps import task_motion
from baselines.models.rigid_arm import RigidArm, motor_errors
from baselines.reading import Reading
from baselines.servo.paper import PaperMemory, TorsionSimulation
from beltarm_env import ArmParams
from beltarm_env.arrays import Flags, Floats


@dataclass(frozen=True)
class RetunedGains(FrictionGains):
    """Gains of (11)."""

    torsion_speed: float = tunable(0.002, 1e-4, 2.0, log=True)  # K_4  [N m s/rad]
    angle: float = tunable(400.0, 1.0, 10_000.0, log=True)  # K_p  [1/s^2]
    speed: float = tunable(20.0, 1.0, 1000.0, log=True)  # K_v  [1/s]


class RetunedController(ClassicalController[PaperMemory]):
    """Eq. (11) with the inertia of the links, stiction compensated, and gains of its own.

    Args:
        gains: Feedback gains.
        params: The design model.
    """

    def __init__(self, gains: RetunedGains | None = None, params: ArmParams | None = None) -> None:
        super().__init__(params)
        self.gains = gains or RetunedGains()
        self._arm = RigidArm(self.params)
        self._row = self.params.row()
        self._lead = dead_time(self.params)
        self._simulation = TorsionSimulation(self.params)

    def law(self, reading: Reading, begins: Flags, memory: PaperMemory | None) -> tuple[Floats, PaperMemory]:
        """Torque [N m] of one sample, see `ClassicalController`."""
        p, gains, speed = self.params, self.gains, reading.motor_speed
        memory = self._simulation.follow(memory, begins, speed / p.gear_ratio, reading.motor_angle / p.gear_ratio)
        wanted, led = task_motion(reading), task_motion(reading, self._lead)
        error, speed_error = motor_errors(reading, wanted, p)
        servo = self._arm.inertia(wanted.angle) * (gains.speed * speed_error + gains.angle * error)
        push = servo - gains.torsion_speed * memory.torsion_rate
        level = gains.friction * friction_level(dry_friction(self._row), p.gear_ratio * led.speed)
        friction = level * commanded_direction(led, push, gains.rest_width)
        torque = self._arm.torque(led) + p.motor_viscous_friction * speed + friction + push
        return torque, memory
