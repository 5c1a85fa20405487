"""Sensors of a block of arms: how they are read, how late their readings arrive, and what of them is observed.

A delay of m + f samples, m whole and f below 1, is that of a reading taken f samples before each sample, from a state
between two (`task.sensors.between_samples`), which then arrives m samples late. For the latter each sensor keeps a
history of its readings, row by row in the block, the latest first. A new sensor is an entry of `observation.ENTRIES`,
rows of `layout` for its history, and a place in `begin_sensing`, `_read_sensors` and `put_tier_entries`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltarm_env.arm import Plant
from beltarm_env.jit import compiled, inlined
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.layout import LANES, load_plant, load_state, store_state
from beltarm_env.kernels.tile import OWN_ROW, put
from beltarm_env.observation import FULL, TIP
from beltarm_env.physics.kinematics import contained, tip_motion
from beltarm_env.physics.state import ArmState
from beltarm_env.task.sensors import between_samples, speed_from_counts, to_counts
from beltarm_env.timing import CONTROL_PERIOD

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]


@inlined
def begin_sensing(block: Floats, lane: int, x: ArmState, plant: Plant, resolution: float, delay: float) -> None:
    """Fill the histories of an arm that begins an episode, as if it had moved at constant speed before."""
    block[at.RESOLUTION * LANES + lane] = resolution
    whole = float(int(delay))
    fraction = delay - whole
    block[at.DELAY * LANES + lane] = whole
    block[at.FRACTION * LANES + lane] = fraction
    store_state(block, at.BEFORE, lane, x)
    for k in range(at.COUNT_HISTORY):
        before = x.motor_angle - (k + fraction) * CONTROL_PERIOD * x.motor_speed
        block[(at.COUNTS + k) * LANES + lane] = to_counts(before, resolution)
    tip_speed = tip_motion(x, plant).x_speed
    for k in range(at.TIP_HISTORY):
        block[(at.TIP_SPEEDS + k) * LANES + lane] = tip_speed


@compiled
def sense_block(block: Floats, count: int, tier: int) -> None:
    """Shift the histories by one sample and read the sensors anew, from states that did not run away."""
    between = 0
    for j in range(count):
        between += 1 if block[at.FRACTION * LANES + j] > 0.0 else 0
    if between > 0:  # the states that the sensors read take the place of the present ones, for so long
        for j in range(count):
            x = contained(load_state(block, at.STATE, j), load_plant(block, j))
            earlier = between_samples(load_state(block, at.BEFORE, j), x, block[at.FRACTION * LANES + j])
            store_state(block, at.STATE, j, earlier)
            store_state(block, at.BEFORE, j, x)
    _read_sensors(block, count, tier)
    if between > 0:
        for j in range(count):
            store_state(block, at.STATE, j, load_state(block, at.BEFORE, j))


@inlined
def _read_sensors(block: Floats, count: int, tier: int) -> None:
    for j in range(count):
        block[(at.COUNTS + 3) * LANES + j] = block[(at.COUNTS + 2) * LANES + j]
        block[(at.COUNTS + 2) * LANES + j] = block[(at.COUNTS + 1) * LANES + j]
        block[(at.COUNTS + 1) * LANES + j] = block[at.COUNTS * LANES + j]
        x = contained(load_state(block, at.STATE, j), load_plant(block, j))
        store_state(block, at.STATE, j, x)
        block[at.COUNTS * LANES + j] = to_counts(x.motor_angle, block[at.RESOLUTION * LANES + j])
    if tier == TIP:
        for j in range(count):
            block[(at.TIP_SPEEDS + 2) * LANES + j] = block[(at.TIP_SPEEDS + 1) * LANES + j]
            block[(at.TIP_SPEEDS + 1) * LANES + j] = block[at.TIP_SPEEDS * LANES + j]
            tip = tip_motion(load_state(block, at.STATE, j), load_plant(block, j))
            block[at.TIP_SPEEDS * LANES + j] = tip.x_speed


@inlined
def _delayed(block: Floats, row: int, lane: int) -> float:
    """Return the reading that has arrived by now, from a history whose latest reading is in `row`."""
    delay = block[at.DELAY * LANES + lane]
    latest = block[row * LANES + lane]
    once = block[(row + 1) * LANES + lane]
    twice = block[(row + 2) * LANES + lane]
    return latest if delay == 0.0 else (once if delay == 1.0 else twice)


@inlined
def encoder_reading(block: Floats, lane: int) -> tuple[float, float]:
    """Return the motor's angle [rad] and speed [rad/s] by the encoder, as late as they arrive."""
    resolution = block[at.RESOLUTION * LANES + lane]
    now = _delayed(block, at.COUNTS, lane)
    return now * resolution, speed_from_counts(now, _delayed(block, at.COUNTS + 1, lane), resolution)


@inlined
def put_tier_entries(block: Floats, tile: Singles, count: int, tier: int) -> None:
    """Put the entries into a tile that a sensor tier has beyond the encoder's."""
    if tier == TIP:
        for j in range(count):
            put(tile, j, OWN_ROW[TIP], _delayed(block, at.TIP_SPEEDS, j))
    elif tier == FULL:
        for j in range(count):
            x = load_state(block, at.STATE, j)
            put(tile, j, OWN_ROW[FULL], x.torsion)
            put(tile, j, OWN_ROW[FULL] + 1, x.torsion_speed)
