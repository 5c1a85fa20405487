"""The paper's servo on the paper's arm, with the drive as it is built: each of its effects alone, and all of them.

The servo goes on taking the drive for ideal. Every effect is at the upper end of its training range; phases, orders,
Stribeck speeds and the signs of the torque constant's error and of the drift are drawn, so that there are several
drives with each effect.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from beltarm_env import BeltArmVectorEnv
from beltarm_env.arm import COLUMN, FIELDS
from beltarm_env.arrays import Floats
from beltarm_env.rollout import Recording
from beltarm_env.task.ranges import DRIVE_RANGES
from beltarm_env.task.reference import MoveShape
from beltarm_env.task.seeds import PAPER_DRIVES
from eval.comparison.effects import EFFECTS, IDEAL, with_effect
from eval.studies.paper.linear import ServoGains
from eval.studies.paper.runs import PHASES, Conditions, answer, ratios, ringing_of, run_moves

DRIVES = (IDEAL, *EFFECTS)
"""Drives by name: ideal, with one effect, with all of them."""


def run_drives(gains: ServoGains, moves: list[MoveShape], conditions: Conditions, draws: int) -> list[Recording]:
    """Run moves on `draws` drives of each kind.

    Returns:
        A recording without and one with vibration feedback: for each move all `DRIVES` one after the other, for each
        drive `draws` episodes.
    """
    env = BeltArmVectorEnv(draws, randomization=DRIVE_RANGES)
    env.reset(seed=PAPER_DRIVES.first)
    drawn = np.tile(conditions.arm.row(), (draws, 1))
    columns = [getattr(COLUMN, name) for name in FIELDS if name in DRIVE_RANGES]
    drawn[:, columns] = env.params_table[:, columns]
    arms = np.concatenate([with_effect(drawn, drive, 1.0) for _ in moves for drive in DRIVES])
    shapes = [move for move in moves for _ in range(len(DRIVES) * draws)]
    return [run_moves(conditions, each, shapes, arms) for each in gains.without_and_with]


def compare(runs: list[Recording], draws: int) -> list[list[dict[str, Any]]]:
    """Motion and ringing without and with vibration feedback: for each move a row for each of `DRIVES`."""
    motions = np.array([np.where(run.finished, run.metrics()["residual_pp_mm"], np.inf) for run in runs])
    motions = motions.reshape(2, -1, len(DRIVES), draws)
    ringing = np.array([ringing_of(run) for run in runs]).reshape(2, len(PHASES), *motions.shape[1:])
    return [
        [_row(drive, motions[:, k, j], ringing[:, :, k, j]) for j, drive in enumerate(DRIVES)]
        for k in range(motions.shape[1])
    ]


def _row(drive: str, motion: Floats, ringing: Floats) -> dict[str, Any]:
    """Numbers of one drive, from its motion, shape (2, draws), and its ringing, shape (2, len(PHASES), draws)."""
    _, stop, end = ratios(ringing)
    return {
        "drive": drive,
        "motion": np.median(motion, axis=1),
        "motion_ratio": _spread(ratios(motion)),
        "ringing": np.median(ringing[:, 1], axis=1),
        "stop": _spread(stop),
        "end": _spread(end),
        "answers": Counter(answer(ratio) for ratio in end),
        "ratios": {"stop": stop, "end": end},
    }


def _spread(values: Floats) -> list[float]:
    """Median, smallest and largest ratio, without drives that have nothing to compare; empty if none has."""
    values = values[~np.isnan(values)]
    return [np.median(values), values.min(), values.max()] if len(values) else []
