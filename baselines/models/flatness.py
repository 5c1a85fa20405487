"""Flatness of the arm: a smoothed move of the link, and the state and torque of motor and belt that follow from it.

Without Coulomb friction the arm is differentially flat [1], and the link's angle phi is its flat output: with T the
belt's torque of (5b),

    T = M2 phi'' + 1/2 M2' phi'^2
    theta_s'' = T'' / K_s behind a lag tau = D_s / K_s
    theta_s' = T' / K_s - tau theta_s'',    theta_s = T / K_s - tau theta_s',    theta_1 = phi + theta_s
    tau_m = M_a1 G theta_1'' + V_a1 G theta_1' + T / G                                                    (5a)

with T'' from derivatives of phi up to the fourth. The lag is the belt's own, 0.9 ms for the nominal arm. It is applied
to what jumps in T'', phi'''', and left out for the rest: exact for an undamped belt; the nominal arm's
link ends up less than 0.1 mrad off.

The task, a trapezoid of the speed, has no phi''''. So each of the four jumps of its acceleration, the corners of the
trapezoid, is spread over a time w by convolution with two boxes of w / 2. The acceleration then consists of parabolas,
and phi'''' is piecewise constant.

**Where the corners go.** The move is known beforehand, so smoothing need not delay it: corners spread to both sides.
Only the first has nothing before it. It is spread over [0, w_1], centred at t_1 = w_1 / 2, and the second corner and
the ramp's acceleration a make up for it: with the variance w^2 / 24 of a spread and a ramp time t_r,

    c = t_r / 2 - t_1,    t_2 - t_1 = c + sqrt(c^2 + (w_1^2 - w_2^2) / 24),    a = cruising speed / (t_2 - t_1),

after which speed and angle are the task's again. The last two corners stay where the task has them.

[1] Fliess, Lévine, Martin, Rouchon: Flatness and defect of non-linear systems, Int. J. Control, 1995.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from baselines.gains import Gains, tunable
from baselines.models.linear import held_mode
from beltarm_env.arm import Plant
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled, inlined
from beltarm_env.physics.trigonometry import exponential, sine_cosine
from beltarm_env.task.reference import MoveShape

_SPREADS = 4
CORNERS = 1 + 3 * _SPREADS
"""Entries of a smoothed move of one arm: the start, four onsets, four times and four jumps."""
_LONGEST_FIRST, _LONGEST = 0.5, 1.0  # spreads over the ramp time: so that the corners keep their order
_SHORTEST_LAG = 1e-12  # [s]  instead of none
_SETTLED = 40.0  # lags after which a step is over, to the last digit


@dataclass(frozen=True)
class SpreadGains(Gains):
    """Smoothness of the move: times over which the corners of its trapezoid are spread."""

    first_spread: float = tunable(0.3, 0.02, 2.0, log=True)  # [periods]  of the first corner
    spread: float = tunable(0.6, 0.02, 4.0, log=True)  # [periods]  of the others


class FlatPoint(NamedTuple):
    """State of motor and belt along a smoothed move at one instant, and what moves the motor."""

    motor_angle: float  # theta_a [rad]
    motor_speed: float  # [rad/s]
    torsion: float  # theta_s [rad]
    torsion_speed: float  # [rad/s]
    torque: float  # tau_m without Coulomb friction [N m]
    acceleration: float  # of the motor [rad/s^2]


@compiled
def write_corners(move: MoveShape, plant: Plant, first: float, others: float, corners: Floats) -> None:
    """Smooth the trapezoid of a move.

    Args:
        move: What is asked of the arm.
        plant: The arm whose mode spreads are measured in.
        first: Time w_1 of the first corner's spread, in periods of the mode at the start; half a ramp at most.
        others: Of the other corners' spreads, in periods of the mode at the end of the ramp up and at the goal; a whole
            ramp at most.
        corners: Written, shape (CORNERS,): phi at the start [rad], and of each of four spreads the onset [s] from the
            move's start, the time w [s] and the jump of the acceleration [rad/s^2].
    """
    ramp = move.ramp_time
    cruise = (move.goal - move.start) / (move.duration - ramp)
    longest = _LONGEST * ramp
    w1 = min(first * held_mode(move.start, plant).period, _LONGEST_FIRST * ramp)
    w2 = min(others * held_mode(move.start + 0.5 * cruise * ramp, plant).period, longest)
    w3 = min(others * held_mode(move.goal, plant).period, longest)
    centred = 0.5 * (ramp - w1)
    up = centred + math.sqrt(centred * centred + (w1 * w1 - w2 * w2) / 24)
    jump, task_jump = cruise / up, cruise / ramp
    last = move.duration - 0.5 * w3
    corners[0] = move.start
    corners[1], corners[2], corners[3], corners[4] = 0.0, 0.5 * w1 + up - 0.5 * w2, last - ramp, last
    corners[5], corners[6], corners[7], corners[8] = w1, w2, w3, w3
    corners[9], corners[10], corners[11], corners[12] = jump, -jump, -task_jump, task_jump


@inlined
def _lagging(time: float, lag: float) -> float:
    """Unit step at time 0 behind a lag."""
    if time <= 0.0:
        return 0.0
    return 1.0 - exponential(-time / lag) if time < _SETTLED * lag else 1.0


@compiled
def link_motion(corners: Floats, time: float, lag: float) -> tuple[float, float, float, float, float]:
    """Return phi along a smoothed move at a time [s], and its four derivatives [rad, s], the last behind a lag [s]."""
    p, v, a, j, lagging = corners[0], 0.0, 0.0, 0.0, 0.0
    for k in range(_SPREADS):
        w, size = corners[1 + _SPREADS + k], corners[1 + 2 * _SPREADS + k]
        since = time - corners[1 + k]
        u = since / w
        c = min(max(u, 0.0), 1.0)
        beyond = w * max(u - 1.0, 0.0)
        r = max(c - 0.5, 0.0)  # in the falling half of the spread's triangle
        c2, r2 = c * c, r * r
        p += size * (w * w * (c2 * c2 / 6 - r2 * r2 / 3) + beyond * (0.5 * w + 0.5 * beyond))
        v += size * (w * (2 * c2 * c / 3 - 4 * r2 * r / 3) + beyond)
        a += size * (2 * c2 - 4 * r2)
        j += size / w * (4 * c - 8 * r)
        steps = 4 * _lagging(since, lag) - 8 * _lagging(since - 0.5 * w, lag) + 4 * _lagging(since - w, lag)
        lagging += size / (w * w) * steps
    return p, v, a, j, lagging


@compiled
def flat_point(corners: Floats, time: float, plant: Plant) -> FlatPoint:
    """State and torque along a smoothed move, `corners` of `write_corners`, at a time [s] since its start."""
    gear, stiffness, swing = plant.gear, plant.stiffness, plant.inertia_swing
    lag = max(plant.damping / stiffness, _SHORTEST_LAG)
    p, v, a, j, lagging = link_motion(corners, time, lag)
    sine, cosine = sine_cosine(p)
    m2 = plant.inertia + swing * sine * sine
    slope, bend = 2 * swing * sine * cosine, 2 * swing * (1 - 2 * sine * sine)
    belt = m2 * a + 0.5 * slope * v * v
    rate = m2 * j + 2 * slope * v * a + 0.5 * bend * v * v * v
    curve = m2 * lagging + 3 * slope * v * j + 2 * slope * a * a + 3.5 * bend * v * v * a - 2 * slope * v * v * v * v
    torsion_speed = (rate - lag * curve) / stiffness
    torsion = belt / stiffness - lag * torsion_speed
    speed, acceleration = gear * (v + torsion_speed), gear * (a + curve / stiffness)
    torque = acceleration / plant.inverse_motor_inertia + plant.viscous_friction * speed + belt / gear
    return FlatPoint(gear * (p + torsion), speed, torsion, torsion_speed, torque, acceleration)
