"""Motion of the joint: the task's, inverse dynamics of the arm with a rigid belt along one, and errors of the motor.

With a rigid belt (phi = theta_1 = theta_a / G), (5a) and the completed (5b) add up to one equation at the motor shaft:

    tau_m = (M_a1 + M2 / G^2) theta_a'' + 1/2 M2' theta_1'^2 / G + V_a1 theta_a' + tau_f
    M2 = M2(0) + S sin^2(theta_1),    1/2 M2' = 1/2 S sin(2 theta_1)

with the inertias M_a1 of the motor and M2 of the links about joint 1 [kg m^2], the gear ratio G, viscous friction
V_a1 [N m s/rad] and Coulomb friction tau_f [N m]. Leaving the middle term out, this is the paper's (4).
"""

from __future__ import annotations

from baselines.models.linear import turning_load
from baselines.reading import Sample, move_of
from beltarm_env import CONTROL_PERIOD
from beltarm_env.arm import Plant
from beltarm_env.engine import inlined
from beltarm_env.task.reference import TRAPEZOID, Reference, reference_at


@inlined
def task_motion(now: Sample, lead: float) -> Reference:
    """Motion of the task's trapezoid, `lead` seconds after this sample."""
    return reference_at(TRAPEZOID, move_of(now), CONTROL_PERIOD * now.step + lead)


@inlined
def motor_errors(now: Sample, wanted: Reference, gear: float) -> tuple[float, float]:
    """Errors of the motor's angle [rad] and speed [rad/s]: those of a motion of the joint minus the measured ones.

    The angle's is the observed one, to which the motion's distance from the task's reference is added: small numbers,
    whose last digits float32 keeps.
    """
    return now.angle_error + gear * (wanted.angle - now.reference_angle), gear * wanted.speed - now.motor_speed


@inlined
def inertia_at(angle: float, plant: Plant) -> float:
    """M_a1 + M2 / G^2 at a joint angle [rad]: all inertia, at the motor shaft [kg m^2]."""
    m2, _ = turning_load(angle, 0.0, plant)
    return 1 / plant.inverse_motor_inertia + m2 / (plant.gear * plant.gear)


@inlined
def link_torque(wanted: Reference, plant: Plant) -> float:
    """Motor torque that moves the links alone [N m]."""
    m2, turning = turning_load(wanted.angle, wanted.speed, plant)
    return (m2 * wanted.acceleration + turning) / plant.gear


@inlined
def rigid_torque(wanted: Reference, plant: Plant) -> float:
    """Motor torque of a motion, but for friction [N m]."""
    return plant.gear * wanted.acceleration / plant.inverse_motor_inertia + link_torque(wanted, plant)
