"""Tile of observations: one row per entry, scaled and clipped, to be copied to one row per arm.

The rows of a tile are the entries that all sensor tiers have, then each tier's own.
"""

from __future__ import annotations

from itertools import chain

import numpy as np
from numpy.typing import NDArray

from beltarm_env.jit import compiled, inlined
from beltarm_env.kernels.layout import LANES
from beltarm_env.observation import ENTRIES, SENSORS

Singles = NDArray[np.float32]

_COMMON = len(ENTRIES["encoder"])
_OWN = [ENTRIES[tier][_COMMON:] for tier in SENSORS]
_ROW_ENTRIES = (*ENTRIES["encoder"], *chain(*_OWN))
TILE_ROWS = len(_ROW_ENTRIES)
OWN_ROW = _COMMON + np.cumsum([0, *map(len, _OWN[:-1])])
"""First row of each tier's own entries, by its index in `observation.SENSORS`."""
_INVERSE_SCALE = np.array([1 / entry.scale for entry in _ROW_ENTRIES])
_BOUND = np.array([np.float32(entry.bound / entry.scale) for entry in _ROW_ENTRIES], dtype=np.float64)


@inlined
def put(tile: Singles, lane: int, row: int, value: float) -> None:
    """Scale and clip a physical value into its row."""
    bound = _BOUND[row]
    tile[row * LANES + lane] = min(max(value * _INVERSE_SCALE[row], -bound), bound)


@compiled
def transpose(tile: Singles, observations: Singles, tier: int) -> None:
    """Copy a tile to the observations of a sensor tier, shape (count, size)."""
    count, entries = observations.shape
    own = OWN_ROW[tier]
    for j in range(count):
        for k in range(_COMMON):  # a constant, so that LLVM unrolls it
            observations[j, k] = tile[k * LANES + j]
    for k in range(_COMMON, entries):
        for j in range(count):
            observations[j, k] = tile[(own + k - _COMMON) * LANES + j]
