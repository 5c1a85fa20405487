"""What the comparison found, as data: tables per method and split, and the files written from them."""

from __future__ import annotations

import json
import platform
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from baselines.files import write_atomically, write_text
from baselines.provenance import commit
from beltarm_env import __version__
from beltarm_env.metrics import METRICS as EPISODE_METRICS
from eval import splits
from eval.estimates import Estimate, Paired, estimate, paired
from eval.methods import Method

METRICS = tuple(name for name in EPISODE_METRICS if name not in ("residual_radial_pp_mm", "residual_lateral_pp_mm"))
"""Metrics of `results.json`; `episodes.csv` also has the two parts of the residual vibration."""
_SHARES = ("failure_share", "saturated_share")  # plain means: the middle half of zeros and ones says nothing
PAIRED_METRICS = ("cost", "tip_rms_mm", "residual_pp_mm")


@dataclass(frozen=True, slots=True)
class Outcome:
    """One method on one split."""

    method: Method
    split: str
    metrics: dict[str, NDArray[np.float64]]  # each (seeds, episodes)
    estimates: dict[str, Estimate]
    action_times: tuple[float, float]  # median, 99th percentile [us]

    @property
    def seeds(self) -> int:
        """Number of training seeds; 1 for a classical controller."""
        return len(self.method.controllers)


def make_outcome(
    method: Method, split: str, runs: list[dict[str, NDArray[np.float64]]], action_times: tuple[float, float]
) -> Outcome:
    """Gather the metrics of one method's runs, one per training seed, and estimate them."""
    metrics = {name: np.stack([run[name] for run in runs]) for name in runs[0]}
    estimates = {name: estimate(metrics[name], mean=name in _SHARES) for name in METRICS}
    return Outcome(method, split, metrics, estimates, action_times)


@dataclass(frozen=True, slots=True)
class Comparison:
    """All outcomes of one run."""

    outcomes: list[Outcome]
    against_best: dict[str, dict[str, dict[str, Paired]]]  # by split, method and metric
    provenance: dict[str, Any]

    def on(self, split: str) -> list[Outcome]:
        """Outcomes on one split, in the order of the methods."""
        return [outcome for outcome in self.outcomes if outcome.split == split]

    def splits(self) -> list[str]:
        """Names of the splits, in order."""
        return list(dict.fromkeys(outcome.split for outcome in self.outcomes))

    def best_classical(self, split: str) -> Outcome:
        """The classical method of the lowest cost."""
        return best_classical(self.on(split))


def best_classical(outcomes: list[Outcome]) -> Outcome:
    """The classical method of the lowest cost among the outcomes of one split."""
    classical = [outcome for outcome in outcomes if outcome.method.kind == "classical"]
    return min(classical, key=lambda outcome: outcome.estimates["cost"].iqm)


def against_best_classical(outcomes: list[Outcome]) -> dict[str, dict[str, Paired]]:
    """Every other method of one split against the best classical one, scenario by scenario: by method and metric."""
    best = best_classical(outcomes)
    return {
        outcome.method.name: {name: paired(outcome.metrics[name], best.metrics[name]) for name in PAIRED_METRICS}
        for outcome in outcomes
        if outcome is not best
    }


def provenance(command: str, seconds: float, policies: list[Path]) -> dict[str, Any]:
    """Where the results come from."""
    packages = ("numpy", "numba", "gymnasium", "stable-baselines3", "torch")
    return {
        "command": command,
        "beltarm": __version__,
        "commit": commit(),
        "splits_version": splits.VERSION,
        "split_seeds": {name: split.seed for name, split in splits.SPLITS.items()},
        "policies": [json.loads((path / "policy.json").read_text())["content_hash"] for path in policies],
        "python": platform.python_version(),
        "machine": platform.machine(),
        "packages": {name: version(name) for name in packages},
        "seconds": round(seconds, 1),
    }


def to_json(comparison: Comparison) -> dict[str, Any]:
    """The content of `results.json`."""
    rows = [
        {
            "method": outcome.method.name,
            "kind": outcome.method.kind,
            "split": outcome.split,
            "episodes": outcome.metrics["cost"].shape[1],
            "seeds": outcome.seeds,
            "metrics": {name: asdict(value) for name, value in outcome.estimates.items()},
            "action_us": {"p50": outcome.action_times[0], "p99": outcome.action_times[1]},
            "training": outcome.method.training,
        }
        for outcome in comparison.outcomes
    ]
    against = [
        {
            "method": method,
            "other": comparison.best_classical(split).method.name,
            "split": split,
            "metrics": {
                name: {**asdict(pair.difference), "win_rate": pair.win_rate, "verdict": pair.verdict}
                for name, pair in pairs.items()
            },
        }
        for split in comparison.splits()
        for method, pairs in comparison.against_best[split].items()
    ]
    return {"version": splits.VERSION, "provenance": comparison.provenance, "rows": rows, "paired": against}


def to_episodes(comparison: Comparison) -> pd.DataFrame:
    """One line per method, split, training seed and episode."""
    frames = []
    for outcome in comparison.outcomes:
        for seed in range(outcome.seeds):
            frame = pd.DataFrame({name: values[seed] for name, values in outcome.metrics.items()})
            frame.insert(0, "episode", range(len(frame)))
            frame.insert(0, "seed", seed)
            frame.insert(0, "split", outcome.split)
            frame.insert(0, "method", outcome.method.name)
            frames.append(frame)
    return pd.concat(frames, ignore_index=True)


def write_results(comparison: Comparison, folder: Path) -> None:
    """Write `results.json` and `episodes.csv`, each atomically."""
    write_text(folder / "results.json", json.dumps(to_json(comparison), indent=1) + "\n")
    episodes = to_episodes(comparison)
    write_atomically(folder / "episodes.csv", lambda path: episodes.to_csv(path, index=False, float_format="%.6g"))
