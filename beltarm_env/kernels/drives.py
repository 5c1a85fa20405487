"""Constants of an arm's real drive, put into its lane of a block."""

from __future__ import annotations

from typing import Any

import numpy as np

from beltarm_env.arm import COLUMN
from beltarm_env.arrays import Floats
from beltarm_env.engine import inlined
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.layout import LANES, store_drive, store_stages
from beltarm_env.physics.drive import DRIVE_COLUMNS, drive_of
from beltarm_env.physics.torque import shares_of_two
from beltarm_env.timing import CONTROL_PERIOD, EPISODE_STEPS, LATENCY_SAMPLES, SHORTEST_LAG


@inlined
def begin_drive(block: Floats, lane: int, row: Any) -> None:
    """Put an arm's drive into its lane, from a row of constants, shape (len(FIELDS),); its motor's torque stays."""
    store_drive(block, lane, drive_of(row))
    effect = 0.0
    for k in range(len(DRIVE_COLUMNS)):
        effect = 1.0 if row[DRIVE_COLUMNS[k]] != 0.0 else effect
    block[at.REAL_DRIVE * LANES + lane] = effect
    begin_lag(block, lane, float(row[COLUMN.current_loop_time_constant]), float(row[COLUMN.command_latency]))
    begin_friction(block, lane, row)


@inlined
def begin_lag(block: Floats, lane: int, lag: float, latency: float) -> None:
    """Put the current loop's time constant and the latency of commands, both in seconds, into a lane."""
    lag = lag if lag >= SHORTEST_LAG else 0.0
    rate = 1 / lag if lag > 0.0 else 0.0
    block[at.LAG_TIME * LANES + lane] = lag
    block[at.LAG_RATE * LANES + lane] = rate
    samples = latency / CONTROL_PERIOD
    late = min(float(np.floor(samples)), LATENCY_SAMPLES - 1.0)
    split = min((samples - late) * CONTROL_PERIOD, CONTROL_PERIOD)
    block[at.LATE * LANES + lane] = late
    block[at.SPLIT * LANES + lane] = split
    by_before, by_after = shares_of_two(CONTROL_PERIOD, split, lag, rate)
    store_stages(block, at.BY_BEFORE, lane, by_before)
    store_stages(block, at.BY_AFTER, lane, by_after)


@inlined
def begin_friction(block: Floats, lane: int, row: Any) -> None:
    """Put friction at the move's beginning and its drift, and the torque constant, into a lane."""
    block[at.GAIN * LANES + lane] = 1 + row[COLUMN.torque_constant_error]
    block[at.VISCOUS * LANES + lane] = row[COLUMN.motor_viscous_friction]
    block[at.COULOMB * LANES + lane] = row[COLUMN.coulomb_friction]
    block[at.DRIFT * LANES + lane] = row[COLUMN.friction_drift] / EPISODE_STEPS
