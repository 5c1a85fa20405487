"""Recordings of single runs for pictures and animation: the same methods on a few scenarios, as they were measured."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from beltarm_env.rollout import Recording, rollout
from beltarm_env.task.reference import TRAPEZOID, MoveShape, reference_at
from eval.comparison.failures import Failure, run_controller
from eval.comparison.results import Comparison, MethodOutcome
from eval.comparison.splits import EPISODES, Split, beside_one_another, side_by_side
from eval.report.style import COLOURS

_USUALLY = 5  # methods side by side
Traces = dict[str, dict[str, Recording]]
"""Per split and method a recording of one arm, on the same scenario for all methods."""


@dataclass(frozen=True, slots=True)
class Scene:
    """Scenario with recordings of a few methods."""

    title: str  # why it was chosen
    split: str
    scenario: int
    motions: dict[str, Recording]  # each of one arm


def record_traces(comparison: Comparison, splits: dict[str, Split]) -> tuple[Traces, list[Failure]]:
    """Record methods on the scenario of each split in which the first method has its median error; and failures."""
    names = comparison.splits()
    shown = [(splits[name], _median(comparison.on(name)[0].metrics["tip_rms_mm"][0])) for name in names]
    recorded, failures = motions(comparison, shown, _traced(comparison))
    return {name: of_split for name, of_split in zip(names, recorded, strict=True) if of_split}, failures


def record_scenes(comparison: Comparison, splits: dict[str, Split]) -> tuple[list[Scene], list[Failure]]:
    """Record the scenes of the report: median, worst, largest loss and gain; also returns failures."""
    titles: dict[tuple[str, int], str] = {}
    for title, split, scenario in _notable(comparison):
        before = titles.get((split, scenario))
        titles[split, scenario] = f"{before}; {title}" if before else title
    names = _compared(comparison, [split for split, _ in titles])
    recorded, failures = motions(comparison, [(splits[split], scenario) for split, scenario in titles], names)
    scenes = [
        Scene(title, split, scenario, of_scene)
        for ((split, scenario), title), of_scene in zip(titles.items(), recorded, strict=True)
        if of_scene
    ]
    return scenes, failures


def _median(values: np.ndarray) -> int:
    return int(np.argsort(values)[len(values) // 2])


def _traced(comparison: Comparison) -> list[str]:
    """Methods of the traces: the first, the best learned and added ones, and the best others by cost."""
    on_main = comparison.on(comparison.main_split)
    outcomes = [outcome for outcome in on_main if outcome.ranked] or on_main
    by_cost = sorted(outcomes[1:], key=_cost)
    challengers = [outcome for outcome in by_cost if outcome.method.kind in ("learned", "added")]
    classical = [outcome for outcome in by_cost if outcome.method.kind == "classical"]
    kept = [outcomes[0], *challengers[:3], *classical][: len(COLOURS) - 2]
    return [outcome.method.name for outcome in outcomes if outcome in kept]


def _cost(outcome: MethodOutcome) -> float:
    return outcome.estimates["cost"].iqm


def _compared(comparison: Comparison, splits: list[str]) -> list[str]:
    """Methods in all scenes: the same in each, so that a colour is one method.

    The best challenger, the best classical controller of each split, the challenger's base or else the first method,
    and as far as there is room the next challenger and the next classical ones.
    """
    home = comparison.main_split
    ranked = [outcome for outcome in comparison.on(home) if outcome.ranked]
    challengers = comparison.challengers(home)
    bases = [outcome for outcome in ranked if challengers and outcome.method.name == challengers[0].method.base]
    best = [outcome for split in splits if (outcome := comparison.best_classical(split))]
    by_cost = sorted((outcome for outcome in ranked if outcome.method.kind == "classical"), key=_cost)
    needed = dict.fromkeys(outcome.method.name for outcome in [*challengers[:1], *best, *(bases or ranked[:1])])
    wanted = dict.fromkeys([*needed, *(outcome.method.name for outcome in [*challengers[1:2], *by_cost])])
    return list(wanted)[: max(_USUALLY, min(len(needed), len(COLOURS)))]


def _notable(comparison: Comparison) -> list[tuple[str, str, int]]:
    """Title, split and scenario of each scene."""
    home = comparison.main_split
    challengers = comparison.challengers(home)
    ranked = [outcome for outcome in comparison.on(home) if outcome.ranked]
    if not ranked:
        return []
    lead = challengers[0] if challengers else comparison.best_classical(home) or ranked[0]
    name = lead.method.name
    seed = _shown_seed(comparison, name)
    costs = {o.split: o.metrics["cost"][seed] for o in comparison.outcomes if o.method.name == name}
    notable = [(f"the median run of {name}", home, _median(costs[home]))]
    notable.append((f"the worst run of {name} on all splits", *_extreme(costs)))
    best = {split: comparison.best_classical(split) for split in costs}
    losses = {split: costs[split] - b.metrics["cost"][0] for split, b in best.items() if b and b.method.name != name}
    if losses and challengers:
        notable.append((f"where {name} loses most to the best classical controller", *_extreme(losses)))
        wins = {split: -values for split, values in losses.items()}
        split, scenario = _extreme(wins)
        title = "gains most on" if wins[split][scenario] > 0 else "comes nearest to"
        notable.append((f"where {name} {title} the best classical controller", split, scenario))
    return notable


def _extreme(values: dict[str, np.ndarray]) -> tuple[str, int]:
    """Split and scenario of the largest value."""
    split = max(values, key=lambda name: float(values[name].max()))
    return split, int(values[split].argmax())


def _shown_seed(comparison: Comparison, method: str) -> int:
    """Training seed that represents a method: that of median cost on the main split."""
    outcomes = {outcome.split: outcome for outcome in comparison.outcomes if outcome.method.name == method}
    return (outcomes.get(comparison.main_split) or next(iter(outcomes.values()))).median_seed


def motions(
    comparison: Comparison, shown: Sequence[tuple[Split, int]], names: Collection[str]
) -> tuple[list[dict[str, Recording]], list[Failure]]:
    """Record some methods on some scenarios; also returns failures.

    What is drawn is what was measured: a recording whose cost is another one is a failure.

    Returns:
        For each scenario, in order, a recording of one arm by method; and failures.
    """
    recorded: list[dict[str, Recording]] = [{} for _ in shown]
    failures = []
    for method in dict.fromkeys(outcome.method.name for outcome in comparison.outcomes):
        if method not in names:
            continue
        seed = _shown_seed(comparison, method)
        outcomes = {outcome.split: outcome for outcome in comparison.outcomes if outcome.method.name == method}
        cases = {k: _Case(outcomes[on.name], on, at, seed) for k, (on, at) in enumerate(shown) if on.name in outcomes}
        together = _side_by_side(list(cases.values()))
        for (k, case), recording in zip(cases.items(), together, strict=True):
            result = case.by_itself() if recording is None else recording
            if isinstance(result, Failure):
                failures.append(result)
            else:
                recorded[k][method] = result
    return recorded, failures


@dataclass(frozen=True)
class _Case:
    """A training seed of a method on a scenario."""

    outcome: MethodOutcome
    split: Split
    scenario: int
    seed: int

    @property
    def cost(self) -> float:
        """Cost of the episode that was measured."""
        return self.outcome.metrics["cost"][self.seed, self.scenario]

    def by_itself(self) -> Recording | Failure:
        """Record the episode."""
        where = f"on scenario {self.scenario}"
        return run_controller(self.outcome.method, self.split.name, partial(_measured, self), where)


def _side_by_side(cases: list[_Case]) -> list[Recording | None]:
    """Record episodes of a method in as few batches as there are kinds of settings; None for another than was measured.

    Every shipped method moves an arm in the same way in any batch; a user's own may not, to the last digit, or fail.
    """
    recorded: list[Recording | None] = [None] * len(cases)
    for group in beside_one_another([case.split for case in cases]):
        if len(group) == 1:
            continue
        first, run = cases[group[0]], partial(_together, [cases[k] for k in group])
        together = run_controller(first.outcome.method, first.split.name, run)
        if not isinstance(together, Failure):
            for arm, k in enumerate(group):
                alone = together.arm(arm)
                recorded[k] = alone if alone.cost[0] == cases[k].cost else None
    return recorded


def _together(cases: list[_Case]) -> Recording:
    """Record the episodes of some cases of one method in a batch."""
    scenarios = side_by_side([(case.split, slice(case.scenario, case.scenario + 1)) for case in cases])
    return _run(cases[0], scenarios, slice(len(cases)))


def _run(case: _Case, split: Split, chosen: slice) -> Recording:
    method, count = case.outcome.method, chosen.stop - (chosen.start or 0)
    return rollout(method.controller(case.seed, []), count, sensors=method.sensors, **split.arguments(chosen))


def _measured(case: _Case) -> Recording:
    """Record the very episode that was measured: alone, or where that is another one, among those of its part.

    Raises:
        ValueError: If the episode is neither.
    """
    alone = case.split.run(case.outcome.method.controller(case.seed, []), case.scenario)
    if alone.cost[0] == case.cost:
        return alone
    first = EPISODES * (case.scenario // EPISODES)
    part = slice(first, min(first + EPISODES, case.outcome.metrics["cost"].shape[1]))
    again = _run(case, case.split, part).arm(case.scenario - first)
    if again.cost[0] == case.cost:
        return again
    raise ValueError(f"it cost {case.cost:.9g}, and costs {again.cost[0]:.9g} when run again: it is not drawn")


def reference_angles(recording: Recording) -> np.ndarray:
    """Reference of the joint at each row of a recording of one arm [rad], shape (T,)."""
    move = MoveShape(*map(float, recording.moves[0]))
    return np.array([reference_at(TRAPEZOID, move, float(time)).angle for time in recording.time])
