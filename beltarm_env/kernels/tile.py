"""Tile of observations: one row per entry, scaled and clipped, to be copied to one row per arm.

The rows of a tile are the entries of all sensor tiers, those that all have first.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltarm_env.jit import compiled, inlined
from beltarm_env.kernels.layout import LANES
from beltarm_env.observation import ENTRIES, FULL

Singles = NDArray[np.float32]

_COMMON = len(ENTRIES["encoder"])
TIP_ROW = _COMMON
FULL_ROW = _COMMON + len(ENTRIES["tip"][_COMMON:])
_ROW_ENTRIES = (*ENTRIES["tip"], *ENTRIES["full"][_COMMON:])
TILE_ROWS = len(_ROW_ENTRIES)
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
    first_extra = FULL_ROW if tier == FULL else TIP_ROW
    for j in range(count):
        for k in range(_COMMON):  # a constant, so that LLVM unrolls it
            observations[j, k] = tile[k * LANES + j]
    for k in range(_COMMON, entries):
        for j in range(count):
            observations[j, k] = tile[(first_extra + k - _COMMON) * LANES + j]
