"""PID along a reference that input shapers keep from ringing the belt.

A shaper replaces a command by several, delayed by t_i and weighted with A_i > 0, so that the vibrations that they start
cancel. Half a damped period T / 2 apart, with K = exp(-pi zeta / sqrt(1 - zeta^2)) the decay over it,

    A_i = c w_i K^i,    t_i = i T / 2,    sum of A_i = 1

    ZV   w = (1, 1)                         vibration is zero at the modelled mode
    ZVD  w = (1, 2, 1)                      and its derivative by the frequency too
    EI   w = (1 + V, 2 (1 - V), 1 + V)      it is V there, and zero at a frequency above and one below

(ZV, ZVD: Singer and Seering 1990; EI, extra-insensitive, with the vibration limit V: Singhose, Seering and Singer 1994,
exact for zeta = 0; with damping the vibration at the modelled mode is at most V.)

**Which mode.** Accelerating excites the arm where it is then, so the ramp up of the task's trapezoid is shaped for the
mode at the start, and the ramp down for the mode at the goal. The motor is held by its servo, so the mode is that of a
fixed motor, see `baselines.models.linear`.

**What delays.** A shaper delays by d = sum of A_i t_i, 0.02 to 0.17 s, which counts in full against the task. But the
whole move is known ahead. So

- ramps of time t_r are shortened to t = t_r - 2 d, but not below `shortest_ramp` (nor lengthened): a shaped ramp then
  takes as long as the task's and has its centre where the task's has it;
- the ramp down begins as early as it must for that. The ramp up cannot begin before the move, and what is left of its
  delay is made up for by a higher speed between the two, which keeps the distance right.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from baselines.gains import tunable
from baselines.models.linear import Mode, held_mode
from baselines.reading import Sample, move_of
from baselines.servo.pid import INTEGRAL, RAMPS_END, PidGains, PidServo, Ramps, ServoDesign, ramp_torque, ramps_in
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled, inlined
from beltarm_env.task.reference import MoveShape


@dataclass(frozen=True)
class ShapingGains(PidGains):
    """Gains of the servo, and of a ZV or ZVD shaper."""

    shortest_ramp: float = tunable(0.03, 0.002, 0.5, log=True)  # [s]  before shaping
    frequency: float = tunable(1.0, 0.5, 1.5)  # [-]  of the mode shaped for, over that of the design model


@dataclass(frozen=True)
class ExtraInsensitiveGains(ShapingGains):
    """Gains of the servo, and of an EI shaper."""

    vibration: float = tunable(0.05, 0.0, 0.5)  # V  [-]  limit of the vibration, of the unshaped one


class ShapingDesign(NamedTuple):
    """What the law knows."""

    servo: ServoDesign
    shares: Floats  # w_i, shape (impulses,)


@inlined
def write_impulses(shares: Floats, mode: Mode, first: int, ramps: Ramps) -> float:
    """Write a shaper's weights A_i as speeds of ramps, and its delays t_i [s] as their onsets; return its delay d [s].

    Args:
        shares: w_i, shape (impulses,).
        mode: Not to be excited.
        first: Ramp of the first impulse.
        ramps: Written.
    """
    power, total, delay = 1.0, 0.0, 0.0
    for k in range(len(shares)):
        ramps.speed[first + k], ramps.onset[first + k] = shares[k] * power, 0.5 * mode.period * k
        total += shares[k] * power
        power *= mode.decay
    for k in range(first, first + len(shares)):
        ramps.speed[k] /= total
        delay += ramps.speed[k] * ramps.onset[k]
    return delay


@inlined
def _shape(design: ShapingDesign, angle: float, ramp: float, first: int, ramps: Ramps) -> float:
    """Write a ramp's impulses and times; return the centre of the shaped ramp, from its onset [s]."""
    mode = held_mode(angle, design.servo.plant)
    delay = write_impulses(design.shares, Mode(mode.period / design.servo.gains.frequency, mode.decay), first, ramps)
    time = min(ramp, max(ramp - 2 * delay, design.servo.gains.shortest_ramp))
    for k in range(first, first + len(design.shares)):
        ramps.time[k] = time
    return delay + 0.5 * time


@compiled
def plan_shaped(design: ShapingDesign, move: MoveShape, ramps: Ramps) -> None:
    """Write the first ramps: one up and then one down for each impulse of the shaper."""
    count = len(design.shares)
    up_centre = _shape(design, move.start, move.ramp_time, 0, ramps)
    down_centre = _shape(design, move.goal, move.ramp_time, count, ramps)
    begin = max(0.5 * move.ramp_time - up_centre, 0.0)
    brake = move.duration - 0.5 * move.ramp_time - down_centre
    between, least = brake + down_centre - begin - up_centre, 0.5 * (move.duration - move.ramp_time)
    if between < least:  # a move too short for its shaper ends late
        between = least
        brake = begin + up_centre + between - down_centre
    cruise = (move.goal - move.start) / between
    for k in range(count):
        ramps.onset[k] += begin
        ramps.speed[k] *= cruise
        ramps.onset[count + k] += brake
        ramps.speed[count + k] *= -cruise


@compiled
def shaping_law(design: ShapingDesign, now: Sample, begins: bool, memory: Floats) -> float:
    """Motor torque [N m] for one arm, see `LawKernel`; the memory is the integral and the ramps."""
    ramps = ramps_in(memory)
    if begins:
        memory[INTEGRAL] = 0.0
        plan_shaped(design, move_of(now), ramps)
    return ramp_torque(design.servo, now, ramps, 2 * len(design.shares), False, memory)


class ZvController(PidServo):
    """PID along a trapezoid shaped by ZV."""

    gains_type = ShapingGains
    needs_vibration = True
    arm_law = staticmethod(shaping_law)
    memory_size = RAMPS_END

    def shares(self) -> tuple[float, ...]:
        """The shaper's w_i."""
        return 1.0, 1.0

    def _known(self) -> ShapingDesign:
        return ShapingDesign(super()._known(), np.array(self.shares()))


class ZvdController(ZvController):
    """PID along a trapezoid shaped by ZVD."""

    def shares(self) -> tuple[float, ...]:
        """The shaper's w_i."""
        return 1.0, 2.0, 1.0


class EiController(ZvController):
    """PID along a trapezoid shaped by EI."""

    gains_type = ExtraInsensitiveGains

    def shares(self) -> tuple[float, ...]:
        """The shaper's w_i."""
        limit = self.gains.vibration
        return 1 + limit, 2 * (1 - limit), 1 + limit
