"""Recordings of some methods on one scenario of each split, each run alone, for the pictures."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from beltarm_env.rollout import Recording, rollout
from eval.comparison.failures import Failure, run_controller
from eval.comparison.results import Comparison, MethodOutcome
from eval.comparison.splits import Split, beside_one_another, side_by_side
from eval.comparison.statistics import interquartile_mean
from eval.report.style import COLOURS

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


class Shown(NamedTuple):
    """Scenario that is drawn."""

    split: Split
    scenario: int


def motions(
    comparison: Comparison, shown: Sequence[Shown], names: Collection[str]
) -> tuple[list[dict[str, Recording]], list[Failure]]:
    """Record some methods on some scenarios; also returns failures.

    What is drawn is what was measured: a recording whose cost is another one is a failure.

    Returns:
        For each scenario, in order, a recording of one arm by method; and failures.
    """
    found: list[dict[str, Recording]] = [{} for _ in shown]
    failures = []
    for method in dict.fromkeys(outcome.method.name for outcome in comparison.outcomes):
        if method not in names:
            continue
        seed = shown_seed(comparison, method)
        outcomes = {outcome.split: outcome for outcome in comparison.outcomes if outcome.method.name == method}
        cases = {k: _Case(outcomes[on.split.name], on) for k, on in enumerate(shown) if on.split.name in outcomes}
        recordings = _side_by_side(list(cases.values()), seed)
        for (k, case), recording in zip(cases.items(), recordings, strict=True):
            result = case.by_itself(seed) if recording is None else recording
            if isinstance(result, Failure):
                failures.append(result)
            else:
                found[k][method] = result
    return found, failures


@dataclass(frozen=True)
class _Case:
    """A method on a scenario."""

    outcome: MethodOutcome
    shown: Shown

    @cached_property
    def split(self) -> Split:
        """The split as it was run."""
        return self.shown.split.later(self.outcome.latency)

    def is_measured(self, recording: Recording, seed: int) -> bool:
        """Whether a recording of one arm is of the episode that was measured, as far as its cost tells."""
        return bool(recording.cost[0] == self.outcome.metrics["cost"][seed, self.shown.scenario])

    def by_itself(self, seed: int) -> Recording | Failure:
        """Record the episode."""
        where = f"on scenario {self.shown.scenario}"
        return run_controller(self.outcome.method, self.split.name, partial(_measured, self, seed), where)


def _side_by_side(cases: list[_Case], seed: int) -> list[Recording | None]:
    """Record episodes of a method in as few batches as there are kinds of settings; None for what was not measured so.

    Every shipped method moves an arm in the same way in any batch; a user's own may not, to the last digit, or fail.
    """
    found: list[Recording | None] = [None] * len(cases)
    for group in beside_one_another([case.split for case in cases]):
        if len(group) == 1:
            continue
        first, run = cases[group[0]], partial(_together, [cases[k] for k in group], seed)
        together = run_controller(first.outcome.method, first.split.name, run)
        if not isinstance(together, Failure):
            for arm, k in enumerate(group):
                alone = together.arm(arm)
                found[k] = alone if cases[k].is_measured(alone, seed) else None
    return found


def _together(cases: list[_Case], seed: int) -> Recording:
    """Record the episodes of some cases of one method in a batch."""
    method, count = cases[0].outcome.method, len(cases)
    scenarios = side_by_side([(case.split, slice(case.shown.scenario, case.shown.scenario + 1)) for case in cases])
    controller = method.controller(seed, scenarios.arms(count))
    return rollout(controller, count, sensors=method.sensors, **scenarios.arguments(slice(count)))


def _measured(case: _Case, seed: int) -> Recording:
    """Record the very episode that was measured: alone, or where that is another one, among all scenarios.

    Raises:
        ValueError: If the episode is neither.
    """
    method, split, scenario = case.outcome.method, case.split, case.shown.scenario
    alone = split.run(method.controller(seed, []), scenario)
    if case.is_measured(alone, seed):
        return alone
    costs = case.outcome.metrics["cost"][seed]
    count = len(costs)
    arguments = split.arguments(slice(count))
    again = rollout(method.controller(seed, split.arms(count)), count, sensors=method.sensors, **arguments).arm(
        scenario
    )
    if case.is_measured(again, seed):
        return again
    raise ValueError(f"it cost {costs[scenario]:.9g}, and costs {again.cost[0]:.9g} when run again: it is not drawn")


def record(comparison: Comparison, splits: dict[str, Split]) -> tuple[Traces, list[Failure]]:
    """Record the shown methods on one scenario of each split; also returns failures."""
    names = comparison.splits()
    shown = [Shown(splits[name], shown_scenario(comparison.on(name))) for name in names]
    found, failures = motions(comparison, shown, shown_methods(comparison))
    return {name: recordings for name, recordings in zip(names, found, strict=True) if recordings}, failures
