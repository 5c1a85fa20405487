"""Scores of the leaderboard: of each method on each split, and when two runs of a method are taken for the same."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from eval.comparison.pairs import LEFT, Metrics
from eval.comparison.splits import main_split
from eval.comparison.statistics import interquartile_mean, worst_mean

Scores = dict[str, dict[str, dict[str, float]]]
"""By method, split and quantity (`QUANTITIES`)."""


class Quantity(NamedTuple):
    """What a method is scored by on a split, over all training seeds and scenarios."""

    words: str
    tolerance: float  # between processors, relative for a cost, absolute for a share
    share: bool = False


QUANTITIES = {
    "iqm": Quantity("interquartile mean of the cost", 0.003),
    "mean": Quantity("mean cost", 0.005),
    "worst": Quantity("mean cost of the worst 5 %", 0.02),
    "not_settled": Quantity("share of episodes that do not settle", 0.005, share=True),
    "left": Quantity("share of arms that leave the workspace", 0.005, share=True),
}
"""By name. Processors round differently, and where a motor sticks is decided by a hair. First torques that differ by
1e-9 N m, more than rounding does, changed average costs of `paper`, `mpc`, `adaptive` and a seed of `student`
over 500 scenarios of each split of the development set (`student`: all but `structural`) by less than a tenth of these
tolerances."""


class Difference(NamedTuple):
    """A score that came out otherwise."""

    method: str
    split: str
    quantity: str
    submitted: float
    found: float

    @property
    def size(self) -> float:
        """Size of the difference, relative for a cost."""
        change = abs(self.found - self.submitted)
        return change if QUANTITIES[self.quantity].share else change / abs(self.submitted)

    @property
    def excess(self) -> float:
        """Size over what is allowed."""
        return self.size / QUANTITIES[self.quantity].tolerance

    @property
    def words(self) -> str:
        """What differs, and by how much."""
        quantity = QUANTITIES[self.quantity]
        return (
            f"{self.method} on {self.split}, {quantity.words}: submitted {self.submitted:.6g}, here {self.found:.6g}, "
            f"{100 * self.size:.3g} % {'of the episodes' if quantity.share else 'of it'} apart; at most "
            f"{100 * quantity.tolerance:g} % is allowed"
        )


def score(metrics: Metrics) -> dict[str, float]:
    """Scores of a method on one split."""
    cost = metrics["cost"]
    return {
        "iqm": interquartile_mean(cost),
        "mean": float(cost.mean()),
        "worst": worst_mean(cost),
        "not_settled": float(metrics["failure_share"].mean()),
        "left": float(metrics[LEFT].mean()),
    }


def differences(submitted: Scores, found: Scores) -> list[Difference]:
    """All scores beside what came out, in the order of the submission."""
    return [
        Difference(method, split, quantity, scores[quantity], found[method][split][quantity])
        for method, splits in submitted.items()
        for split, scores in splits.items()
        for quantity in QUANTITIES
    ]


def first_difference(submitted: Scores, found: Scores) -> Difference | None:
    """First score that differs by more than is allowed; None if all agree."""
    return next((each for each in differences(submitted, found) if each.excess > 1), None)


def largest_difference(submitted: Scores, found: Scores) -> Difference:
    """Score that comes closest to the difference that is allowed, or exceeds it most."""
    return max(differences(submitted, found), key=lambda each: each.excess)


def over_all_splits(scores: Scores, method: str, reference: str) -> float:
    """Geometric mean over all splits of a method's interquartile mean cost over that of a reference."""
    ratios = [scores[method][split]["iqm"] / scores[reference][split]["iqm"] for split in scores[method]]
    return float(np.exp(np.mean(np.log(ratios))))


def on_main_split(scores: Scores, method: str) -> dict[str, float]:
    """Scores of a method on the split that is asked about first."""
    return scores[method][main_split(list(scores[method]))]
