"""`adaptive` that makes the same move on the same arm again, and remembers the arm.

After a trial the arm is brought back to rest at its start. What the filter (`baselines.estimation.arm_ekf`) believes
of the constants of arm and drive lasts: their part of z and of its covariance P, and the encoder's resolution. All else
is that of a filter that begins: x is that of an arm at rest at the measured angle, x and the constants are
uncorrelated, no command is under way. So every trial is planned anew, for the task's own cost, on the arm remembered.

The deflection g by which a motor gives before it slips begins anew too, unless `keeps_giving`. The arms of single moves
stick without giving, and yet g grows while their motors rest. Kept over repetitions of one move it runs to its bound,
and the belief of S and K_s goes wrong with it. The study `iterative` shows what both cost.

It makes the same move on the same arm again, which no ranked controller may do: a yardstick.
"""

from __future__ import annotations

from copy import deepcopy

import numpy as np

from baselines.estimation.believed_arm import DISTURBANCE, GIVING, SIZE
from baselines.estimation.identification import Belief
from baselines.gains import tuned
from baselines.optimal.adaptive import AdaptiveController, AdaptiveGains
from baselines.reading import Reading
from beltarm_env.arrays import Flags

_STATE = tuple(range(4))  # entries of z: x


class RememberingController(AdaptiveController):
    """Controller of one trial of n arms, which notes what it believes of them for the next one.

    Args:
        remembered: Belief about the arms from trials before, see `following`; None in the first trial, which is that
            of `adaptive`.
        keeps_giving: Whether g is remembered too.

    Raises:
        ValueError: If the file of gains is damaged or out of date.
    """

    def __init__(self, remembered: Belief | None = None, keeps_giving: bool = False) -> None:
        super().__init__(tuned("adaptive", AdaptiveGains))
        self.remembered, self._keeps_giving = remembered, keeps_giving
        self._first: Belief | None = None  # of this trial
        self._last: Belief | None = None
        self._stayed = np.zeros(0, np.bool_)  # arms that began one episode alone, shape (n,)

    def following(self) -> RememberingController:
        """Controller of the next trial. Of arms that did not finish this one it knows what this one began with.

        Raises:
            ValueError: If this controller did not make a trial.
        """
        if self._first is None or self._last is None:
            raise ValueError("a trial comes first: run one move with this controller")
        belief = deepcopy(self._last)
        self._write_constants(self._first, belief, ~self._stayed)
        return RememberingController(belief, self._keeps_giving)

    def _identified(self, reading: Reading, begins: Flags, belief: Belief | None) -> Belief:
        """Belief at this sample; at a trial's first one, with what is remembered.

        Raises:
            ValueError: If what is remembered is not of as many arms.
        """
        now = super()._identified(reading, begins, belief)
        if belief is not None:
            self._stayed &= ~begins
        else:
            self._stayed = np.ones(len(begins), np.bool_)
            if self.remembered is not None:
                if len(self.remembered.counts) != len(begins):
                    count = len(self.remembered.counts)
                    raise ValueError(f"{count} arms are remembered, got observations of {len(begins)}")
                self._write_constants(self.remembered, now, self._stayed)
            self._first = now
        self._last = now
        return now

    def _write_constants(self, known: Belief, belief: Belief, arms: Flags) -> None:
        """Write what is known of the constants of some arms, shape (n,), into a belief."""
        forgotten = (*_STATE, DISTURBANCE, *(() if self._keeps_giving else (GIVING,)))
        lasting = np.setdiff1d(np.arange(SIZE), forgotten)
        chosen = np.flatnonzero(arms)
        means, block = np.ix_(chosen, lasting), np.ix_(chosen, lasting, lasting)
        belief.tracks.mean[means] = known.tracks.mean[means]
        belief.tracks.covariance[block] = known.tracks.covariance[block]
        belief.counts[chosen] = known.counts[chosen]
