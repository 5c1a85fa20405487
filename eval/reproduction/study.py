"""All simulated moves that the pictures and the summary show, run once."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beltarm_env import ArmParams
from beltarm_env.task.reference import MoveShape
from eval.reproduction.cases import Open, Variant, open_questions, run_all
from eval.reproduction.effects import CLEAR, GONE, Compared, compare, compare_random, without_and_with
from eval.reproduction.loop import ServoGains
from eval.reproduction.runs import (
    ANALYSED,
    SIMULATED,
    Assumptions,
    Response,
    is_allowed,
    response,
    ringing_of,
    run_moves,
)

Floats = NDArray[np.float64]

RANDOM_MOVES = 300
RANDOM_SEED = 1991
_SWEPT = 33  # ramp times
_SAME = 1e-6  # relative difference below which a value changes nothing; actions are rounded to float32

STANDARD, TO_0 = "standard", "to 0°"
REAL, AS_ANALYSED = "with friction", "as analysed"
MEASURED = "as analysed, torsion measured"
FULL, FULL_ANALYSED = "full arm, with friction", "full arm, as analysed"
MAIN = {REAL: SIMULATED, AS_ANALYSED: ANALYSED}
"""The two sets of assumptions around which everything else is varied."""
BOTH_ARMS = {
    **MAIN,
    FULL: replace(SIMULATED, model="lagrangian"),
    FULL_ANALYSED: replace(ANALYSED, model="lagrangian"),
}
"""Those under which the random moves are run."""
VIEWS = {**MAIN, MEASURED: replace(ANALYSED, true_torsion=True), **BOTH_ARMS}
"""Those under which the standard move and the one to 0 degrees are shown."""


@dataclass(frozen=True, slots=True)
class Scene:
    """One move without and with vibration feedback."""

    move: MoveShape
    without: Response
    suppressed: Response
    compared: Compared


@dataclass(frozen=True, slots=True)
class Study:
    """Everything simulated."""

    gains: ServoGains
    move: MoveShape  # the standard move
    scenes: dict[tuple[str, str], Scene]  # by place (`STANDARD`, `TO_0`) and assumptions (`VIEWS`)
    questions: list[Open]
    found: dict[str, dict[str, Compared]]  # by assumptions (`MAIN`) and label of the variant
    ramp_times: Floats  # of the standard move [s], swept
    sweep: dict[str, Compared]  # by assumptions (`MAIN`)
    random: dict[str, Compared]  # random moves, by assumptions (`BOTH_ARMS`)

    def standard(self, view: str) -> Compared:
        """The standard move under some of `VIEWS`."""
        return self.scenes[STANDARD, view].compared

    def tried(self, view: str) -> list[Variant]:
        """The variants that make any difference to the standard move."""
        variants = [variant for question in self.questions for variant in question.variants]
        return [variant for variant in variants if self.differs(view, variant.label)]

    def differs(self, view: str, label: str) -> bool:
        """Whether a variant makes any difference to the standard move."""
        found, usual = self.found[view][label], self.standard(view)
        pair = zip([*found.without, *found.suppressed], [*usual.without, *usual.suppressed], strict=True)
        return not all(np.allclose(found, usual, rtol=_SAME, atol=0, equal_nan=True) for found, usual in pair)

    def share_removed(self, view: str, phase: str) -> float:
        """Share of the random moves whose ringing vibration feedback removes."""
        return _share(self._ratios(view, phase) < GONE)

    def share_reduced(self, view: str, phase: str) -> float:
        """Share of the random moves whose ringing it reduces clearly."""
        return _share(self._ratios(view, phase) < CLEAR)

    def share_increased(self, view: str, phase: str) -> float:
        """Share of the random moves whose ringing it increases clearly, or on which the arm leaves its workspace."""
        return _share(self._ratios(view, phase) > 1 / CLEAR)

    def median_ratio(self, view: str, phase: str) -> float:
        """Median over the random moves; NaN where none is comparable, infinite where the arm leaves on most."""
        ratios = self._ratios(view, phase)
        return float(np.quantile(ratios, 0.5, method="inverted_cdf")) if len(ratios) else np.nan

    def count_left(self, view: str) -> tuple[int, int]:
        """Number of the random moves on which the arm leaves its workspace, without and with vibration feedback."""
        without, suppressed = (int(np.isinf(rung.stop).sum()) for rung in self.random[view])
        return without, suppressed

    def _ratios(self, view: str, phase: str) -> Floats:
        ratios = self.random[view].ratios(phase)
        return ratios[~np.isnan(ratios)]


def _share(which: NDArray[np.bool_]) -> float:
    return float(np.mean(which)) if len(which) else np.nan


def run_study(gains: ServoGains, move: MoveShape) -> Study:
    """Run everything; `move` is the standard move."""
    to_0 = move._replace(start=abs(move.goal - move.start), goal=0.0)
    questions = open_questions(move)
    swept = [move._replace(ramp_time=float(ramp)) for ramp in np.linspace(0.05, 0.5, _SWEPT) * move.duration]
    swept = [one for one in swept if is_allowed(one)]
    return Study(
        gains,
        move,
        {
            (place, view): _scene(assumed, gains, of_place)
            for place, of_place in ((STANDARD, move), (TO_0, to_0))
            for view, assumed in VIEWS.items()
        },
        questions,
        {view: run_all(questions, base, gains) for view, base in MAIN.items()},
        np.array([one.ramp_time for one in swept]),
        {view: compare(assumed, gains, swept) for view, assumed in MAIN.items()},
        {view: compare_random(assumed, gains, RANDOM_MOVES, RANDOM_SEED) for view, assumed in BOTH_ARMS.items()},
    )


def _scene(assumed: Assumptions, gains: ServoGains, move: MoveShape) -> Scene:
    without, suppressed = (run_moves(assumed, g, [move]) for g in without_and_with(gains))
    compared = Compared(ringing_of(without), ringing_of(suppressed))
    return Scene(move, response(without), response(suppressed), compared)


def nominal_m2(angle: float, payload: float = 0.0) -> float:
    """M2 [kg m^2] of the nominal arm at an angle [rad]."""
    arm = ArmParams()
    swing = arm.arm_inertia_swing + (2 * arm.link_length) ** 2 * payload
    return arm.arm_inertia + swing * float(np.sin(angle)) ** 2
