"""All simulated moves that the pictures and the summary show, run once."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beltarm_env import ArmParams
from beltarm_env.reference import MoveShape
from eval.reproduction.cases import CLEAR, Compared, Open, open_questions, run_all
from eval.reproduction.loop import PAPER_ARM, ServoGains
from eval.reproduction.runs import (
    Assumptions,
    Response,
    Ringing,
    is_allowed,
    response,
    ringing_of,
    run_moves,
    run_random_moves,
    without_friction,
)

Floats = NDArray[np.float64]

RANDOM_MOVES = 300
RANDOM_SEED = 1991
_SWEPT = 33  # ramp times

SIMULATED = Assumptions()
"""Table 1 with friction, and the belt's damping assumed."""
ANALYSED = without_friction(Assumptions(arm=PAPER_ARM))
"""As the paper's analysis has it: neither Coulomb friction nor belt damping."""


@dataclass(frozen=True, slots=True)
class Scene:
    """One move without and with vibration feedback."""

    move: MoveShape
    without: Response
    suppressed: Response
    compared: Compared


@dataclass(frozen=True, slots=True)
class RampSweep:
    """Ringing of the standard move over its ramp time, without and with vibration feedback."""

    ramp_times: Floats  # [s]
    ringing: dict[bool, Compared]  # by whether there is Coulomb friction


@dataclass(frozen=True, slots=True)
class Study:
    """Everything simulated."""

    gains: ServoGains
    move: MoveShape  # the standard move
    move_to_0: MoveShape  # the one for 0 degrees
    scenes: dict[tuple[str, str], Scene]  # by place ("90°", "0°") and assumptions (`VIEWS`)
    questions: list[Open]
    found: dict[str, list[Compared]]
    sweep: RampSweep
    random: dict[bool, Compared]  # random moves, by whether there is Coulomb friction

    def share_reduced(self, friction: bool, phase: str) -> float:
        """Share of the random moves whose ringing vibration feedback reduces clearly."""
        return float(np.mean(self.random[friction].ratios(phase) < CLEAR))

    def share_increased(self, friction: bool, phase: str) -> float:
        """Share of the random moves whose ringing it increases clearly."""
        return float(np.mean(self.random[friction].ratios(phase) > 1 / CLEAR))


VIEWS = {
    "with friction": SIMULATED,
    "as analysed": ANALYSED,
    "as analysed, torsion measured": replace(ANALYSED, true_torsion=True),
}
"""Assumptions under which both moves are run."""


def run_study(gains: ServoGains, move: MoveShape) -> Study:
    """Run everything; `move` is the standard move."""
    length = abs(move.goal - move.start)
    to_0 = move._replace(start=length, goal=0.0)
    scenes = {
        (place, view): _scene(assumed, gains, of_place)
        for place, of_place in (("90°", move), ("0°", to_0))
        for view, assumed in VIEWS.items()
    }
    questions = open_questions(move)
    return Study(
        gains,
        move,
        to_0,
        scenes,
        questions,
        run_all(questions, gains),
        _sweep(gains, move),
        {friction: _random(gains, friction) for friction in (True, False)},
    )


def _frictional(friction: bool) -> Assumptions:
    return SIMULATED if friction else without_friction(SIMULATED)


def _scene(assumed: Assumptions, gains: ServoGains, move: MoveShape) -> Scene:
    without = run_moves(assumed, replace(gains, k4=0.0), [move])
    suppressed = run_moves(assumed, gains, [move])
    compared = Compared(ringing_of(without), ringing_of(suppressed))
    return Scene(move, response(without), response(suppressed), compared)


def _sweep(gains: ServoGains, move: MoveShape) -> RampSweep:
    ramps = [float(ramp) for ramp in np.linspace(0.05, 0.5, _SWEPT) * move.duration]
    moves = [move._replace(ramp_time=ramp) for ramp in ramps]
    moves = [shorter for shorter in moves if is_allowed(shorter)]
    ringing = {}
    for friction in (True, False):
        assumed = _frictional(friction)
        pair = [ringing_of(run_moves(assumed, g, moves)) for g in (replace(gains, k4=0.0), gains)]
        ringing[friction] = Compared(*pair)
    return RampSweep(np.array([shorter.ramp_time for shorter in moves]), ringing)


def _random(gains: ServoGains, friction: bool) -> Compared:
    assumed = _frictional(friction)
    pair: list[Ringing] = [
        ringing_of(run_random_moves(assumed, g, RANDOM_MOVES, RANDOM_SEED)) for g in (replace(gains, k4=0.0), gains)
    ]
    return Compared(*pair)


def nominal_m2(angle: float, payload: float = 0.0) -> float:
    """M2 [kg m^2] of the nominal arm at an angle [rad]."""
    arm = ArmParams()
    swing = arm.arm_inertia_swing + (2 * arm.link_length) ** 2 * payload
    return arm.arm_inertia + swing * float(np.sin(angle)) ** 2
