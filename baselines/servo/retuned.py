"""The paper's controller with the inertia of the links, a friction law at rest, and tuned gains.

The structure is that of (11): computed torque, PD and torsional-velocity feedback,

    tau_m = M(theta_ref) u_1 + 1/2 M2' theta_ref'^2 / G + V_a1 theta_a' + tau_f - K_4 theta_s'
    u_1 = theta_a_ref'' + K_v (theta_a_ref' - theta_a') + K_p (theta_a_ref - theta_a)                       (9)

with the design model's parameters, and theta_s' from the paper's simulation of the arm on encoder data.
Different from `PaperController`:

- M(theta) = M_a1 + M2(theta) / G^2 is the inertia of motor and links, as in (4), where (11) has the motor's alone. With
  the term of M2' this is the exact inverse dynamics of a rigid arm; see `baselines.models.rigid_arm`.
- tau_f has a law at rest. It follows the push of the feedback, M (K_v ... + K_p ...) - K_4 theta_s', so that neither
  the PD nor the vibration feedback is swallowed by stiction. With Table 2's gains and no such law the motor can rest
  up to tau_c / (M_a1 K_p) = 20 rad away, 13 degrees at the joint.
- What is fed forward is that of a dead time later (`baselines.models.actuator`), when the command acts.
- All gains are tuned.

K_4 damps as long as the PD is slower than the mode: one that holds the motor despite friction holds it against K_4 too.
"""

from __future__ import annotations

from dataclasses import dataclass

from baselines.gains import tunable
from baselines.models.friction import FrictionGains, compensated
from baselines.models.ramps import task_motion
from baselines.models.rigid_arm import inertia_at, motor_errors, rigid_torque
from baselines.reading import Sample
from baselines.servo.paper import PaperController, simulated_rate
from baselines.servo.servo import Servo, ServoDesign
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled


@dataclass(frozen=True)
class RetunedGains(FrictionGains):
    """Gains of (11)."""

    torsion_speed: float = tunable(0.002, 1e-4, 2.0, log=True)  # K_4  [N m s/rad]
    angle: float = tunable(400.0, 1.0, 10_000.0, log=True)  # K_p  [1/s^2]
    speed: float = tunable(20.0, 1.0, 1000.0, log=True)  # K_v  [1/s]


@compiled
def retuned_law(design: ServoDesign, now: Sample, begins: bool, memory: Floats) -> float:
    """Motor torque [N m] for one arm, with the memory of `baselines.servo.paper`; see `LawKernel`."""
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
    arm_law = staticmethod(retuned_law)
    memory_size = PaperController.memory_size
