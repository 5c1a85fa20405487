"""Torque of a motor that follows its command late, as a Runge-Kutta step needs it.

The motor's torque lags behind its command, and the command changes when it arrives, somewhere within a sample. A step
would resolve neither. But each of its four stages may take a torque of its own. Of a linear arm x' = A x + b tau(t),
the exact step has tau in it only by its moments

    m_k = 1 / h^k integral of (h - t)^(k-1) / (k-1)! tau(t) dt over the step of length h

and the stages of the classical method have b, A b, A^2 b and A^3 b in it with

    (tau_1 + 2 tau_2 + 2 tau_3 + tau_4) / 6,   (tau_1 + tau_2 + tau_3) / 6,   (tau_1 + tau_2) / 12,   tau_1 / 24

These are the first four moments for exactly one choice of the stages' torques. With it, a step is as exact as with a
torque that does not change, whatever the torque does within it. The moments of a lag are in closed form.
"""

from __future__ import annotations

from typing import NamedTuple

from beltarm_env.engine import inlined
from beltarm_env.physics.drive import decay


class Stages(NamedTuple):
    """Torques of the four stages of a step, and at its end [N m], or shares of them."""

    first: float
    second: float
    third: float
    fourth: float
    end: float
    early: float  # integral of the torque to the middle of the step, over h
    half: float  # its double integral, over h^2


class Response(NamedTuple):
    """Moments m_k, over a time h, of the torque of a motor that tends from 0 to 1, and the torque at the end."""

    m1: float
    m2: float
    m3: float
    m4: float
    end: float


@inlined
def response(h: float, time: float, rate: float) -> Response:
    """Return the response 1 - e^(-t / T_i) of a motor with a lag, or with none; h >= 0 [s], `rate` 1 / T_i or 0.

    With z = h / T_i and psi_k = sum of (-z)^n / (n + k)!, m_k = z psi_{k+1} and psi_k = 1 / k! - z psi_{k+1}: by the
    series where z is small, upward where the recurrence would cancel.
    """
    z = h * rate
    z2, z4 = z * z, z * z * z * z
    s0 = (1 / 120 - z * (1 / 720)) + z2 * (1 / 5040 - z * (1 / 40320))
    s1 = (1 / 362880 - z * (1 / 3628800)) + z2 * (1 / 39916800 - z * (1 / 479001600))
    s2 = (1 / 6227020800 - z * (1 / 87178291200)) + z2 * (1 / 1307674368000 - z * (1 / 20922789888000))
    low5 = s0 + z4 * (s1 + z4 * s2)
    low4 = 1 / 24 - z * low5
    low3 = 1 / 6 - z * low4
    low2 = 1 / 2 - z * low3
    low1 = 1 - z * low2
    small = z < 1.0
    inverse = time / h if not small else 1.0
    high1 = (1 - decay(z)) * inverse
    high2 = (1 - high1) * inverse
    high3 = (1 / 2 - high2) * inverse
    high4 = (1 / 6 - high3) * inverse
    if rate == 0.0:
        return Response(1.0, 1 / 2, 1 / 6, 1 / 24, 1.0)
    return Response(
        z * low2 if small else 1 - high1,
        z * low3 if small else 1 / 2 - high2,
        z * low4 if small else 1 / 6 - high3,
        z * low5 if small else 1 / 24 - high4,
        z * low1 if small else 1 - decay(z),
    )


@inlined
def stages(moments: Response, early: float, half: float) -> Stages:
    """Return the torques of a step's stages that have these moments, and integrals to the middle."""
    first = 24 * moments.m4
    second = 12 * moments.m3 - first
    third = 6 * moments.m2 - first - second
    return Stages(first, second, third, 6 * moments.m1 - first - 2 * second - 2 * third, moments.end, early, half)


@inlined
def shares_of_two(dt: float, arrival: float, time: float, rate: float) -> tuple[Stages, Stages]:
    """Return the shares that the targets before and after a command's arrival have in the torques of a step.

    What is left to 1 is the share of the motor's torque at the step's beginning.

    Args:
        dt: Length of the step [s].
        arrival: Time until the command arrives, from 0 to dt [s].
        time: Time constant T_i of the current loop [s].
        rate: 1 / T_i [1/s], or 0.
    """
    left, middle = dt - arrival, 0.5 * dt
    f = left / dt if dt > 0.0 else 0.0
    whole, late = response(dt, time, rate), response(left, time, rate)
    r = Response(f * late.m1, f * f * late.m2, f * f * f * late.m3, f * f * f * f * late.m4, late.end)
    if left <= 0.0:
        r = Response(0.0, 0.0, 0.0, 0.0, 0.0)
    before = Response(whole.m1 - r.m1, whole.m2 - r.m2, whole.m3 - r.m3, whole.m4 - r.m4, whole.end - r.end)
    late_half = middle - arrival if middle > arrival else 0.0
    g = late_half / dt if dt > 0.0 else 0.0
    half, half_after = response(middle, time, rate), response(late_half, time, rate)
    early_after, twice_after = g * half_after.m1, g * g * half_after.m2
    return (
        stages(before, 0.5 * half.m1 - early_after, 0.25 * half.m2 - twice_after),
        stages(r, early_after, twice_after),
    )


@inlined
def torques_of_two(torque: float, before: float, after: float, by_before: Stages, by_after: Stages) -> Stages:
    """Return the torques of a step's stages from that of the motor now, both targets and their shares [N m]."""
    old, new = before - torque, after - torque
    return Stages(
        torque + by_before.first * old + by_after.first * new,
        torque + by_before.second * old + by_after.second * new,
        torque + by_before.third * old + by_after.third * new,
        torque + by_before.fourth * old + by_after.fourth * new,
        torque + by_before.end * old + by_after.end * new,
        0.5 * torque + by_before.early * old + by_after.early * new,
        0.125 * torque + by_before.half * old + by_after.half * new,
    )


@inlined
def steady(torque: float) -> Stages:
    """Return the torques of a step's stages under a torque that does not change [N m]."""
    return Stages(torque, torque, torque, torque, torque, 0.5 * torque, 0.125 * torque)


class Lag(NamedTuple):
    """Motor torque over a time in which its target does not change: target + excess e^(-t / T_i)."""

    target: float  # [N m]
    excess: float  # [N m]
    time: float  # T_i [s]; 0 for a motor that follows at once
    rate: float  # 1 / T_i [1/s], or 0


@inlined
def lag_left(lag: Lag, torques: Stages) -> float:
    """Return what is left of the lag's excess at the end of a step, as a share."""
    return (torques.end - lag.target) / lag.excess if lag.excess != 0.0 else 1.0
