"""Random streams of many arms: NumPy's generators, without an object for each.

The stream of a seed is that of `gymnasium.utils.seeding.np_random(seed)`, number by number: a PCG64 whose state comes
from NumPy's `SeedSequence`. Here a stream takes 32 bytes, kernels draw from it, and thousands are seeded at once.

    s <- a s + c mod 2^128,     output: (high ^ low) rotated right by the six highest bits of s

M. E. O'Neill: PCG: a family of simple fast space-efficient statistically good algorithms for random number generation,
Harvey Mudd College, HMC-CS-2014-0905, 2014 (XSL RR 128/64); `numpy/random/bit_generator.pyx` for the seeding.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager

import numpy as np
from numpy.typing import NDArray

from beltarm_env.arrays import Floats, Integers
from beltarm_env.engine import compiled, inlined

Streams = NDArray[np.uint64]
"""State and increment of each stream, both as high and low half: shape (n, 4)."""
_Words = NDArray[np.uint32]

_POOL = 4  # words that a SeedSequence mixes a seed into
_AT_ONCE = 4096  # seeds whose words take little memory
_LARGEST = 2**128  # from here on, a seed has more words than that
_FIRST_HASH, _HASH_FACTOR = 0x43B0D7E5, 0x931E8875
_FIRST_OUTPUT_HASH, _OUTPUT_HASH_FACTOR = 0x8B51F9DD, 0x58F38DED
_MIX_LEFT, _MIX_RIGHT = np.uint32(0xCA01F9DD), np.uint32(0x4973F715)
_HALF_WORD = np.uint32(16)

_FACTOR_HIGH, _FACTOR_LOW = np.uint64(0x2360ED051FC65DA4), np.uint64(0x4385DF649FCCF645)  # a
_LOW_LOW, _LOW_HIGH = np.uint64(0x9FCCF645), np.uint64(0x4385DF64)  # halves of the latter
_HALF, _LOWER_HALF, _ONE, _ZERO = np.uint64(32), np.uint64(0xFFFFFFFF), np.uint64(1), np.uint64(0)
_ROTATION, _BITS, _DIGITS = np.uint64(58), np.uint64(63), np.uint64(11)
_UNIT = 2.0**-53


def wrapping() -> AbstractContextManager[object]:
    """Let numbers of 64 bits wrap around, of which NumPy warns in plain Python."""
    return np.errstate(over="ignore")


class _Hash:
    """The hash of a SeedSequence, whose constant changes with each use."""

    def __init__(self, constant: int, factor: int) -> None:
        self._constant, self._factor = constant, factor

    def __call__(self, words: _Words) -> _Words:
        words = words ^ np.uint32(self._constant)
        self._constant = self._constant * self._factor & 0xFFFFFFFF
        words = words * np.uint32(self._constant)
        return words ^ (words >> _HALF_WORD)


def _mixed(left: _Words, right: _Words) -> _Words:
    words = _MIX_LEFT * left - _MIX_RIGHT * right
    return words ^ (words >> _HALF_WORD)


def _states(seeds: Sequence[int]) -> Streams:
    """Return four words of 64 bits for each seed, as `SeedSequence(seed).generate_state(4, np.uint64)`."""
    data = b"".join(seed.to_bytes(4 * _POOL, "little") for seed in seeds)
    pool = list(np.frombuffer(data, "<u4").reshape(-1, _POOL).T)
    hashed = _Hash(_FIRST_HASH, _HASH_FACTOR)
    pool = [hashed(words) for words in pool]
    for source in range(_POOL):
        for target in range(_POOL):
            if source != target:
                pool[target] = _mixed(pool[target], hashed(pool[source]))
    output = _Hash(_FIRST_OUTPUT_HASH, _OUTPUT_HASH_FACTOR)
    words = [output(pool[k % _POOL]).astype(np.uint64) for k in range(8)]
    return np.stack([words[k] | words[k + 1] << _HALF for k in range(0, 8, 2)], axis=1)


def checked_seed(seed: object) -> int:
    """Return a seed.

    Raises:
        ValueError: If it is not a whole number, or negative.
    """
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise ValueError(f"seed must be a whole number of at least 0, got {seed!r}")
    return int(seed)


def seeded(seeds: Sequence[int]) -> Streams:
    """Return the streams of some seeds, whole numbers that are not negative, shape (n, 4)."""
    streams = np.empty((len(seeds), 4), np.uint64)
    for low in range(0, len(seeds), _AT_ONCE):
        some = seeds[low : low + _AT_ONCE]
        if max(some) >= _LARGEST:
            states = np.array([np.random.SeedSequence(seed).generate_state(4, np.uint64) for seed in some], np.uint64)
        else:
            states = _states(some)
        with wrapping():
            _begin(states, streams[low : low + _AT_ONCE])
    return streams


@compiled
def _begin(states: Streams, streams: Streams) -> None:
    for i in range(len(states)):
        high, low, stream = states[i, 0], states[i, 1], streams[i]
        stream[0], stream[1] = _ZERO, _ZERO
        stream[2], stream[3] = (states[i, 2] << _ONE) | (states[i, 3] >> _BITS), (states[i, 3] << _ONE) | _ONE
        _move_on(stream)
        total = stream[1] + low
        stream[0] = stream[0] + high + (_ONE if total < low else _ZERO)
        stream[1] = total
        _move_on(stream)


@inlined
def _move_on(stream: Streams) -> None:
    """Turn s into a s + c: products of 64 bits by those of their halves."""
    high, low = stream[0], stream[1]
    first, second = low & _LOWER_HALF, low >> _HALF
    product = first * _LOW_LOW
    middle = second * _LOW_LOW + (product >> _HALF)
    other = first * _LOW_HIGH + (middle & _LOWER_HALF)
    carried = second * _LOW_HIGH + (middle >> _HALF) + (other >> _HALF)
    below = (other << _HALF) | (product & _LOWER_HALF)
    total = below + stream[3]
    carried = carried + high * _FACTOR_LOW + low * _FACTOR_HIGH + (_ONE if total < below else _ZERO)
    stream[0], stream[1] = carried + stream[2], total


@compiled
def draw(streams: Streams, chosen: Integers, draws: Floats) -> None:
    """Draw numbers in [0, 1) from n chosen streams, shape (n, count), and move these on; within `wrapping`.

    Args:
        streams: Changed.
        chosen: Which, shape (n,).
        draws: Written.
    """
    for i in range(len(chosen)):
        stream = streams[chosen[i]]
        for k in range(draws.shape[1]):
            _move_on(stream)
            word, turn = stream[0] ^ stream[1], stream[0] >> _ROTATION
            word = (word >> turn) | (word << ((_ZERO - turn) & _BITS))
            draws[i, k] = float(word >> _DIGITS) * _UNIT


def drawn(streams: Streams, chosen: Integers, count: int) -> Floats:
    """Draw `count` numbers in [0, 1) from each of n chosen streams, shape (n, count), and move these on."""
    draws = np.empty((len(chosen), count))
    with wrapping():
        draw(streams, chosen, draws)
    return draws
