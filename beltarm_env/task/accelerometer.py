"""Accelerometer on the arm's end: a MEMS part, measuring along the hand and across it.

    a' = (v' - a) / tau         first-order low-pass, tau = 1 / (2 pi bandwidth), of the acceleration v' of the end
    reading = cut(a + bias + sigma n, +-range),     n ~ N(0, 1),     sigma = density sqrt(pi/2 bandwidth)

The velocity v is taken as linear between two readings T apart, so the low-pass has the closed form

    a[k] = s + (a[k-1] - s) exp(-T / tau),     s = (v[k] - v[k-1]) / T,

and a equals (v - z) / tau with the low-passed velocity z. The low-pass is applied along fixed axes, its result turned
into the hand's: within tau the hand turns by about a milliradian. The arm lies in a horizontal plane: no gravity.

**Source.** InvenSense MPU-6000/MPU-6050 Product Specification, PS-MPU-6000A-00 Rev. 3.4, 2013, sec. 6.2: range +-8 g,
zero-g output X and Y +-50 mg, noise density 400 ug/sqrt(Hz), low-pass up to 260 Hz. Assumed: white noise, a low-pass
of first order, and zero-g outputs uniform within their limits. Left out: the resolution of 0.24 mg, and errors of the
sensitivity, +-3 %, and across the axes, +-2 %.

**Noise without a generator.** Kernels draw no random numbers. The noise is a hash of the episode's seed, the sample and
the axis, so that it is the same in any batch, compiled or not. The sum of four 16-bit numbers from it is approximately
normal: mean 0, variance 1, kurtosis 2.7 instead of 3, never beyond 3.5.
"""

from __future__ import annotations

import math

from beltarm_env.engine import inlined
from beltarm_env.physics.kinematics import TipMotion
from beltarm_env.timing import CONTROL_PERIOD

_G = 9.80665  # standard gravity [m/s^2]
RANGE = 8 * _G
"""Largest reading [m/s^2]."""
BIAS = 0.05 * _G
"""Largest zero-g output [m/s^2]; each axis has its own in each episode, uniform within it."""
BANDWIDTH = 260.0
"""Of the low-pass, at which it lets through 1/sqrt(2) [Hz]."""
NOISE = 400e-6 * _G * math.sqrt(0.5 * math.pi * BANDWIDTH)
"""Standard deviation of a reading's noise [m/s^2]: density times the root of the low-pass's noise bandwidth."""
DECAY = math.exp(-2 * math.pi * BANDWIDTH * CONTROL_PERIOD)
"""Share of the low-passed acceleration that is left after a sample: exp(-T / tau)."""
DRAWS = 3
"""Uniform random numbers that an episode takes: the noise's seed, and the bias along and across the hand."""

_SEEDS = 2.0**32
_MEAN = 2 * 65535  # of the sum of four numbers from 0 to 65535
_PER_DEVIATION = 1 / math.sqrt((65536.0**2 - 1) / 3)
_WORD = 0xFFFFFFFF
_FACTOR = 0x45D9F3B
_SHORTEST = 1e-9  # distance of the end from joint 1 that has a direction [m]


@inlined
def noise_seed(uniform: float) -> float:
    """Return the seed of an episode's noise, a whole number below 2^32, from a number in [0, 1)."""
    return float(int(uniform * _SEEDS))


@inlined
def bias_of(uniform: float) -> float:
    """Return a zero-g output [m/s^2] from a number in [0, 1)."""
    return (2 * uniform - 1) * BIAS


@inlined
def low_passed(filtered: float, before: float, now: float) -> float:
    """Return the low-passed acceleration [m/s^2] one sample on, from the last and the velocities [m/s] at both."""
    mean = (now - before) * (1 / CONTROL_PERIOD)
    return mean + (filtered - mean) * DECAY


@inlined
def _mixed(word: int) -> int:
    """Hash 32 bits to 32 bits, each of which depends on all (T. Mueller's multipliers); no product exceeds 63 bits."""
    word = ((word ^ (word >> 16)) * _FACTOR) & _WORD
    word = ((word ^ (word >> 16)) * _FACTOR) & _WORD
    return word ^ (word >> 16)


@inlined
def noise(seed: float, sample: float, axis: int) -> float:
    """Return the noise of one reading, of about a standard normal distribution.

    Args:
        seed: Of the episode.
        sample: Number of the reading in its episode, whole and not negative.
        axis: 0 along the hand, 1 across it.
    """
    key, place = int(seed), 4 * int(sample) + 2 * axis
    first, second = _mixed(_mixed(place) ^ key), _mixed(_mixed(place + 1) ^ key)
    total = (first & 0xFFFF) + (first >> 16) + (second & 0xFFFF) + (second >> 16)
    return float(total - _MEAN) * _PER_DEVIATION


@inlined
def along_and_across(x: float, y: float, tip: TipMotion) -> tuple[float, float]:
    """Turn a vector into the hand's axes: along the line from joint 1 to the end, and a quarter turn left of it."""
    side = 1.0 if tip.x >= 0.0 else -1.0  # folded beyond joint 1, the hand points back to it
    inverse = side / max(math.sqrt(tip.x * tip.x + tip.y * tip.y), _SHORTEST)
    cosine, sine = tip.x * inverse, tip.y * inverse
    return x * cosine + y * sine, y * cosine - x * sine


@inlined
def reading(acceleration: float, bias: float, seed: float, sample: float, axis: int) -> float:
    """Return the reading of one axis [m/s^2] for its low-passed acceleration."""
    return min(max(acceleration + bias + NOISE * noise(seed, sample, axis), -RANGE), RANGE)
