"""Motor servo along a motion planned at the move's start: computed torque, friction compensation and PID.

    tau_m = M(theta_r) theta_r'' G + 1/2 M2' theta_r'^2 / G + V_a1 G theta_r' + tau_f + push
    push = M(theta_r) (K_p (e + K_i integral of e dt) + K_v e'),    e = G theta_r - theta_a

with the planned joint angle theta_r [rad], the inertia M = M_a1 + M2 / G^2 at the motor shaft, and tau_f as in
`baselines.models.friction`. What is fed forward is that of a dead time later (`baselines.models.linear`), when the
command acts; the errors are of now. The derivative acts on the measured speed; differenced over a sample, that is the
filtered derivative of the angle. The integral holds still while the torque is at its limit and the error would drive it
further (conditional integration: Åström and Hägglund, *PID Controllers*, 1995, section 3.5).

The PID ignores the belt: those who plan the motion see to it that it is not excited. A planned motion's speed may be a
sum of ramps. A ramp gains `speed` between `onset` and `onset + time`, linearly or as 3u^2 - 2u^3, and keeps it. The
task's trapezoid is one ramp up and one down, an S-curve has smooth ramps, a shaped move several up and several down.

`Servo` and `ServoDesign` are those of all tuned servos, with or without this PID.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from baselines.controller import ScalarController, TunedController
from baselines.gains import tunable
from baselines.models.friction import Compensation, FrictionGains, compensated
from baselines.models.linear import dead_time
from baselines.models.rigid_arm import inertia_at, motor_errors, rigid_torque
from baselines.reading import Sample
from beltarm_env import CONTROL_PERIOD
from beltarm_env.arm import Plant
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled, inlined
from beltarm_env.task.reference import Reference, linear_ramp, smooth_ramp

INTEGRAL, PLAN = 0, 1
"""Place of the integral of the motor's angle error [rad s] in the memory, and of the plan that follows it."""
MOST_RAMPS = 6
ONSETS, TIMES, SPEEDS = (slice(PLAN + k * MOST_RAMPS, PLAN + (k + 1) * MOST_RAMPS) for k in range(3))
"""Places of planned ramps in the memory."""
RAMPS_END = PLAN + 3 * MOST_RAMPS


class Ramps(NamedTuple):
    """Ramps of one arm; arrays of shape (most,), of which the first few count."""

    onset: Floats  # [s] from the move's start
    time: Floats  # [s]
    speed: Floats  # gained [rad/s]


@inlined
def ramps_in(memory: Floats) -> Ramps:
    """Ramps that a law's memory holds."""
    return Ramps(memory[ONSETS], memory[TIMES], memory[SPEEDS])


@compiled
def motion_at(ramps: Ramps, count: int, smooth: bool, start: float, time: float) -> Reference:
    """Motion at `time` [s] of an arm at rest at `start` [rad] before its ramps.

    Where the acceleration jumps, it is the one after the jump.
    """
    angle, speed, acceleration = start, 0.0, 0.0
    for k in range(count):
        u = (time - ramps.onset[k]) / ramps.time[k]
        if smooth:
            area, height, slope = smooth_ramp(u)
        else:
            area, height, slope = linear_ramp(u)
        angle += ramps.speed[k] * ramps.time[k] * area
        speed += ramps.speed[k] * height
        acceleration += ramps.speed[k] / ramps.time[k] * slope
    return Reference(angle, speed, acceleration)


class ServoDesign(NamedTuple):
    """What the law of a servo knows."""

    plant: Plant  # of the design model
    compensation: Compensation
    lead: float  # dead time T [s]
    gains: Any  # named tuple, see `Gains.numbers`


class Servo(TunedController[Floats], ScalarController):
    """Base of tuned servos; a subclass names its `gains_type`, `arm_law` and `memory_size`."""

    def _known(self) -> Any:
        """What the law knows; a law that needs more than its gains has a design of its own around this one."""
        p = self.params
        return ServoDesign(p.plant(), self.gains.compensation(p), dead_time(p), self.gains.numbers())


@dataclass(frozen=True)
class PidGains(FrictionGains):
    """Gains of the motor's servo."""

    angle: float = tunable(1600.0, 10.0, 100_000.0, log=True)  # K_p  [1/s^2]
    speed: float = tunable(120.0, 5.0, 1000.0, log=True)  # K_v  [1/s]
    integral: float = tunable(2.0, 0.01, 100.0, log=True)  # K_i  [1/s]


@inlined
def pid_torque(
    design: ServoDesign, now: Sample, wanted: Reference, led: Reference, torque: float, memory: Floats
) -> float:
    """Motor torque [N m] of the servo.

    Args:
        design: Model and gains.
        now: What is measured.
        wanted: Motion of the joint at this sample.
        led: The motion a dead time later.
        torque: What it takes then, but for dry friction [N m].
        memory: Whose entry `INTEGRAL` is advanced.
    """
    plant, gains, integral = design.plant, design.gains, memory[INTEGRAL]
    error, speed_error = motor_errors(now, wanted, plant.gear)
    pid = gains.angle * (error + gains.integral * integral) + gains.speed * speed_error
    push = inertia_at(wanted.angle, plant) * pid
    friction, _ = compensated(led, push, plant.gear, design.compensation)
    total = torque + friction + push
    winding = abs(total) > plant.torque_limit and total * error > 0
    memory[INTEGRAL] = integral if winding else integral + CONTROL_PERIOD * error
    return total


@inlined
def rigid_pid_torque(design: ServoDesign, now: Sample, wanted: Reference, led: Reference, memory: Floats) -> float:
    """Motor torque [N m] of the servo with the feed-forward of a rigid arm; arguments as of `pid_torque`."""
    plant = design.plant
    torque = rigid_torque(led, plant) + plant.viscous_friction * plant.gear * led.speed
    return pid_torque(design, now, wanted, led, torque, memory)


@inlined
def ramp_torque(design: ServoDesign, now: Sample, ramps: Ramps, count: int, smooth: bool, memory: Floats) -> float:
    """Motor torque [N m] of the servo on a rigid arm along the first `count` of some ramps, `smooth` or linear."""
    time = CONTROL_PERIOD * now.step
    wanted = motion_at(ramps, count, smooth, now.start, time)
    led = motion_at(ramps, count, smooth, now.start, time + design.lead)
    return rigid_pid_torque(design, now, wanted, led, memory)


class PidServo(Servo):
    """Base of servos with this PID, which plan its motion."""
