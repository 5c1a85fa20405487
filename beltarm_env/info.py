"""Names of what a step tells in its `info`, and the form that a batch tells it in."""

from __future__ import annotations

from typing import Any

import numpy as np

from beltarm_env.arrays import Flags, Floats

TERMS = ("tip_error", "cost_position", "cost_velocity", "cost_torque_rate")
"""Tip error [m] and the terms of the cost, of one step."""
TOTALS = (
    "total_cost",
    "total_cost_position",
    "total_cost_velocity",
    "total_cost_torque_rate",
    "episode_steps",
    "tip_error_rms",
    "tip_error_max",
)
"""Episode summary: costs with the charge for steps not taken, tip errors [m]."""
MOVE_TOTALS = ("move_cost", "move_tip_error_rms", "move_tip_error_max", "move_vibration", "move_still_time")
"""Summary of a move that is over: cost, tip errors, vibration after its end [m], time until the arm is still [s]."""
_WITH_MASKS: dict[tuple[str, ...], tuple[str, ...]] = {
    names: (*names, *(f"_{name}" for name in names)) for names in (TERMS, TOTALS, MOVE_TOTALS)
}
Ended = tuple[Floats, Flags]
"""Summaries of moves, shape (len(MOVE_TOTALS), n), and which arms they are of, shape (n,)."""


def masked(names: tuple[str, ...], values: Floats, mask: Flags) -> dict[str, Any]:
    """Info entries in Gymnasium's form: an array per name, and beside it which arms it holds for."""
    return dict(zip(_WITH_MASKS[names], (*values, *(mask.copy() for _ in names)), strict=True))


def of_moves(moves: Ended | None, arms: Flags) -> dict[str, Any]:
    """Info entries of moves that are over, of these arms."""
    if moves is None or not (ended := moves[1] & arms).any():
        return {}
    return masked(MOVE_TOTALS, np.where(ended, moves[0], 0.0), ended)
