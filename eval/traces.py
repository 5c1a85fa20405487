"""Motions to show: of some methods on one scenario of each split, run once more on their own."""

from __future__ import annotations

import numpy as np

from beltarm_env.rollout import Recording
from eval.colours import COLOURS
from eval.results import Comparison, Outcome
from eval.splits import Split

Traces = dict[str, dict[str, Recording]]
"""Per split and method a recording of one arm, on the same scenario for all methods."""


def shown_methods(comparison: Comparison) -> list[str]:
    """Methods whose motion is drawn: the first, all learned and added ones, and the best others by cost."""
    split = "randomized" if "randomized" in comparison.splits() else comparison.splits()[-1]
    outcomes = [outcome for outcome in comparison.on(split) if outcome.ranked] or comparison.on(split)
    by_cost = sorted(outcomes[1:], key=lambda outcome: outcome.estimates["cost"].iqm)
    first = [outcome for outcome in by_cost if outcome.method.kind in ("learned", "added")]
    others = [outcome for outcome in by_cost if outcome.method.kind == "classical"]
    kept = [outcomes[0], *first[:3], *others]
    names = {outcome.method.name for outcome in kept[: len(COLOURS) - 2]}
    return [outcome.method.name for outcome in outcomes if outcome.method.name in names]


def shown_scenario(outcomes: list[Outcome]) -> int:
    """The scenario in which the first method does as well as it does in the median."""
    errors = outcomes[0].metrics["tip_rms_mm"][0]
    return int(np.argsort(errors)[len(errors) // 2])


def record(comparison: Comparison, splits: dict[str, Split]) -> Traces:
    """Record what is shown; a policy by its first training seed."""
    names = shown_methods(comparison)
    traces: Traces = {}
    for split in comparison.splits():
        outcomes = comparison.on(split)
        scenario = shown_scenario(outcomes)
        traces[split] = {
            outcome.method.name: splits[split].run(outcome.method.controller(0, []), scenario)
            for outcome in outcomes
            if outcome.method.name in names
        }
    return traces
