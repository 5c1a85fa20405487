"""Observations of a block of arms, from their sensors and moves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltarm_env import _layout as at
from beltarm_env._constants import CONTROL_PERIOD
from beltarm_env._jit import compiled, inlined
from beltarm_env._layout import LANES, load_move, load_plant, load_state
from beltarm_env.observation import ENTRIES, FULL, LOOKAHEADS, SENSORS, TIP, bounds, scales, size
from beltarm_env.reference import MoveShape, reference_at
from beltarm_env.sensors import speed_from_counts

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

MOST_ENTRIES = max(len(entries) for entries in ENTRIES.values())
_COMMON = len(ENTRIES["encoder"])
_AHEAD = len(LOOKAHEADS)
_INVERSE_SCALE = np.ones((len(SENSORS), MOST_ENTRIES))
_BOUND = np.ones((len(SENSORS), MOST_ENTRIES))
for _tier, _sensors in enumerate(SENSORS):
    _INVERSE_SCALE[_tier, : size(_sensors)] = 1 / scales(_sensors)
    _BOUND[_tier, : size(_sensors)] = bounds(_sensors)


@inlined
def _delayed(block: Floats, row: int, lane: int) -> float:
    """A reading from a sensor's history: row holds the latest, the next rows older ones."""
    delay = block[at.DELAY * LANES + lane]
    latest = block[row * LANES + lane]
    once = block[(row + 1) * LANES + lane]
    twice = block[(row + 2) * LANES + lane]
    return latest if delay == 0.0 else (once if delay == 1.0 else twice)


@inlined
def _look_ahead(physical: Floats, lane: int, k: int, profile: int, move: MoveShape, time: float) -> None:
    reference = reference_at(profile, move, time + LOOKAHEADS[k])
    physical[(6 + k) * LANES + lane] = reference.speed
    physical[(6 + _AHEAD + k) * LANES + lane] = reference.acceleration


@compiled
def _entries(block: Floats, physical: Floats, count: int, profile: int, tier: int) -> None:
    """Observation entries in physical units, one row each, in the order of `observation.ENTRIES`."""
    for j in range(count):
        plant = load_plant(block, j)
        move = load_move(block, j)
        resolution = block[at.RESOLUTION * LANES + j]
        now = _delayed(block, at.COUNTS, j)
        speed = speed_from_counts(now, _delayed(block, at.COUNTS + 1, j), resolution)
        time = block[at.STEP * LANES + j] * CONTROL_PERIOD
        reference = reference_at(profile, move, time)
        physical[j] = reference.angle / plant.inverse_gear - now * resolution
        physical[LANES + j] = reference.speed / plant.inverse_gear - speed
        physical[2 * LANES + j] = speed
        physical[3 * LANES + j] = reference.angle
        physical[4 * LANES + j] = reference.speed
        physical[5 * LANES + j] = reference.acceleration
        _look_ahead(physical, j, 0, profile, move, time)
        _look_ahead(physical, j, 1, profile, move, time)
        _look_ahead(physical, j, 2, profile, move, time)
        _look_ahead(physical, j, 3, profile, move, time)
        _look_ahead(physical, j, 4, profile, move, time)
    after = 6 + 2 * _AHEAD
    for j in range(count):
        move = load_move(block, j)
        physical[after * LANES + j] = move.start
        physical[(after + 1) * LANES + j] = move.goal
        physical[(after + 2) * LANES + j] = move.duration
        physical[(after + 3) * LANES + j] = move.ramp_time
        physical[(after + 4) * LANES + j] = block[at.STEP * LANES + j] * CONTROL_PERIOD
        physical[(after + 5) * LANES + j] = block[at.TORQUE * LANES + j] / load_plant(block, j).torque_limit
    if tier == TIP:
        for j in range(count):
            physical[_COMMON * LANES + j] = _delayed(block, at.TIP_SPEEDS, j)
    elif tier == FULL:
        for j in range(count):
            x = load_state(block, at.STATE, j)
            physical[_COMMON * LANES + j] = x.torsion
            physical[(_COMMON + 1) * LANES + j] = x.torsion_speed


@compiled
def observe_block(block: Floats, observations: Singles, profile: int, tier: int) -> None:
    """Write the scaled and clipped observations of the first arms of a block, shape (count, size)."""
    count, entries = observations.shape
    physical = np.empty(MOST_ENTRIES * LANES)
    tile = np.empty(MOST_ENTRIES * LANES, dtype=np.float32)
    _entries(block, physical, count, profile, tier)
    for k in range(MOST_ENTRIES):  # constant ranges let LLVM unroll over entries and vectorise over lanes
        inverse_scale = _INVERSE_SCALE[tier, k]
        bound = _BOUND[tier, k]
        for j in range(count):
            tile[k * LANES + j] = min(max(physical[k * LANES + j] * inverse_scale, -bound), bound)
    for j in range(count):
        for k in range(_COMMON):
            observations[j, k] = tile[k * LANES + j]
    for k in range(_COMMON, entries):
        for j in range(count):
            observations[j, k] = tile[k * LANES + j]
