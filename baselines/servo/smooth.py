"""PID along a smooth profile that takes as long as the task's move.

The reference is an S-curve: ramps of the speed with the shape 3u^2 - 2u^3, whose acceleration is the parabola
6u(1 - u). Of a ramp that takes t, an undamped mode w is left with the amplitude of the parabola's Fourier transform,

    3 |sin x - x cos x| / x^3,    x = w t / 2,

which is zero first at tan x = x, x = 4.493: a ramp of 1.43 periods leaves the mode at rest, one of a longer time leaves
8.6 % at most. So each ramp gets at least that many periods of the mode with the motor held, as it is at the start for
the ramp up and at the goal for the ramp down. Ramps are not shorter than the task's, unless both together would then
be longer than the move. Against the task's trapezoid the S-curve lags at first and leads at last, which counts as tip
error.
"""

from __future__ import annotations

from dataclasses import dataclass

from baselines.gains import tunable
from baselines.models.linear import held_mode
from baselines.reading import Sample, move_of
from baselines.servo.pid import INTEGRAL, RAMPS_END, PidGains, PidServo, Ramps, ServoDesign, ramp_torque, ramps_in
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled
from beltarm_env.task.reference import MoveShape


@dataclass(frozen=True)
class SmoothGains(PidGains):
    """Gains of the servo, and the smoothness of the profile."""

    ramp: float = tunable(1.43, 0.1, 5.0)  # [periods of the mode]  least time of a ramp


@compiled
def plan_smooth(design: ServoDesign, move: MoveShape, ramps: Ramps) -> None:
    """Write the first two ramps: one up and one down."""
    plant, ramp = design.plant, design.gains.ramp
    up = max(move.ramp_time, ramp * held_mode(move.start, plant).period)
    down = max(move.ramp_time, ramp * held_mode(move.goal, plant).period)
    share = min(1.0, move.duration / (up + down))
    up, down = share * up, share * down
    cruise = (move.goal - move.start) / (move.duration - 0.5 * (up + down))
    ramps.onset[0], ramps.time[0], ramps.speed[0] = 0.0, up, cruise
    ramps.onset[1], ramps.time[1], ramps.speed[1] = move.duration - down, down, -cruise


@compiled
def smooth_law(design: ServoDesign, now: Sample, begins: bool, memory: Floats) -> float:
    """Motor torque [N m] for one arm, see `LawKernel`; the memory is the integral and the ramps."""
    ramps = ramps_in(memory)
    if begins:
        memory[INTEGRAL] = 0.0
        plan_smooth(design, move_of(now), ramps)
    return ramp_torque(design, now, ramps, 2, True, memory)


class SmoothController(PidServo):
    """PID along an S-curve."""

    gains_type = SmoothGains
    needs_vibration = True
    arm_law = staticmethod(smooth_law)
    memory_size = RAMPS_END
