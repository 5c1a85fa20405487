"""What vibration feedback does to ringing: ratios, and the words that they are given."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltarm_env.task.reference import MoveShape
from eval.reproduction.loop import ServoGains
from eval.reproduction.runs import Assumptions, Ringing, ringing_of, run_moves, run_random_moves
from eval.reproduction.words import LEFT, number, percent

Floats = NDArray[np.float64]

CLEAR = 0.8
"""Ringing is called reduced below this ratio to that without vibration feedback, and increased above its inverse."""
GONE = 0.1
"""Ringing is called gone below this ratio."""
_NEAR = 1.25  # a ratio within this factor of `GONE` is close to it


class Compared(NamedTuple):
    """Ringing of the same moves without and with vibration feedback."""

    without: Ringing
    suppressed: Ringing

    def ratios(self, phase: str) -> Floats:
        """With over without for every move.

        Infinite where the arm left its workspace with vibration feedback only, NaN where there is nothing to compare
        with: the phase is empty, or the arm left its workspace without.
        """
        before, after = getattr(self.without, phase), getattr(self.suppressed, phase)
        comparable = np.isfinite(before) & (before > 0)
        return np.divide(after, before, out=np.full(before.shape, np.nan), where=comparable)

    def one(self, move: int) -> Compared:
        """One of the moves alone."""
        return Compared(*(Ringing(*(phase[[move]] for phase in rung)) for rung in self))

    def ratio(self, phase: str) -> float:
        """The ratio of the first move."""
        return float(self.ratios(phase)[0])

    def shown(self, phase: str) -> str:
        """The ratio of the first move as text, or why there is none."""
        return self.left or number(self.ratio(phase), 2)

    @property
    def left(self) -> str:
        """That the arm left its workspace on the first move, and whether it needs no vibration feedback for it."""
        if np.isinf(self.without.stop[0]):
            return f"{LEFT} with K4 = 0"
        return LEFT if np.isinf(self.suppressed.stop[0]) else ""

    @property
    def answer(self) -> str:
        """Whether vibration feedback removes the ringing of the first move, judged at the end of the recording."""
        ratio = self.ratio("end")
        if np.isnan(ratio):
            return "not comparable"
        return "yes" if ratio < GONE else "in part" if ratio < CLEAR else "no"

    @property
    def answer_is_near(self) -> bool:
        """Whether a somewhat other `GONE` would give another answer."""
        return GONE / _NEAR < self.ratio("end") < GONE * _NEAR

    def fate(self, phase: str) -> str:
        """What became of the first move's ringing, such as `reduced to 36 %`."""
        word, ratio = effect(self.ratio(phase)), self.ratio(phase)
        if not np.isfinite(ratio):
            return f"not comparable ({self.left or 'there is none to compare with'})"
        return f"{word} {'at' if word == 'unchanged' else 'to'} {percent(ratio)}"


def effect(ratio: float) -> str:
    """What a ratio of ringing with to ringing without vibration feedback means, in a word."""
    if np.isnan(ratio):
        return "not comparable"
    return "reduced" if ratio < CLEAR else "increased" if ratio > 1 / CLEAR else "unchanged"


def compare(assumed: Assumptions, gains: ServoGains, moves: list[MoveShape]) -> Compared:
    """Run moves without and with vibration feedback."""
    return Compared(*(ringing_of(run_moves(assumed, g, moves)) for g in without_and_with(gains)))


def compare_random(assumed: Assumptions, gains: ServoGains, count: int, seed: int) -> Compared:
    """The same for moves that the environment draws."""
    return Compared(*(ringing_of(run_random_moves(assumed, g, count, seed)) for g in without_and_with(gains)))


def without_and_with(gains: ServoGains) -> tuple[ServoGains, ServoGains]:
    """The gains with K4 = 0, and as they are."""
    return replace(gains, k4=0.0), gains
