"""The paper's servo on the paper's arm, with the drive as it is built: each of its effects alone, and all of them.

The servo goes on taking the drive for ideal. Every effect is at the upper end of its training range; phases, orders,
Stribeck speeds and the signs of the torque constant's error and of the drift are drawn, so that there are several
drives with each effect.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from beltarm_env import BeltArmVectorEnv
from beltarm_env.arm import COLUMN, FIELDS
from beltarm_env.arrays import Floats
from beltarm_env.rollout import Recording
from beltarm_env.task.ranges import DRIVE_RANGES
from beltarm_env.task.reference import MoveShape
from beltarm_env.task.seeds import PAPER_DRIVES
from eval.comparison.effects import EFFECTS, IDEAL, with_effect
from eval.reproduction.loop import ServoGains, without_and_with
from eval.reproduction.ringing import Answer, Ringing, Suppression, ringing_of
from eval.reproduction.runs import Conditions, run_moves
from eval.reproduction.study import MAIN, STANDARD, TO_0

DRAWS = 24
"""Drives with each effect."""
UPPER_END = 1.0
DRIVES = (IDEAL, *EFFECTS)
"""What differs of the ideal drive: nothing, one effect, all of them."""


@dataclass(frozen=True, slots=True)
class Swings:
    """Signals of one move on n drives for the pictures: error of the tip's velocity along the arm [m/s], (T, n)."""

    time: Floats  # [s], (T,)
    without: Floats
    suppressed: Floats


@dataclass(frozen=True, slots=True)
class Damped:
    """One move under one set of conditions on n drives with one effect, without and with vibration feedback."""

    ringing: Suppression
    without: Floats  # peak-to-peak motion of the tip after the stop [mm]; inf where the arm left its workspace    (n,)
    suppressed: Floats  # the same with vibration feedback    (n,)
    swings: Swings

    @property
    def ratios(self) -> Floats:
        """Peak-to-peak motion with vibration feedback over that without; NaN where there is nothing to compare."""
        comparable = np.isfinite(self.without) & (self.without > 0)
        return np.divide(self.suppressed, self.without, out=np.full(len(self.without), np.nan), where=comparable)

    @property
    def answers(self) -> Counter[Answer]:
        """On how many drives the ringing is removed, by the same bounds as elsewhere."""
        return Counter(self.ringing.one(k).answer for k in range(len(self.without)))

    def some(self, chosen: slice) -> Damped:
        """The same on some of the drives."""
        ringing = Suppression(*(Ringing(*(phase[chosen] for phase in rung)) for rung in self.ringing))
        swings = Swings(self.swings.time, self.swings.without[:, chosen], self.swings.suppressed[:, chosen])
        return Damped(ringing, self.without[chosen], self.suppressed[chosen], swings)


@dataclass(frozen=True, slots=True)
class DrivesStudy:
    """Everything that the page and its pictures show."""

    gains: ServoGains
    moves: dict[str, MoveShape]  # by place, `STANDARD` and `TO_0`
    draws: int
    found: dict[tuple[str, str, str], Damped]  # by place, conditions (`MAIN`) and drive (`DRIVES`)


def run_drives(gains: ServoGains, move: MoveShape, draws: int = DRAWS) -> DrivesStudy:
    """Run the standard move and the one to 0 degrees on all drives.

    Args:
        gains: Of the servo.
        move: The standard move.
        draws: Number of drives with each effect.
    """
    moves = {STANDARD: move, TO_0: move._replace(start=abs(move.goal - move.start), goal=0.0)}
    keys = [(place, drive) for place in moves for drive in DRIVES]
    found = {}
    for view, conditions in MAIN.items():
        drawn = _drawn(conditions, draws)
        arms = np.concatenate([with_effect(drawn, drive, UPPER_END) for _, drive in keys])
        shapes = [moves[place] for place, _ in keys for _ in range(draws)]
        of_all = _damped(*(run_moves(conditions, g, shapes, arms) for g in without_and_with(gains)))
        for k, (place, drive) in enumerate(keys):
            found[place, view, drive] = of_all.some(slice(draws * k, draws * (k + 1)))
    return DrivesStudy(gains, moves, draws, found)


def _drawn(conditions: Conditions, draws: int) -> Floats:
    """The arm of some conditions with drives drawn from the training ranges."""
    env = BeltArmVectorEnv(draws, randomization=DRIVE_RANGES)
    env.reset(seed=PAPER_DRIVES.first)
    table = np.tile(conditions.arm.row(), (draws, 1))
    columns = [getattr(COLUMN, name) for name in FIELDS if name in DRIVE_RANGES]
    table[:, columns] = env.params_table[:, columns]
    return table


def _damped(without: Recording, suppressed: Recording) -> Damped:
    runs = (without, suppressed)
    before, after = (np.where(run.finished, run.metrics()["residual_pp_mm"], np.inf) for run in runs)
    swings = Swings(without.time, *(run.tip_velocity_error[:, :, 0] for run in runs))
    return Damped(Suppression(*map(ringing_of, runs)), before, after, swings)
