"""Recordings of some methods on one scenario of each split, each run alone, for the pictures."""

from __future__ import annotations

from functools import partial

import numpy as np

from beltarm_env.rollout import Recording, rollout
from eval.comparison.estimates import interquartile_mean
from eval.comparison.pairs import Failure, run_controller
from eval.comparison.results import Comparison, MethodOutcome
from eval.comparison.splits import Split
from eval.style.colours import COLOURS

Traces = dict[str, dict[str, Recording]]
"""Per split and method a recording of one arm, on the same scenario for all methods."""


def shown_seed(comparison: Comparison, method: str) -> int:
    """Training seed that represents a method: that of median cost on the main split."""
    outcomes = {outcome.split: outcome for outcome in comparison.outcomes if outcome.method.name == method}
    outcome = outcomes.get(comparison.main_split) or next(iter(outcomes.values()))
    costs = [interquartile_mean(of_seed) for of_seed in outcome.metrics["cost"]]
    return int(np.argsort(costs)[len(costs) // 2])


def seed_note(comparison: Comparison, methods: list[str]) -> str:
    """Sentence that names the training seeds that represent learned methods; empty without learned methods."""
    several = {o.method.name: o.seeds for o in comparison.methods() if o.method.name in methods and o.seeds > 1}
    if not several:
        return ""
    named = "; ".join(f"{name} by seed {shown_seed(comparison, name)} of 0 to {n - 1}" for name, n in several.items())
    return f"A learned method is shown by the training seed of median cost on {comparison.main_split}: {named}."


def shown_methods(comparison: Comparison) -> list[str]:
    """Methods whose motion is drawn: the first, all learned and added ones, and the best others by cost."""
    on_main = comparison.on(comparison.main_split)
    outcomes = [outcome for outcome in on_main if outcome.ranked] or on_main
    by_cost = sorted(outcomes[1:], key=lambda outcome: outcome.estimates["cost"].iqm)
    first = [outcome for outcome in by_cost if outcome.method.kind in ("learned", "added")]
    others = [outcome for outcome in by_cost if outcome.method.kind == "classical"]
    kept = [outcomes[0], *first[:3], *others]
    names = {outcome.method.name for outcome in kept[: len(COLOURS) - 2]}
    return [outcome.method.name for outcome in outcomes if outcome.method.name in names]


def shown_scenario(outcomes: list[MethodOutcome]) -> int:
    """Scenario in which the first method has its median tip error."""
    errors = outcomes[0].metrics["tip_rms_mm"][0]
    return int(np.argsort(errors)[len(errors) // 2])


def motions(
    comparison: Comparison, split: Split, scenario: int, names: list[str]
) -> tuple[dict[str, Recording], list[Failure]]:
    """Record some methods on one scenario, each alone in its environment; also returns failures.

    What is drawn is what was measured: a recording whose cost is another one is a failure.
    """
    recordings, failures = {}, []
    for outcome in comparison.on(split.name):
        if outcome.method.name not in names:
            continue
        seed, where = shown_seed(comparison, outcome.method.name), f"on scenario {scenario}"
        run = partial(_measured, outcome, split.later(outcome.latency), seed, scenario)
        found = run_controller(outcome.method, split.name, run, where)
        if isinstance(found, Failure):
            failures.append(found)
        else:
            recordings[outcome.method.name] = found
    return recordings, failures


def _measured(outcome: MethodOutcome, split: Split, seed: int, scenario: int) -> Recording:
    """Record the very episode that was measured: alone, or where that is another one, among all scenarios.

    Every shipped method moves an arm in the same way alone and in a batch; a user's own may not, to the last digit.

    Raises:
        ValueError: If the episode is neither.
    """
    costs = outcome.metrics["cost"][seed]
    method, count = outcome.method, len(costs)
    alone = split.run(method.controller(seed, []), scenario)
    if alone.cost[0] == costs[scenario]:
        return alone
    arguments = split.arguments(slice(count))
    again = rollout(method.controller(seed, split.arms(count)), count, sensors=method.sensors, **arguments).arm(
        scenario
    )
    if again.cost[0] == costs[scenario]:
        return again
    raise ValueError(f"it cost {costs[scenario]:.9g}, and costs {again.cost[0]:.9g} when run again: it is not drawn")


def record(comparison: Comparison, splits: dict[str, Split]) -> tuple[Traces, list[Failure]]:
    """Record the shown methods on one scenario of each split; also returns failures."""
    names = shown_methods(comparison)
    traces: Traces = {}
    failures = []
    for split in comparison.splits():
        found, failed = motions(comparison, splits[split], shown_scenario(comparison.on(split)), names)
        failures += failed
        if found:
            traces[split] = found
    return traces, failures
