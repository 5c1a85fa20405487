"""Errors of a filter and of learned observers on the same episodes, and whether they know how large these are."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from agents.observer.episodes import Source
from agents.observer.files import SHIPPED, load_observer
from agents.observer.network import Estimate, offered
from agents.observer.quantities import BELIEVED, DOUBTS, NAMES, SCALES, truth
from agents.residual.informed import InformedBase
from agents.residual.knowledge import Knowledge
from beltarm_env.arrays import Flags, Floats, Singles
from beltarm_env.rollout import Controller, rollout
from eval.comparison.splits import Split

HOLD = 4
"""Samples from one estimate that is scored to the next."""
ACTING = ("adaptive", "student")
"""Controllers whose episodes are watched."""


class Watcher(Protocol):
    """What estimates: a learned observer, or the filter in its place."""

    knowledge: Knowledge
    hold: int

    def observe(self, seen: Singles, memory: Any = None, episode_start: Flags | None = None) -> tuple[Estimate, Any]:
        """See `agents.observer.network.Observer.observe`."""
        ...


class FilterAlone:
    """The filter's belief with its own doubts as deviations; NaN where it states none."""

    knowledge: Knowledge = "belief"
    hold = HOLD

    def __init__(self) -> None:
        entries = offered("belief")
        at = {entry.name: k for k, entry in enumerate(entries)}
        self._believed = [at[name] for name in BELIEVED]
        self._doubts = [(k, at[DOUBTS[name]]) for k, name in enumerate(NAMES) if name in DOUBTS]
        self._doubt_units = np.array([entries[k].scale for _, k in self._doubts])

    def observe(self, seen: Singles, memory: Any = None, episode_start: Flags | None = None) -> tuple[Estimate, None]:
        """Belief and doubts; no memory is needed."""
        deviation = np.full((len(seen), len(NAMES)), np.nan)
        deviation[:, [k for k, _ in self._doubts]] = seen[:, [k for _, k in self._doubts]] * self._doubt_units
        return Estimate(seen[:, self._believed].astype(np.float64) * SCALES, deviation), None


def watchers() -> dict[str, Watcher]:
    """All that is compared, by name: the filter, and the shipped observers without and with it."""
    alone, corrected = (load_observer(SHIPPED / f"{name}.safetensors")[0] for name in ("none", "belief"))
    return {"filter": FilterAlone(), "learned alone": alone, "learned on the filter": corrected}


@dataclass(frozen=True)
class Seen:
    """What one watcher came to on one split, by quantity."""

    rms: Floats  # root mean square of its errors, over all samples and arms
    within_one: Floats  # share of the truth within one stated deviation; NaN where none is stated
    within_two: Floats
    arms: int  # that stayed in their workspace


def score(estimates: list[Estimate], true: Floats) -> Seen:
    """Score estimates, one for each row of the truth of shape (T, n, quantities)."""
    mean, deviation = (np.stack(parts) for parts in zip(*estimates, strict=True))
    errors = mean - true
    one, two = (
        np.where(np.isnan(deviation), np.nan, np.abs(errors) <= k * deviation).mean(axis=(0, 1)) for k in (1, 2)
    )
    return Seen(np.sqrt((errors**2).mean(axis=(0, 1))), one, two, true.shape[1])


class _Watched:
    """Controller that notes what watchers estimate every `HOLD` samples; for one rollout."""

    def __init__(self, controller: Controller, known: dict[str, Watcher]) -> None:
        self.informed = InformedBase(controller)
        self.params = self.informed.params
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
                told = seen[:, : len(offered(watcher.knowledge))]  # the belief comes last
                estimate, self._memories[name] = watcher.observe(told, self._memories[name])
                if self._step % HOLD == 0:
                    self.estimates[name].append(estimate)
        self._step += 1
        return informed.action, informed


def measure(name: str, known: dict[str, Watcher], split: Split, episodes: int) -> dict[str, Seen]:
    """Watch a controller on the first scenarios of a split.

    Args:
        name: Of a classical controller, or "student".
        known: What watches, by name; each with an estimate at every `HOLD`-th sample.
        split: Whose arms; those that leave their workspace are not scored.
        episodes: Number of scenarios.

    Raises:
        ValueError: If all arms leave their workspace.
    """
    watched = _Watched(Source(name).controller(), known)
    run = rollout(watched, episodes, **split.arguments(slice(episodes)))
    if not run.finished.any():
        raise ValueError(f"under {name} all arms of {split.name} leave their workspace: nothing to score")
    true = truth(run, HOLD)[:, run.finished]
    kept = {
        watcher: [Estimate(*(part[run.finished] for part in estimate)) for estimate in estimates]
        for watcher, estimates in watched.estimates.items()
    }
    return {watcher: score(estimates, true) for watcher, estimates in kept.items()}


def times_of(known: dict[str, Watcher]) -> dict[str, float]:
    """Median of the time per estimate for one arm [us], by name."""
    times: dict[str, float] = {}
    for name, watcher in known.items():
        seen, memory, seconds = np.zeros((1, len(offered(watcher.knowledge))), np.float32), None, []
        for _ in range(300):
            began = time.perf_counter()
            _, memory = watcher.observe(seen, memory)
            seconds.append(time.perf_counter() - began)
        times[name] = 1e6 * float(np.median(seconds))
    return times
