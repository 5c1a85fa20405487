"""A working shift: one arm makes several moves in a row, carries parts, and its friction goes on drifting.

Moves number 0, 2, 4, ... carry a part, whose mass is drawn anew; moves 1, 3, 5, ... go back empty. Friction has a level
L: its size at a move's beginning over that at the episode's. Over a move it drifts by its share d:

    L  <-  L (1 + d)

The next d is drawn from its range. It is -|d| where L (1 + d) would exceed 1.25, and +|d| where it would fall below
0.8; where that too would leave these bounds, friction ends at one of them. Only a first move that drifts by more can
exceed them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from beltarm_env.arm import COLUMN, bounds_of
from beltarm_env.arrays import Floats
from beltarm_env.engine import inlined

MOST_MOVES = 1000
"""Most moves of an episode."""
LEAST_FRICTION, MOST_FRICTION = 0.8, 1.25
"""Level of friction that it does not leave, over that at the episode's start."""
_MOST_DRIFT = bounds_of("friction_drift").high  # over a move: from a drift of -0.5 friction comes back over two of them
_FRICTION = (COLUMN.motor_viscous_friction, COLUMN.coulomb_friction)


def fastest_of_moves(table: Floats, moves: int) -> Floats:
    """Return arms as they are hardest to integrate in so many moves: empty, and with the most friction.

    Args:
        table: Arms at the episode's start, shape (n, len(FIELDS)).
        moves: Of the episode.
    """
    if moves == 1:
        return table
    fastest = table.copy()
    fastest[:, COLUMN.payload_mass] = 0.0
    fastest[:, _FRICTION] *= np.maximum(MOST_FRICTION, 1 + table[:, COLUMN.friction_drift])[:, None]
    return fastest


@inlined
def next_drift(drawn: float, level: float) -> float:
    """Return the drift of friction over a move that begins at a level, from one that was drawn from its range."""
    size, there = abs(drawn), level * (1 + drawn)
    drift = -size if there > MOST_FRICTION else (size if there < LEAST_FRICTION else drawn)
    return min(max(drift, LEAST_FRICTION / level - 1), MOST_FRICTION / level - 1, _MOST_DRIFT)


@inlined
def change_row(row: Any, drawn: Any, level: float, loaded: bool) -> float:
    """Change an arm's row to that of its next move, and return the level of friction at which that begins.

    Args:
        row: Constants over the move before, shape (len(FIELDS),); changed.
        drawn: Constants drawn from their ranges; only payload and drift are taken.
        level: Level of friction at which the move before has begun.
        loaded: Whether the next move carries a part.
    """
    worn = 1 + row[COLUMN.friction_drift]
    row[COLUMN.motor_viscous_friction] *= worn
    row[COLUMN.coulomb_friction] *= worn
    row[COLUMN.payload_mass] = drawn[COLUMN.payload_mass] if loaded else 0.0
    row[COLUMN.friction_drift] = next_drift(drawn[COLUMN.friction_drift], level * worn)
    return level * worn
