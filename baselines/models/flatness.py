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

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from baselines.gains import Gains, tunable
from baselines.models.modes import held_mode
from beltarm_env import ArmParams
from beltarm_env.arm import params_table, plant_of
from beltarm_env.arrays import Floats
from beltarm_env.jit import compiled, inlined

_LONGEST_FIRST, _LONGEST = 0.5, 1.0  # spreads over the ramp time: so that the corners keep their order
_SHORTEST_LAG = 1e-12  # [s]  instead of none


@dataclass(frozen=True)
class SpreadGains(Gains):
    """Smoothness of the move: times over which the corners of its trapezoid are spread."""

    first_spread: float = tunable(0.3, 0.02, 2.0, log=True)  # [periods]  of the first corner
    spread: float = tunable(0.6, 0.02, 4.0, log=True)  # [periods]  of the others


class Corners(NamedTuple):
    """Smoothed trapezoids of n arms: four jumps of the acceleration, each spread over a time."""

    start: Floats  # phi at the start [rad], shape (n,)
    onset: Floats  # of a spread [s] from the move's start, shape (n, 4)
    time: Floats  # of a spread, w [s], shape (n, 4)
    jump: Floats  # [rad/s^2], shape (n, 4)


class FlatMotion(NamedTuple):
    """State and torque along a smoothed move; n arms at one instant each."""

    link: Floats  # phi and its first four derivatives [rad/s^k], shape (n, 5)
    state: Floats  # x = [theta_a, omega_a, theta_s, omega_s], shape (n, 4)
    torque: Floats  # tau_m without Coulomb friction [N m], shape (n,)
    acceleration: Floats  # of the motor [rad/s^2], shape (n,)


def smoothed(moves: Floats, params: ArmParams, first: float, others: float) -> Corners:
    """Smooth the trapezoids of n moves.

    Args:
        moves: Start, goal [rad], duration, ramp time [s]; shape (n, 4).
        params: The arm whose mode spreads are measured in.
        first: Time w_1 of the first corner's spread, in periods of the mode at the start; half a ramp at most.
        others: Of the other corners' spreads, in periods of the mode at the end of the ramp up and at the goal; a whole
            ramp at most.

    Raises:
        ValueError: If moves have another shape, or a spread takes no time.
    """
    if moves.ndim != 2 or moves.shape[1] != 4:
        raise ValueError(f"moves must have shape (n, 4): start, goal, duration, ramp time; got {moves.shape}")
    if not (0 < first < np.inf and 0 < others < np.inf):
        raise ValueError(f"spreads of corners must be positive numbers of periods, got {first!r} and {others!r}")
    start, goal, duration, ramp = moves.T
    cruise = (goal - start) / (duration - ramp)
    longest = _LONGEST * ramp
    w1 = np.minimum(first * held_mode(params, start).period, _LONGEST_FIRST * ramp)
    w2 = np.minimum(others * held_mode(params, start + 0.5 * cruise * ramp).period, longest)
    w3 = np.minimum(others * held_mode(params, goal).period, longest)
    centred = 0.5 * (ramp - w1)
    up = centred + np.sqrt(centred * centred + (w1 * w1 - w2 * w2) / 24)
    jump, task_jump = cruise / up, cruise / ramp
    centre = np.column_stack([0.5 * w1, 0.5 * w1 + up, duration - ramp, duration])
    time = np.column_stack([w1, w2, w3, w3])
    return Corners(start.copy(), centre - 0.5 * time, time, np.column_stack([jump, -jump, -task_jump, task_jump]))


@inlined
def _lagging(time: float, lag: float) -> float:
    """Unit step at time 0 behind a lag."""
    return 1.0 - np.exp(-time / lag) if time > 0.0 else 0.0


@compiled
def _flat_motions(
    start: Floats,
    onset: Floats,
    spread: Floats,
    jump: Floats,
    time: Floats,
    row: Floats,
    link: Floats,
    state: Floats,
    torque: Floats,
    acceleration: Floats,
) -> None:
    plant = plant_of(row)
    gear, stiffness = plant.gear, plant.stiffness
    lag = max(plant.damping / stiffness, _SHORTEST_LAG)
    for i in range(len(time)):
        p, v, a, j, s, lagging = start[i], 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(onset.shape[1]):
            w, size = spread[i, k], jump[i, k]
            since = time[i] - onset[i, k]
            u = since / w
            c = min(max(u, 0.0), 1.0)
            beyond = w * max(u - 1.0, 0.0)
            r = max(c - 0.5, 0.0)  # in the falling half of the spread's triangle
            p += size * (w * w * (c**4 / 6 - r**4 / 3) + beyond * (0.5 * w + 0.5 * beyond))
            v += size * (w * (2 * c**3 / 3 - 4 * r**3 / 3) + beyond)
            a += size * (2 * c * c - 4 * r * r)
            j += size / w * (4 * c - 8 * r)
            s += size / (w * w) * (0.0 if u < 0.0 or u >= 1.0 else (4.0 if u < 0.5 else -4.0))
            steps = 4 * _lagging(since, lag) - 8 * _lagging(since - 0.5 * w, lag) + 4 * _lagging(since - w, lag)
            lagging += size / (w * w) * steps
        link[i, 0], link[i, 1], link[i, 2], link[i, 3], link[i, 4] = p, v, a, j, s
        m2 = plant.inertia + plant.inertia_swing * np.sin(p) ** 2
        slope, bend = plant.inertia_swing * np.sin(2 * p), 2 * plant.inertia_swing * np.cos(2 * p)
        belt = m2 * a + 0.5 * slope * v * v
        rate = m2 * j + 2 * slope * v * a + 0.5 * bend * v**3
        curve = m2 * lagging + 3 * slope * v * j + 2 * slope * a * a + 3.5 * bend * v * v * a - 2 * slope * v**4
        state[i, 3] = (rate - lag * curve) / stiffness
        state[i, 2] = belt / stiffness - lag * state[i, 3]
        state[i, 0], state[i, 1] = gear * (p + state[i, 2]), gear * (v + state[i, 3])
        acceleration[i] = gear * (a + curve / stiffness)
        torque[i] = acceleration[i] / plant.inverse_motor_inertia + plant.viscous_friction * state[i, 1] + belt / gear


def flat_motion(corners: Corners, time: Floats, params: ArmParams) -> FlatMotion:
    """Motion, state and torque at times [s] since the moves' starts, shape (n,); phi'''' is right-continuous."""
    count = len(time)
    motion = FlatMotion(np.empty((count, 5)), np.empty((count, 4)), np.empty(count), np.empty(count))
    _flat_motions(*corners, np.ascontiguousarray(time, np.float64), params_table([params])[0], *motion)
    return motion
