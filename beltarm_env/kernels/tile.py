"""Tile of observations: their entries for all lanes of a block, to be copied to one row per arm.

The entries that all sensor tiers have are put in groups of `GROUP`, a lane's entries of a group side by side: so a
group is copied to the observation at once. Entries that do not fill a group, and each tier's own, have a row each.
"""

from __future__ import annotations

from itertools import chain

import numpy as np
from numpy.typing import NDArray

from beltarm_env.engine import compiled, inlined
from beltarm_env.kernels.layout import LANES
from beltarm_env.observation import ENTRIES, SENSORS

Singles = NDArray[np.float32]

GROUP = 8
"""Entries of a group: 32 bytes."""
_COMMON = len(ENTRIES["encoder"])
_GROUPED = _COMMON // GROUP * GROUP
_OWN = [ENTRIES[tier][_COMMON:] for tier in SENSORS]
_ROW_ENTRIES = (*ENTRIES["encoder"], *chain(*_OWN))
TILE_ROWS = len(_ROW_ENTRIES)
OWN_ROW = _COMMON + np.cumsum([0, *map(len, _OWN[:-1])])
"""First row of each tier's own entries, by its index in `observation.SENSORS`."""
_INVERSE_SCALE = np.array([1 / entry.scale for entry in _ROW_ENTRIES])
_BOUND = np.array([entry.bound / entry.scale for entry in _ROW_ENTRIES], dtype=np.float32)


@inlined
def _place(row: int, lane: int) -> int:
    if row < _GROUPED:
        return row // GROUP * GROUP * LANES + GROUP * lane + row % GROUP
    return row * LANES + lane


@inlined
def put(tile: Singles, lane: int, row: int, value: float) -> None:
    """Scale and clip a physical value into its place."""
    bound, scaled = _BOUND[row], np.float32(value * _INVERSE_SCALE[row])
    tile[_place(row, lane)] = min(max(scaled, -bound), bound)


@inlined
def _copy_group(observations: Singles, arm: int, entry: int, tile: Singles, place: int) -> None:
    """Copy a group from its place in a tile to an arm's observation, from an entry on."""
    for k in range(GROUP):
        observations[arm, entry + k] = tile[place + k]


@compiled
def transpose(tile: Singles, observations: Singles, tier: int) -> None:
    """Copy a tile to the observations of a sensor tier, shape (count, size)."""
    count, entries = observations.shape
    own = OWN_ROW[tier]
    for j in range(count):
        for k in range(0, _GROUPED, GROUP):
            _copy_group(observations, j, k, tile, k * LANES + GROUP * j)
        for k in range(_GROUPED, _COMMON):
            observations[j, k] = tile[k * LANES + j]
    for k in range(_COMMON, entries):
        for j in range(count):
            observations[j, k] = tile[(own + k - _COMMON) * LANES + j]
