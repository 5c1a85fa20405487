"""The industrial answer: a smoothed move's exact motion and torque fed forward, and a well-damped PID on the motor.

    tau_m = tau_flat(t + T + h/2) + tau_f + push
    push = M (K_p (e + K_i integral of e dt) + K_v e'),    e = G theta_1,flat(t) - theta_a

The corners of the task's trapezoid are spread, and state and torque of motor *and* belt along it follow in closed form
(`baselines.models.flatness`; Fliess, Lévine, Martin and Rouchon 1995). So the motor is not asked to follow the link's
reference, as under a rigid arm's torque, but to be ahead of it by the torsion that moves the link; then the belt is at
rest where the link is, as far as the arm is the design model. That a PD on the motors of robots with elastic joints
needs no state of the links is Tomei's (1991); fed forward with their flat motion and torque it is De Luca's (2000).

The servo is `baselines.servo.pid`, blind to the belt: what rings, rings on. The torque is the one in the middle of the
sample over which it is held, a dead time T later.
"""

from __future__ import annotations

from dataclasses import dataclass

from baselines.gains import tunable
from baselines.models.flatness import CORNERS, SpreadGains, flat_point, write_corners
from baselines.reading import Sample, move_of
from baselines.servo.pid import INTEGRAL, PLAN, PidGains, PidServo, ServoDesign, pid_torque
from beltarm_env import CONTROL_PERIOD
from beltarm_env.arm import Plant
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled, inlined
from beltarm_env.task.reference import Reference

_MOVE = slice(PLAN, PLAN + CORNERS)  # of the memory: the smoothed move


@dataclass(frozen=True)
class FlatGains(PidGains, SpreadGains):
    """Smoothness of the move, and gains of the servo."""

    rest_width: float = tunable(0.06, 0.0001, 0.3, log=True)  # [N m]  push compensated in full while at rest


@inlined
def joint_motion(corners: Floats, time: float, plant: Plant) -> Reference:
    """Motion of the joint along a smoothed move, a time [s] since its start."""
    flat = flat_point(corners, time, plant)
    return Reference(flat.motor_angle / plant.gear, flat.motor_speed / plant.gear, flat.acceleration / plant.gear)


@inlined
def held_torque(corners: Floats, time: float, plant: Plant) -> float:
    """Motor torque [N m] of the sample that begins a time [s] after the start of a smoothed move."""
    return flat_point(corners, time + 0.5 * CONTROL_PERIOD, plant).torque


@compiled
def flat_law(design: ServoDesign, now: Sample, begins: bool, memory: Floats) -> float:
    """Motor torque [N m] for one arm, see `LawKernel`; the memory is the integral and the smoothed move."""
    corners, plant = memory[_MOVE], design.plant
    if begins:
        memory[INTEGRAL] = 0.0
        write_corners(move_of(now), plant, design.gains.first_spread, design.gains.spread, corners)
    time = CONTROL_PERIOD * now.step
    later = time + design.lead
    wanted, led = joint_motion(corners, time, plant), joint_motion(corners, later, plant)
    return pid_torque(design, now, wanted, led, held_torque(corners, later, plant), memory)


class FlatController(PidServo):
    """PID about a flat motion."""

    gains_type = FlatGains
    needs_vibration = True
    arm_law = staticmethod(flat_law)
    memory_size = PLAN + CORNERS
