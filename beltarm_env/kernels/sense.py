"""Sensors of a block of arms: how they are read, how late their readings arrive, and what of them is observed.

A delay of m + f samples, m whole and f below 1, is that of a reading taken f samples before each sample, from a state
between two (`task.sensors.between_samples`), which then arrives m samples late. For the latter each sensor keeps a
history of its readings, row by row in the block, the latest first. A new sensor is an entry of `observation.ENTRIES`,
rows of `layout` for its history, and a place in `begin_sensing`, `_read_sensors` and `put_tier_entries`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltarm_env.engine import compiled, inlined
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.layout import LANES, RealDrive, drive_among, load_drive, load_plant, load_state, store_state
from beltarm_env.kernels.tile import OWN_ROW, put
from beltarm_env.observation import ACCELEROMETER, FULL, TIP
from beltarm_env.physics.drive import belt_motion
from beltarm_env.physics.kinematics import TipMotion, contained, tip_motion
from beltarm_env.task.accelerometer import along_and_across, bias_of, low_passed, noise_seed, reading
from beltarm_env.task.sensors import between_samples, speed_from_counts, to_counts
from beltarm_env.timing import CONTROL_PERIOD

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]


@inlined
def begin_sensing(block: Floats, lane: int, resolution: float, delay: float, draws: Floats) -> None:
    """Fill the histories of an arm that begins an episode, as if it had moved at constant speed before.

    Args:
        block: As `layout` describes, with the arm's state and coefficients.
        lane: Of the arm.
        resolution: Of the encoder [rad per count].
        delay: Of the measurements [samples].
        draws: Uniform random numbers in [0, 1), shape (accelerometer.DRAWS,).
    """
    x = load_state(block, at.STATE, lane)
    block[at.RESOLUTION * LANES + lane] = resolution
    whole = float(int(delay))
    fraction = delay - whole
    block[at.DELAY * LANES + lane] = whole
    block[at.FRACTION * LANES + lane] = fraction
    store_state(block, at.BEFORE, lane, x)
    for k in range(at.COUNT_HISTORY):
        before = x.motor_angle - (k + fraction) * CONTROL_PERIOD * x.motor_speed
        block[(at.COUNTS + k) * LANES + lane] = to_counts(before, resolution)
    tip = tip_motion(x, load_plant(block, lane), load_drive(block, lane))
    for k in range(at.TIP_HISTORY):
        block[(at.TIP_SPEEDS + k) * LANES + lane] = tip.x_speed
    block[at.NOISE_SEED * LANES + lane] = noise_seed(draws[0])
    block[at.BIASES * LANES + lane] = bias_of(draws[1])
    block[(at.BIASES + 1) * LANES + lane] = bias_of(draws[2])
    block[at.TIP_VELOCITY * LANES + lane] = tip.x_speed
    block[(at.TIP_VELOCITY + 1) * LANES + lane] = tip.y_speed
    for k in range(at.MAX_DELAY, -1, -1):
        _move_tip(block, lane, tip)
        _add_errors(block, lane, float(at.MAX_DELAY - k))


@inlined
def _move_tip(block: Floats, lane: int, tip: TipMotion) -> None:
    """Shift the accelerometer's histories, and put what it measures but for its own errors in front."""
    x = low_passed(block[at.TIP_ACCELERATION * LANES + lane], block[at.TIP_VELOCITY * LANES + lane], tip.x_speed)
    y = low_passed(
        block[(at.TIP_ACCELERATION + 1) * LANES + lane], block[(at.TIP_VELOCITY + 1) * LANES + lane], tip.y_speed
    )
    block[at.TIP_ACCELERATION * LANES + lane] = x
    block[(at.TIP_ACCELERATION + 1) * LANES + lane] = y
    block[at.TIP_VELOCITY * LANES + lane] = tip.x_speed
    block[(at.TIP_VELOCITY + 1) * LANES + lane] = tip.y_speed
    block[(at.ALONG + 2) * LANES + lane] = block[(at.ALONG + 1) * LANES + lane]
    block[(at.ALONG + 1) * LANES + lane] = block[at.ALONG * LANES + lane]
    block[(at.ACROSS + 2) * LANES + lane] = block[(at.ACROSS + 1) * LANES + lane]
    block[(at.ACROSS + 1) * LANES + lane] = block[at.ACROSS * LANES + lane]
    along, across = along_and_across(x, y, tip)
    block[at.ALONG * LANES + lane] = along
    block[at.ACROSS * LANES + lane] = across


@inlined
def _add_errors(block: Floats, lane: int, sample: float) -> None:
    """Turn the latest accelerations into readings, for the sample that is the episode's `sample`-th."""
    seed = block[at.NOISE_SEED * LANES + lane]
    along, across = block[at.ALONG * LANES + lane], block[at.ACROSS * LANES + lane]
    block[at.ALONG * LANES + lane] = reading(along, block[at.BIASES * LANES + lane], seed, sample, 0)
    block[at.ACROSS * LANES + lane] = reading(across, block[(at.BIASES + 1) * LANES + lane], seed, sample, 1)


@compiled
def sense_block(block: Floats, count: int, tier: int, real_drive: RealDrive) -> None:
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
    _read_sensors(block, count, tier, real_drive)
    if between > 0:
        for j in range(count):
            store_state(block, at.STATE, j, load_state(block, at.BEFORE, j))


@inlined
def _read_sensors(block: Floats, count: int, tier: int, real_drive: RealDrive) -> None:
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
            tip = tip_motion(load_state(block, at.STATE, j), load_plant(block, j), drive_among(block, j, real_drive))
            block[at.TIP_SPEEDS * LANES + j] = tip.x_speed
    elif tier == ACCELEROMETER:
        for j in range(count):
            tip = tip_motion(load_state(block, at.STATE, j), load_plant(block, j), drive_among(block, j, real_drive))
            _move_tip(block, j, tip)
        for j in range(count):
            sample = block[at.EARLIER * LANES + j] + block[at.STEP * LANES + j]
            _add_errors(block, j, sample + (at.MAX_DELAY + 1.0))


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
def put_tier_entries(block: Floats, tile: Singles, count: int, tier: int, real_drive: RealDrive) -> None:
    """Put the entries into a tile that a sensor tier has beyond the encoder's."""
    if tier == TIP:
        for j in range(count):
            put(tile, j, OWN_ROW[TIP], _delayed(block, at.TIP_SPEEDS, j))
    elif tier == FULL:
        for j in range(count):
            x = load_state(block, at.STATE, j)
            torsion, torsion_speed = belt_motion(x, load_plant(block, j), drive_among(block, j, real_drive))
            put(tile, j, OWN_ROW[FULL], torsion)
            put(tile, j, OWN_ROW[FULL] + 1, torsion_speed)
    elif tier == ACCELEROMETER:
        for j in range(count):
            put(tile, j, OWN_ROW[ACCELEROMETER], _delayed(block, at.ALONG, j))
            put(tile, j, OWN_ROW[ACCELEROMETER] + 1, _delayed(block, at.ACROSS, j))
