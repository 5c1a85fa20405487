"""Ringing of the tip, and what vibration feedback leaves of it.

Ringing is the root mean square of the tip's acceleration error, the two-dimensional distance from the acceleration of a
rigid arm on the reference: the signal of Figs. 4 and 8 with the move itself taken out. It hardly sees the slow return
of the position loop, which is no vibration.
"""

from __future__ import annotations

from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from beltarm_env import CONTROL_PERIOD
from beltarm_env.rollout import Recording
from beltarm_env.task.reference import MoveShape
from beltarm_env.task.seeds import SeedRange
from eval.studies.paper.linear import ServoGains, without_and_with
from eval.studies.paper.runs import Conditions, run_moves

Floats = NDArray[np.float64]
Answer = Literal["yes", "in part", "no", "not comparable"]

END_WINDOW = 0.3
"""Length of the last phase [s]: what still rings at the end of the recording."""
PHASES = {"cruise": "during the cruise", "stop": "after the stop", "end": f"in the last {END_WINDOW:g} s"}
REDUCED = 0.8
"""Ratio to the ringing without vibration feedback below which it counts as reduced; above the inverse, as increased."""
REMOVED = 0.1
"""Ratio below which it counts as removed."""
ANSWERS: tuple[Answer, ...] = get_args(Answer)


class Ringing(NamedTuple):
    """RMS acceleration error of the tip [m/s^2] in three phases, each of shape (n,).

    NaN where a phase is empty, infinite where the arm left its workspace.
    """

    cruise: Floats  # while the reference speed is constant
    stop: Floats  # from the reference's stop to the end of the recording
    end: Floats  # the last `END_WINDOW` of the recording


def ringing(tip_velocity_error: Floats, durations: Floats, ramp_times: Floats) -> Ringing:
    """Measure ringing in the error of the tip's velocity.

    Args:
        tip_velocity_error: Shape (T, n, 2) [m/s], row k at (k + 1) control periods.
        durations: Of the moves [s], shape (n,).
        ramp_times: Of the moves [s], shape (n,).
    """
    acceleration = np.diff(tip_velocity_error, axis=0) / CONTROL_PERIOD
    square = np.sum(acceleration**2, axis=2)
    middle = (np.arange(len(square)) + 1.5)[:, None] * CONTROL_PERIOD
    last = (len(square) + 1) * CONTROL_PERIOD
    # The reference's acceleration jumps at its corners: differences across them are no ringing.
    windows = (
        (middle > ramp_times + CONTROL_PERIOD) & (middle < durations - ramp_times - CONTROL_PERIOD),
        middle > durations + CONTROL_PERIOD,
        (middle > last - END_WINDOW) & (middle > durations + CONTROL_PERIOD),
    )
    return Ringing(*(_rms(square, window) for window in windows))


def _rms(square: Floats, window: NDArray[np.bool_]) -> Floats:
    count = window.sum(axis=0)
    total = np.where(window, square, 0.0).sum(axis=0)
    return np.sqrt(np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0))


def ringing_of(recording: Recording) -> Ringing:
    """`ringing` of recorded moves."""
    phases = ringing(recording.tip_velocity_error, recording.moves[:, 2], recording.moves[:, 3])
    return Ringing(*(np.where(recording.finished, phase, np.inf) for phase in phases))


class Suppression(NamedTuple):
    """Ringing of the same n moves without and with vibration feedback."""

    without: Ringing
    suppressed: Ringing

    def ratios(self, phase: str) -> Floats:
        """Ringing with vibration feedback over that without, shape (n,).

        Infinite where the arm left its workspace with vibration feedback only, NaN where there is nothing to compare
        with: the phase is empty, or the arm left its workspace without.
        """
        before, after = getattr(self.without, phase), getattr(self.suppressed, phase)
        comparable = np.isfinite(before) & (before > 0)
        return np.divide(after, before, out=np.full(before.shape, np.nan), where=comparable)

    def only(self, move: int) -> Suppression:
        """One of the moves alone."""
        return Suppression(*(Ringing(*(phase[[move]] for phase in rung)) for rung in self))

    def ratio(self, phase: str) -> float:
        """Ratio of the first move."""
        return float(self.ratios(phase)[0])

    @property
    def answer(self) -> Answer:
        """Whether vibration feedback removes the ringing of the first move, judged at the end of the recording."""
        ratio = self.ratio("end")
        if np.isnan(ratio):
            return "not comparable"
        return "yes" if ratio < REMOVED else "in part" if ratio < REDUCED else "no"


def suppression(conditions: Conditions, gains: ServoGains, moves: list[MoveShape] | SeedRange) -> Suppression:
    """Run moves, or those that the environment draws from some seeds, without and with vibration feedback."""
    return Suppression(*(ringing_of(run_moves(conditions, g, moves)) for g in without_and_with(gains)))
