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
from eval.studies.paper.linear import ServoGains, without_and_with
from eval.studies.paper.ringing import Ringing, Suppression, ringing_of
from eval.studies.paper.runs import Conditions, run_moves

UPPER_END = 1.0
DRIVES = (IDEAL, *EFFECTS)
"""Drives by name: ideal, with one effect, with all of them."""


def run_drives(gains: ServoGains, moves: list[MoveShape], conditions: Conditions, draws: int) -> list[Recording]:
    """Run moves on all drives, without and with vibration feedback.

    Args:
        gains: Of the servo.
        moves: The moves.
        conditions: Arm and servo.
        draws: Number of drives with each effect.

    Returns:
        A recording without and one with vibration feedback: for each move all `DRIVES` one after the other, for each
        drive `draws` episodes.
    """
    drawn = _drawn(conditions, draws)
    arms = np.concatenate([with_effect(drawn, drive, UPPER_END) for _ in moves for drive in DRIVES])
    shapes = [move for move in moves for _ in range(len(DRIVES) * draws)]
    return [run_moves(conditions, each, shapes, arms) for each in without_and_with(gains)]


def _drawn(conditions: Conditions, draws: int) -> Floats:
    """The arm of some conditions with drives drawn from the training ranges."""
    env = BeltArmVectorEnv(draws, randomization=DRIVE_RANGES)
    env.reset(seed=PAPER_DRIVES.first)
    table = np.tile(conditions.arm.row(), (draws, 1))
    columns = [getattr(COLUMN, name) for name in FIELDS if name in DRIVE_RANGES]
    table[:, columns] = env.params_table[:, columns]
    return table


def compare(runs: list[Recording], draws: int) -> list[dict[str, Any]]:
    """Peak-to-peak motion and ringing, without and with vibration feedback, for each move and each of `DRIVES`."""
    whole = Suppression(*map(ringing_of, runs))
    motions = [np.where(run.finished, run.metrics()["residual_pp_mm"], np.inf) for run in runs]
    rows = []
    for first in range(0, len(motions[0]), draws):
        chosen = slice(first, first + draws)
        ringing = Suppression(*(Ringing(*(phase[chosen] for phase in rung)) for rung in whole))
        before, after = (motion[chosen] for motion in motions)
        there = np.isfinite(before) & (before > 0)
        rows.append(
            {
                "drive": DRIVES[first // draws % len(DRIVES)],
                "motion": [np.median(before), np.median(after)],
                "motion_ratio": spread(np.divide(after, before, out=np.full(draws, np.nan), where=there)),
                "ringing": [np.median(rung.stop) for rung in ringing],
                "stop": spread(ringing.ratios("stop")),
                "end": spread(ringing.ratios("end")),
                "answers": Counter(ringing.only(k).answer for k in range(draws)),
                "ratios": {phase: ringing.ratios(phase) for phase in ("stop", "end")},
            }
        )
    return rows


def spread(ratios: Floats) -> list[float]:
    """Median, smallest and largest value, without drives that have nothing to compare; empty if none has."""
    ratios = ratios[~np.isnan(ratios)]
    return [np.median(ratios), ratios.min(), ratios.max()] if len(ratios) else []
