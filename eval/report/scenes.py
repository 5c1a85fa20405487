"""Notable scenarios (median, worst, largest loss and gain) and recordings of a few methods in them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from beltarm_env.rollout import Recording
from eval.comparison.failures import Failure
from eval.comparison.results import Comparison
from eval.comparison.splits import Split
from eval.report.style import COLOURS
from eval.report.traces import Shown, motions, shown_seed

_USUALLY = 5  # methods side by side


@dataclass(frozen=True, slots=True)
class Scene:
    """Scenario with recordings of a few methods."""

    title: str  # why it was chosen
    split: str
    scenario: int
    motions: dict[str, Recording]  # each of one arm


@dataclass(frozen=True, slots=True)
class Map:
    """Cost of a challenger over that of a classical controller, for arms in a grid of two properties."""

    x_label: str
    y_label: str
    x: list[float]
    y: list[float]
    ratio: list[list[float]]  # of interquartile means, rows as y
    means: list[list[float]]  # of the means of all runs
    challenger: str
    classical: str
    arms: int  # per cell
    seed: int


@dataclass(frozen=True, slots=True)
class Recordings:
    """Simulations that only the report needs."""

    scenes: list[Scene]
    maps: list[Map] = field(default_factory=list)


def record_scenes(comparison: Comparison, splits: dict[str, Split]) -> tuple[list[Scene], list[Failure]]:
    """Record the scenes of the report; also returns failures."""
    chosen: dict[tuple[str, int], str] = {}
    for title, split, scenario in _chosen(comparison):
        before = chosen.get((split, scenario))
        chosen[split, scenario] = f"{before}; {title}" if before else title
    names = _shown(comparison, [split for split, _ in chosen])
    shown = [Shown(splits[split], scenario) for split, scenario in chosen]
    found, failures = motions(comparison, shown, names)
    scenes = [
        Scene(title, split, scenario, recordings)
        for ((split, scenario), title), recordings in zip(chosen.items(), found, strict=True)
        if recordings
    ]
    return scenes, failures


def _shown(comparison: Comparison, splits: list[str]) -> list[str]:
    """Methods in all scenes: the same in each, so that a colour is one method.

    The best challenger, the best classical controller of each split, what the challenger corrects or else the first
    method, and as far as there is room the next challenger and the next classical ones.
    """
    home = comparison.main_split
    ranked = [outcome for outcome in comparison.on(home) if outcome.ranked]
    rivals = comparison.challengers(home)
    bases = [outcome for outcome in ranked if rivals and outcome.method.name == rivals[0].method.base]
    best = [found for split in splits if (found := comparison.best_classical(split))]
    classical = [outcome for outcome in ranked if outcome.method.kind == "classical"]
    by_cost = sorted(classical, key=lambda outcome: outcome.estimates["cost"].iqm)
    needed = dict.fromkeys(outcome.method.name for outcome in [*rivals[:1], *best, *(bases or ranked[:1])])
    wanted = dict.fromkeys([*needed, *(outcome.method.name for outcome in [*rivals[1:2], *by_cost])])
    return list(wanted)[: max(_USUALLY, min(len(needed), len(COLOURS)))]


def _chosen(comparison: Comparison) -> list[tuple[str, str, int]]:
    """Title, split and scenario of each scene."""
    home = comparison.main_split
    rivals = comparison.challengers(home)
    ranked = [outcome for outcome in comparison.on(home) if outcome.ranked]
    if not ranked:
        return []
    lead = rivals[0] if rivals else comparison.best_classical(home) or ranked[0]
    name = lead.method.name
    costs = _of(comparison, name)[home]
    chosen = [(f"the median run of {name}", home, int(np.argsort(costs)[len(costs) // 2]))]
    chosen.append((f"the worst run of {name} on all splits", *_extreme(_of(comparison, name))))
    losses = {}
    for split, values in _of(comparison, name).items():
        best = comparison.best_classical(split)
        if best and best is not lead:
            losses[split] = values - best.metrics["cost"][0]
    if losses and rivals:
        chosen.append((f"where {name} loses most to the best classical controller", *_extreme(losses)))
        wins = {split: -values for split, values in losses.items()}
        split, scenario = _extreme(wins)
        title = "gains most on" if wins[split][scenario] > 0 else "comes nearest to"
        chosen.append((f"where {name} {title} the best classical controller", split, scenario))
    return chosen


def _of(comparison: Comparison, name: str) -> dict[str, np.ndarray]:
    """Costs of a method by split, of the training seed that is shown."""
    seed = shown_seed(comparison, name)
    return {o.split: o.metrics["cost"][seed] for o in comparison.outcomes if o.method.name == name}


def _extreme(values: dict[str, np.ndarray]) -> tuple[str, int]:
    """Split and scenario of the largest value."""
    split = max(values, key=lambda name: float(values[name].max()))
    return split, int(values[split].argmax())
