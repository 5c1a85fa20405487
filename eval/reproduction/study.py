"""The study of the paper's claim: all simulated moves that the pictures and tables show, run once."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beltarm_env.task.reference import MoveShape
from beltarm_env.task.seeds import PAPER_MOVES
from eval.reproduction.assumptions import Alternative, Assumption, list_assumptions, try_alternatives
from eval.reproduction.loop import ServoGains, without_and_with
from eval.reproduction.responses import Response, response
from eval.reproduction.ringing import (
    REDUCED,
    REMOVED,
    Answer,
    Suppression,
    ringing_of,
    suppression,
)
from eval.reproduction.runs import ANALYSED, SIMULATED, is_allowed, run_moves

Floats = NDArray[np.float64]

_SWEPT = 33  # ramp times
_SAME = 1e-6  # relative difference below which a value changes nothing; actions are rounded to float32

STANDARD, TO_0 = "standard", "to 0°"
FRICTION, AS_ANALYSED = "with friction", "as analysed"
MEASURED = "as analysed, torsion measured"
FULL, FULL_ANALYSED = "full arm, with friction", "full arm, as analysed"
MAIN = {FRICTION: SIMULATED, AS_ANALYSED: ANALYSED}
"""The two sets of conditions around which everything else is varied."""
BOTH_ARMS = {
    **MAIN,
    FULL: replace(SIMULATED, model="lagrangian"),
    FULL_ANALYSED: replace(ANALYSED, model="lagrangian"),
}
"""Conditions of the random moves."""
VIEWS = {**MAIN, MEASURED: replace(ANALYSED, true_torsion=True), **BOTH_ARMS}
"""Conditions of the standard move and of the one to 0 degrees."""


@dataclass(frozen=True, slots=True)
class Scene:
    """One move without and with vibration feedback."""

    move: MoveShape
    without: Response
    suppressed: Response
    ringing: Suppression


@dataclass(frozen=True, slots=True)
class RandomShares:
    """Shares of the random moves by what becomes of their ringing in one phase; NaN where none is comparable."""

    removed: float
    reduced: float  # the removed among them
    increased: float  # those among them on which the arm leaves its workspace
    median: float  # ratio; infinite where the arm leaves its workspace on most


@dataclass(frozen=True, slots=True)
class PaperStudy:
    """Everything simulated for one set of gains and one standard move."""

    gains: ServoGains
    move: MoveShape  # the standard move
    scenes: dict[tuple[str, str], Scene]  # by place (`STANDARD`, `TO_0`) and conditions (`VIEWS`)
    assumptions: list[Assumption]
    found: dict[str, dict[str, Suppression]]  # by conditions (`MAIN`) and label of the alternative
    ramp_times: Floats  # of the standard move [s], swept
    sweep: dict[str, Suppression]  # by conditions (`MAIN`)
    random: dict[str, Suppression]  # random moves, by conditions (`BOTH_ARMS`)

    def standard(self, view: str) -> Suppression:
        """The standard move under some of `VIEWS`."""
        return self.scenes[STANDARD, view].ringing

    def answers(self, view: str) -> Counter[Answer]:
        """Number of alternatives with each answer, of those that change anything."""
        return Counter(self.found[view][tried.label].answer for tried in self.tried(view))

    def tried(self, view: str) -> list[Alternative]:
        """Alternatives that make any difference to the standard move."""
        alternatives = [tried for assumption in self.assumptions for tried in assumption.alternatives]
        return [tried for tried in alternatives if self.differs(view, tried.label)]

    def differs(self, view: str, label: str) -> bool:
        """Whether an alternative makes any difference to the standard move."""
        found, usual = self.found[view][label], self.standard(view)
        pair = zip([*found.without, *found.suppressed], [*usual.without, *usual.suppressed], strict=True)
        return not all(np.allclose(found, usual, rtol=_SAME, atol=0, equal_nan=True) for found, usual in pair)

    def shares(self, view: str, phase: str) -> RandomShares:
        """What becomes of the random moves' ringing in one of `PHASES`."""
        ratios = self.random[view].ratios(phase)
        ratios = ratios[~np.isnan(ratios)]
        if not len(ratios):
            return RandomShares(math.nan, math.nan, math.nan, math.nan)
        return RandomShares(
            removed=float(np.mean(ratios < REMOVED)),
            reduced=float(np.mean(ratios < REDUCED)),
            increased=float(np.mean(ratios > 1 / REDUCED)),
            median=float(np.quantile(ratios, 0.5, method="inverted_cdf")),
        )

    def count_left(self, view: str) -> tuple[int, int]:
        """Number of the random moves on which the arm leaves its workspace, without and with vibration feedback."""
        without, suppressed = (int(np.isinf(rung.stop).sum()) for rung in self.random[view])
        return without, suppressed


def run_study(gains: ServoGains, move: MoveShape) -> PaperStudy:
    """Run everything; `move` is the standard move."""
    to_0 = move._replace(start=abs(move.goal - move.start), goal=0.0)
    assumptions = list_assumptions(move)
    swept = [move._replace(ramp_time=float(ramp)) for ramp in np.linspace(0.05, 0.5, _SWEPT) * move.duration]
    swept = [one for one in swept if is_allowed(one)]
    return PaperStudy(
        gains,
        move,
        _scenes(gains, {STANDARD: move, TO_0: to_0}),
        assumptions,
        {view: try_alternatives(assumptions, base, gains) for view, base in MAIN.items()},
        np.array([one.ramp_time for one in swept]),
        {view: suppression(conditions, gains, swept) for view, conditions in MAIN.items()},
        {view: suppression(under, gains, PAPER_MOVES) for view, under in BOTH_ARMS.items()},
    )


def _scenes(gains: ServoGains, moves: dict[str, MoveShape]) -> dict[tuple[str, str], Scene]:
    """Run moves, by place, under each of `VIEWS`."""
    scenes = {}
    for view, conditions in VIEWS.items():
        without, suppressed = (run_moves(conditions, g, list(moves.values())) for g in without_and_with(gains))
        ringing = Suppression(ringing_of(without), ringing_of(suppressed))
        for k, (place, move) in enumerate(moves.items()):
            scenes[place, view] = Scene(move, response(without, k), response(suppressed, k), ringing.one(k))
    return {(place, view): scenes[place, view] for place in moves for view in VIEWS}
