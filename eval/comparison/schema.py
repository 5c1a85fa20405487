"""`results.json` and `episodes.csv`: what is in them, how they are written, and how a file is checked.

`results.json` is an object of

- `version`: of the scenarios. Results of different versions must not be compared or merged.
- `provenance`: command, commit, seeds and SHA-256 of the splits, content hashes of the policies, packages, machine.
- `rows`, one per method and split: `method`; `kind`, "classical", "learned", "added" (a user's own) or "privileged"
  (sees what no other does, never ranked); `split`; `episodes`; `seeds`; `metrics`, by name an interquartile mean `iqm`
  (of shares: a plain mean) with its 95 % interval, `low` to `high`; `failures`, in how many of all `runs` the tip did
  not settle and the arm left its workspace; `action_us`, time per action; `training`, simulator steps and wall-clock of
  tuning or training, per seed (empty: neither).
- `paired`, one per comparison on the same scenarios: `method`, `other`, `against` ("best classical" or "base"),
  `split`, and by metric the difference `iqm`, `low`, `high`, the `win_rate` (probability of improvement, `win_rate_low`
  to `win_rate_high`), `p` and, after Holm's correction within split and metric, `p_holm`, and a `verdict`.
- `profiles`, one per split and metric: `thresholds`, and by method the share of runs at or below each.
- `failures`, one per method and split that could not be run to the end, with its `message`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd

from baselines.tools.files import write_atomically, write_text
from eval.comparison import splits
from eval.comparison.estimates import Paired
from eval.comparison.results import PAIRED_METRICS, Against, Comparison, MethodOutcome, profiles
from eval.style.metrics import REPORTED_METRICS

KINDS = ("classical", "learned", "privileged", "added")
AGAINST = ("best classical", "base")


def to_json(comparison: Comparison) -> dict[str, Any]:
    """The content of `results.json`."""
    best = {name: outcome.method.name for name in comparison.splits() if (outcome := comparison.best_classical(name))}
    base = {outcome.method.name: outcome.method.base for outcome in comparison.outcomes}
    return {
        "version": splits.VERSION,
        "provenance": comparison.provenance,
        "rows": [result_row(outcome) for outcome in comparison.outcomes],
        "paired": [
            *_paired_rows(comparison.against_best, AGAINST[0], lambda split, _: best[split]),
            *_paired_rows(comparison.against_base, AGAINST[1], lambda _, method: base[method]),
        ],
        "profiles": [
            _profile_row(comparison, split, metric) for split in comparison.splits() for metric in PAIRED_METRICS
        ],
        "failures": [asdict(failure) for failure in comparison.failures],
    }


def result_row(outcome: MethodOutcome) -> dict[str, Any]:
    """Row of `results.json`."""
    return {
        "method": outcome.method.name,
        "kind": outcome.method.kind,
        "split": outcome.split,
        "episodes": outcome.metrics["cost"].shape[1],
        "seeds": outcome.seeds,
        "metrics": {name: asdict(value) for name, value in outcome.estimates.items()},
        "failures": outcome.failures,
        "action_us": {"p50": outcome.action_times[0], "p99": outcome.action_times[1]},
        "training": outcome.method.training,
    }


def _paired_rows(against: Against, word: str, other_of: Any) -> list[dict[str, Any]]:
    return [
        {
            "method": method,
            "other": other_of(split, method),
            "against": word,
            "split": split,
            "metrics": {name: _pair(pair) for name, pair in pairs.items()},
        }
        for split, methods in against.items()
        for method, pairs in methods.items()
    ]


def _pair(pair: Paired) -> dict[str, Any]:
    wins = pair.win_rate
    rates = {"win_rate": wins.iqm, "win_rate_low": wins.low, "win_rate_high": wins.high}
    return {**asdict(pair.difference), **rates, "p": pair.p, "p_holm": pair.p_holm, "verdict": pair.verdict}


def _profile_row(comparison: Comparison, split: str, metric: str) -> dict[str, Any]:
    found = profiles(comparison.on(split), metric)
    shares = {name: [round(float(share), 4) for share in values] for name, values in found.shares.items()}
    return {"split": split, "metric": metric, "thresholds": found.thresholds.tolist(), "methods": shares}


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
    content = to_json(comparison)
    check(content, "results.json")
    write_text(folder / "results.json", json.dumps(content, indent=1) + "\n")
    episodes = to_episodes(comparison)
    write_atomically(folder / "episodes.csv", lambda path: episodes.to_csv(path, index=False, float_format="%.6g"))


_ESTIMATE = {"iqm": float, "low": float, "high": float}
_PAIR = {**_ESTIMATE, "win_rate": float, "win_rate_low": float, "win_rate_high": float}
_PAIR |= {"p": float, "p_holm": float, "verdict": str}
_SCHEMA: dict[str, Any] = {
    "version": int,
    "provenance": {
        "command": str,
        "commit": str,
        "splits_version": int,
        "split_seeds": {},
        "seconds": float,
        "pairs_kept_before": int,
    },
    "rows": [
        {
            "method": str,
            "kind": KINDS,
            "split": str,
            "episodes": int,
            "seeds": int,
            "metrics": dict.fromkeys(REPORTED_METRICS, _ESTIMATE),
            "failures": {"runs": int, "not_settled": int, "left_workspace": int},
            "action_us": {"p50": float, "p99": float},
            "training": {},
        }
    ],
    "paired": [
        {
            "method": str,
            "other": str,
            "against": AGAINST,
            "split": str,
            "metrics": dict.fromkeys(PAIRED_METRICS, _PAIR),
        }
    ],
    "profiles": [{"split": str, "metric": str, "thresholds": [float], "methods": {}}],
    "failures": [{"method": str, "split": str, "message": str}],
}


def check(content: object, where: str) -> None:
    """Check the content of a `results.json`.

    Raises:
        ValueError: Naming the first place that is not as the docstring above says, and what is there.
    """
    _check(content, _SCHEMA, where)


def _check(value: Any, wanted: Any, where: str) -> None:
    if isinstance(wanted, dict):
        _require(isinstance(value, Mapping), where, "an object", value)
        for key, inner in wanted.items():
            _require(key in value, f"{where}: {key}", "there", "nothing")
            _check(value[key], inner, f"{where}: {key}")
    elif isinstance(wanted, list):
        _require(isinstance(value, list), where, "a list", value)
        for k, item in enumerate(value):
            _check(item, wanted[0], f"{where}[{k}]")
    elif isinstance(wanted, tuple):
        _require(value in wanted, where, f"one of {', '.join(wanted)}", value)
    elif wanted is float:
        number = isinstance(value, int | float) and not isinstance(value, bool)
        _require(number and math.isfinite(value), where, "a finite number", value)
    else:
        _require(isinstance(value, wanted) and not isinstance(value, bool), where, f"of type {wanted.__name__}", value)


def _require(fulfilled: bool, where: str, wanted: str, value: object) -> None:
    if not fulfilled:
        raise ValueError(f"{where} must be {wanted}, got {str(value)[:80]!r}")


def read_results(path: Path) -> dict[str, Any]:
    """The content of a `results.json`, checked.

    Raises:
        ValueError: If it is damaged, or of another version of the scenarios.
    """
    require_same_version(path)
    content = json.loads(path.read_text(encoding="utf-8"))
    check(content, str(path))
    return content


def require_same_version(path: Path) -> None:
    """Check that a `results.json` is of this version of the scenarios.

    Raises:
        ValueError: If it is of another version, or cannot be read.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))["version"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{path} cannot be read ({error}): remove it, or choose another folder") from None
    if found != splits.VERSION:
        raise ValueError(
            f"{path} has results of version {found} of the scenarios, this checkout has {splits.VERSION}; they cannot "
            "be merged: remove it, or choose another folder"
        )
