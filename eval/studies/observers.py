"""How well a Kalman filter and learned observers estimate what the encoder does not show.

All of them watch the same episodes of the development set; none of them acts.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from agents.observer import network
from agents.observer.network import Estimate, Observer
from agents.observer.quantities import DOUBTS, NAMES, QUANTITIES, believed, truth
from agents.observer.run import Source
from agents.residual.knowledge import InformedBase, Knowledge, offered
from baselines.tools.progress import progress_over
from beltarm_env.arrays import Flags, Floats, Singles
from beltarm_env.rollout import Controller, rollout
from eval.comparison.methods import chosen
from eval.comparison.sets import development_set
from eval.comparison.splits import Split, main_split
from eval.report.style import BLUE, GREEN, ORANGE, below, name_rows
from eval.studies._frame import DevelopmentOptions as Options
from eval.studies._frame import Pictures

QUICK = {"episodes": 4, "splits": ("randomized",)}
HOLD = 4
"""Samples from one estimate that is scored to the next."""
ACTING = ("adaptive", "student")
"""Controllers whose episodes are watched; the tables of one controller are those of the last."""
_SHOWN_AS = {"rad": (1e3, "mrad"), "rad/s": (1.0, "rad/s"), "m": (1e3, "mm"), "m/s": (1e3, "mm/s"), "ln": (100, "%")}
"""Factor and unit in which a quantity's error is shown; the error of a logarithm is about a share."""


class FilterAlone:
    """The filter in an observer's place: its belief, with its own doubts as deviations; NaN where it states none."""

    knowledge: Knowledge = "belief"
    hold = HOLD

    def __init__(self) -> None:
        entries = offered("belief")
        at = {entry.name: k for k, entry in enumerate(entries)}
        self._doubts = [(k, at[DOUBTS[name]]) for k, name in enumerate(NAMES) if name in DOUBTS]
        self._doubt_units = np.array([entries[k].scale for _, k in self._doubts])

    def observe(self, seen: Singles, memory: Any = None, episode_start: Flags | None = None) -> tuple[Estimate, None]:
        """Belief and doubts; no memory is needed."""
        deviation = np.full((len(seen), len(NAMES)), np.nan)
        deviation[:, [k for k, _ in self._doubts]] = seen[:, [k for _, k in self._doubts]] * self._doubt_units
        return Estimate(believed(seen), deviation), None


Watcher = Observer | FilterAlone


@dataclass(frozen=True)
class Score:
    """Result of one watcher on one split; arrays by quantity."""

    rms: Floats  # root mean square of its errors, over all samples and arms
    within_one: Floats  # share of the truth within one stated deviation; NaN where none is stated
    within_two: Floats
    arms: int  # arms that stayed in their workspace


def measure(options: Options) -> dict[str, Any]:
    """Scores of all watchers on every split under every acting controller."""
    scenarios, known = development_set(), watchers()
    splits = chosen("split", options.splits, scenarios.splits)
    rows = [
        {"acting": acting, "split": split, "watcher": name, **asdict(score)}
        for acting, split in progress_over("splits", [(acting, split) for acting in ACTING for split in splits])
        for name, score in scores_of(acting, known, scenarios.splits[split], options.episodes).items()
    ]
    return {
        "note": scenarios.label.note,
        "splits": splits,
        "episodes": options.episodes,
        "acting": ACTING,
        "watchers": list(known),
        "hold": HOLD,
        "quantities": [{"name": quantity.name, "unit": quantity.unit} for quantity in QUANTITIES],
        "sizes": [
            {
                "observer": name,
                "weights": sum(parameter.numel() for parameter in watcher.parameters()),
                "products": (len(watcher.columns) + watcher.width) * (3 * watcher.width + 2 * len(NAMES)),
                "hold": watcher.hold,
            }
            for name, watcher in known.items()
            if isinstance(watcher, Observer)
        ],
        "rows": rows,
    }


def watchers() -> dict[str, Watcher]:
    """All watchers by name: the filter, and the shipped observers without and with it."""
    alone, corrected = (
        network.load_observer(network.SHIPPED / f"{name}.safetensors")[0] for name in ("none", "belief")
    )
    return {"filter": FilterAlone(), "learned alone": alone, "learned on the filter": corrected}


def score(estimates: Sequence[Estimate], true: Floats) -> Score:
    """Score estimates, one for each row of the truth of shape (T, n, quantities)."""
    mean, deviation = (np.stack(parts) for parts in zip(*estimates, strict=True))
    errors = mean - true
    one, two = (
        np.where(np.isnan(deviation), np.nan, np.abs(errors) <= k * deviation).mean(axis=(0, 1)) for k in (1, 2)
    )
    return Score(np.sqrt((errors**2).mean(axis=(0, 1))), one, two, true.shape[1])


class _Watched:
    """Controller that keeps the watchers' estimates of every `HOLD`-th sample; for one rollout."""

    def __init__(self, controller: Controller, known: Mapping[str, Watcher]) -> None:
        self.informed = InformedBase(controller)
        self.params, self.profile = self.informed.params, self.informed.profile
        self.estimates: dict[str, list[Estimate]] = {name: [] for name in known}
        self._known = known
        self._memories: dict[str, Any] = dict.fromkeys(known)
        self._step = 0

    def predict(
        self, observation: Singles, state: Any = None, episode_start: Flags | None = None, deterministic: bool = True
    ) -> tuple[Singles, Any]:
        """Call the controller's `predict`, and ask every watcher when its estimate is due."""
        informed = self.informed.advance(observation, state, episode_start)
        seen = self.informed.seen(observation, informed)
        for name, watcher in self._known.items():
            if self._step % watcher.hold == 0:
                entries = seen[:, : len(offered(watcher.knowledge))]  # the belief comes last
                estimate, self._memories[name] = watcher.observe(entries, self._memories[name])
                if self._step % HOLD == 0:
                    self.estimates[name].append(estimate)
        self._step += 1
        return informed.action, informed


def scores_of(acting: str, known: Mapping[str, Watcher], split: Split, episodes: int) -> dict[str, Score]:
    """Watch a controller on the first scenarios of a split; arms that leave their workspace are not scored.

    Every watcher in `known` has an estimate at every `HOLD`-th sample.

    Raises:
        ValueError: If all arms leave their workspace.
    """
    watched = _Watched(Source(acting).controller(), known)
    run = rollout(watched, episodes, **split.arguments(slice(episodes)))
    stayed = run.stayed
    if not stayed.any():
        raise ValueError(f"under {acting} all arms of {split.name} leave their workspace: nothing to score")
    true = truth(run, HOLD)[:, stayed]
    return {
        name: score([Estimate(*(part[stayed] for part in estimate)) for estimate in estimates], true)
        for name, estimates in watched.estimates.items()
    }


def tables(data: dict[str, Any]) -> dict[str, Any]:
    """Scores by acting controller, split and watcher, and names for the sentences."""
    left = {(row["acting"], row["split"]): data["episodes"] - row["arms"] for row in data["rows"]}
    return {
        "acting": data["acting"][-1],
        "main": main_split(data["splits"]),
        "left": [(*pair, count) for pair, count in left.items() if count],
        "scores": {(row["acting"], row["split"], row["watcher"]): row for row in data["rows"]},
        "torsion": _torsion(data),
        "shown_as": _SHOWN_AS,
    }


def _torsion(data: dict[str, Any]) -> int:
    return [quantity["name"] for quantity in data["quantities"]].index("torsion")


def pictures(data: dict[str, Any]) -> Pictures:
    """Error of the torsion on every split under the last acting controller."""
    return {"torsion.png": lambda: _draw(data)}


def _draw(data: dict[str, Any]) -> Figure:
    splits, acting, torsion = data["splits"], data["acting"][-1], _torsion(data)
    errors = {
        (row["split"], row["watcher"]): 1e3 * row["rms"][torsion] for row in data["rows"] if row["acting"] == acting
    }
    figure, axis = plt.subplots(figsize=(8.5, 0.52 * len(splits) + 1.7), layout="constrained")
    for k, (name, colour) in enumerate(zip(data["watchers"], (BLUE, GREEN, ORANGE), strict=True)):
        places = np.arange(len(splits)) + 0.26 * (k - 1)
        bars = axis.barh(places, [errors[split, name] for split in splits], 0.24, color=colour, label=name)
        axis.bar_label(bars, fmt="%.2f", padding=4, fontsize=8)
    name_rows(axis, splits)
    axis.set_xlabel(f"error of the torsion under {acting}, RMS (mrad)")
    below(figure, axis, len(data["watchers"]))
    return figure
