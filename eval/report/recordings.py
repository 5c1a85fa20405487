"""Recordings of single runs for pictures and animation: the same methods on a few scenarios, as they were measured."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from beltarm_env.rollout import Recording, rollout
from beltarm_env.task.reference import TRAPEZOID, MoveShape, reference_at
from eval.comparison.methods import Method, is_shipped
from eval.comparison.results import Comparison, MethodOutcome
from eval.comparison.rollouts import Failure, calls_side_by_side, run_controller
from eval.comparison.splits import EPISODES, Split, beside_one_another, side_by_side
from eval.report.style import COLOURS

_USUALLY = 5  # methods side by side


@dataclass(frozen=True, slots=True)
class Scene:
    """Scenario with recordings of a few methods."""

    title: str  # why it was chosen
    split: str
    scenario: int
    motions: dict[str, Recording] = field(default_factory=dict)  # by method, each of one arm, and of one of its moves


def record_scenes(
    comparison: Comparison, splits: dict[str, Split], jobs: int | None
) -> tuple[list[Scene], list[Scene], list[Failure]]:
    """Record the scenes of the report, and on each split the first method's scenario of median error; and failures."""
    titles: dict[tuple[str, int], list[str]] = {}
    for title, split, scenario in _notable(comparison):
        titles.setdefault((split, scenario), []).append(title)
    notable = [Scene("; ".join(of_place), *place) for place, of_place in titles.items()]
    first = [comparison.on(split)[0] for split in comparison.splits()]
    traces = [Scene(f"median of {one.name}", one.split, _median(one, "tip_rms_mm")) for one in first]
    recorded, failures = record([*notable, *traces], comparison, splits, _shown(comparison), jobs)
    shown = [scene for scene in recorded[: len(notable)] if scene.motions]
    traced = [scene for scene in recorded[len(notable) :] if scene.motions]
    return shown, traced, failures


def _median(outcome: MethodOutcome, metric: str = "cost") -> int:
    values = outcome.metrics[metric][outcome.median_seed]
    return int(np.argsort(values)[len(values) // 2])


def _shown(comparison: Comparison) -> list[str]:
    """Methods in all pictures: the same in each, so that a colour is one method.

    The best challenger, the user's own, the challenger's base, the first method, the best classical controller of each
    split, and as far as there is room the next challenger and the next classical ones.
    """
    home = comparison.main_split
    ranked = [outcome for outcome in comparison.on(home) if outcome.ranked]
    challengers = comparison.challengers(home)
    bases = [outcome for outcome in ranked if challengers and outcome.name == challengers[0].method.base]
    best = [outcome for split in comparison.splits() if (outcome := comparison.best_classical(split))]
    classical = sorted((o for o in ranked if o.method.kind == "classical"), key=lambda outcome: outcome.cost)
    own = [outcome for outcome in sorted(ranked, key=lambda outcome: outcome.cost) if not is_shipped(outcome.method)]
    needed = dict.fromkeys(outcome.name for outcome in [*challengers[:1], *own, *bases, *ranked[:1], *best])
    wanted = dict.fromkeys([*needed, *(outcome.name for outcome in [*challengers[1:2], *classical])])
    return list(wanted)[: max(_USUALLY, min(len(needed), len(COLOURS)))]


def _notable(comparison: Comparison) -> list[tuple[str, str, int]]:
    """Title, split and scenario of each scene of the report."""
    home = comparison.main_split
    challengers = comparison.challengers(home)
    ranked = [outcome for outcome in comparison.on(home) if outcome.ranked]
    if not ranked:
        return []
    lead = challengers[0] if challengers else comparison.best_classical(home) or ranked[0]
    name = lead.name
    costs = {o.split: o.metrics["cost"][lead.median_seed] for o in comparison.outcomes if o.name == name}
    notable = [(f"the median run of {name}", home, _median(lead))]
    notable.append((f"the worst run of {name} on all splits", *_extreme(costs)))
    best = {split: comparison.best_classical(split) for split in costs}
    losses = {split: costs[split] - b.metrics["cost"][0] for split, b in best.items() if b and b.name != name}
    if losses and challengers:
        for sign, usual, rare in ((1, "loses most to", "gains least on"), (-1, "gains most on", "comes nearest to")):
            split, scenario = _extreme({split: sign * values for split, values in losses.items()})
            title = usual if sign * losses[split][scenario] > 0 else rare
            notable.append((f"where {name} {title} the best classical controller here", split, scenario))
    return notable


def _extreme(values: dict[str, np.ndarray]) -> tuple[str, int]:
    """Split and scenario of the largest value."""
    split = max(values, key=lambda name: float(values[name].max()))
    return split, int(values[split].argmax())


def record(
    scenes: Sequence[Scene], comparison: Comparison, splits: dict[str, Split], names: Sequence[str], jobs: int | None
) -> tuple[list[Scene], list[Failure]]:
    """Record some methods on some scenarios, each by its training seed of median cost on the main split; and failures.

    A drawn run is the run that was measured: a recording whose cost is another one is a failure. Of a shift the last
    move that carries a part is drawn: by then the arm is known.
    """
    calls = {}
    for name in dict.fromkeys(outcome.name for outcome in comparison.outcomes if outcome.name in names):
        outcomes = {outcome.split: outcome for outcome in comparison.outcomes if outcome.name == name}
        first = outcomes.get(comparison.main_split) or next(iter(outcomes.values()))
        runs = {
            k: _run_of(outcomes[scene.split], first.median_seed, splits[scene.split], scene.scenario)
            for k, scene in enumerate(scenes)
            if scene.split in outcomes
        }
        calls[name] = partial(_recorded, runs)
    results = calls_side_by_side("recordings", calls, jobs)
    recorded, failures = [], []
    for k, scene in enumerate(scenes):
        of_scene = {name: of_method[k] for name, of_method in results.items() if k in of_method}
        failures += [run for run in of_scene.values() if isinstance(run, Failure)]
        count = len(splits[scene.split].tables)
        move = loaded(count)
        motions = {name: run.of_move(move) for name, run in of_scene.items() if isinstance(run, Recording)}
        title = f"{scene.title}, move {move + 1} of {count}" if count > 1 else scene.title
        recorded.append(replace(scene, title=title, motions=motions))
    return recorded, failures


def loaded(count: int) -> int:
    """Number of the last move, of so many, that carries a part."""
    return (count - 1) // 2 * 2


class _Run(NamedTuple):
    """A measured run of a controller."""

    method: Method  # of one training seed
    split: Split  # scenarios that were measured in one batch
    number: int  # of the scenario in its whole split
    place: int  # of it in the batch
    costs: np.ndarray  # that were measured in the batch


def _run_of(outcome: MethodOutcome, seed: int, split: Split, scenario: int) -> _Run:
    place = scenario % EPISODES
    batch = slice(scenario - place, scenario - place + EPISODES)
    method = replace(outcome.method, sources=(outcome.method.sources[seed],))
    part = split.part(batch) if len(split.table) > EPISODES else split
    return _Run(method, part, scenario, place, outcome.metrics["cost"][seed, batch])


def _recorded(runs: dict[int, _Run]) -> dict[int, Recording | Failure]:
    """Record runs of a method in as few batches as there are kinds of settings.

    Every shipped method moves an arm in the same way in any batch; a user's own may not, to the last digit, or fail.
    A run that is another one in the batch is recorded among those that it was measured with.
    """
    results: dict[int, Recording | Failure] = {}
    keys = list(runs)
    for group in beside_one_another([run.split for run in runs.values()]):
        batch = [runs[keys[k]] for k in group]
        scenarios = side_by_side([(run.split, slice(run.place, run.place + 1)) for run in batch])
        playing = partial(play, batch[0].method, scenarios, len(batch))
        together = run_controller(batch[0].method, batch[0].split.name, playing)
        for arm, (k, run) in enumerate(zip(group, batch, strict=True)):
            recording = together if isinstance(together, Failure) else together.arm(arm)
            alike = not isinstance(recording, Failure) and _cost(recording) == run.costs[run.place]
            results[keys[k]] = recording if alike else _as_measured(run)
    return results


def play(method: Method, split: Split, count: int) -> Recording:
    """Run the first controller of a method on the first scenarios of a split."""
    return rollout(method.controller(0), count, sensors=method.sensors, **split.arguments(slice(count)))


def _as_measured(run: _Run) -> Recording | Failure:
    """Record a run among those of its batch; a failure where it is not the one that was measured."""
    method, split, where, costs = run.method, run.split, f"on scenario {run.number}", [run.costs[run.place]]
    for _ in range(2):  # results of another machine differ as well, but in the same way each time
        together = run_controller(method, split.name, partial(play, method, split, len(run.costs)), where)
        again = together if isinstance(together, Failure) else together.arm(run.place)
        if isinstance(again, Failure) or _cost(again) == costs[0]:
            return again
        costs.append(_cost(again))
    varies = costs[1] != costs[2]
    why = "it does not repeat" if varies else "its results are of another machine or of other files: give --fresh"
    words = f"{where}: it cost {costs[0]:.9g}, and costs {costs[1]:.9g} when run again: {why}"
    return Failure(method.name, split.name, words, varies=varies)


def _cost(recording: Recording) -> float:
    """Cost of a recording of one arm, averaged over its moves."""
    return float(recording.over_moves(recording.cost)[0])


def reference_angles(recording: Recording) -> np.ndarray:
    """Reference of the joint at each row of a recording of one arm [rad], shape (T,)."""
    move = MoveShape(*map(float, recording.moves[0]))
    return np.array([reference_at(TRAPEZOID, move, float(time)).angle for time in recording.time])
