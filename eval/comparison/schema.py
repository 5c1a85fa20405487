"""Content, writing, reading and checking of `results.json` and `episodes.csv`.

`results.json` is an object of

- `edition`: of the comparison, the kinds of arms that it asks about; `version`: of the scenarios; `scenario_set`: its
  `name`, "development" (controllers and agents may be chosen on it), "test" or "seed N" (drawn afresh), and `sha256`.
  Results that differ in any of them must not be compared or merged.
- `provenance`: command, commit, seeds and SHA-256 of the splits, content hashes of the policies, packages, machine.
- `verdict`: sentences, made from these numbers.
- `primary`, one per metric and split of the primary comparison: `challenger` and `classical`; the `result`, "better",
  "worse" or "open" (no difference shown); the difference of interquartile means `iqm`, `low`, `high`, its share
  `relative` of the classical controller's value, and `p_holm` after Holm's correction over the splits; the `mean`
  difference, `mean_low` to `mean_high`. Not there in older files.
- `rows`, one per method and split: `method`; `kind`, "classical", "learned", "added" (a user's own) or "privileged"
  (an oracle, which sees what no other does, never ranked); `split`; `episodes`; `seeds`; `median_seed`, the training
  seed of median cost; `metrics`, by name an interquartile mean `iqm` (of shares: a plain mean) with its 95 % interval,
  `low` to `high`, those of `beltarm_env.metrics.OF_ARRIVED` over the scenarios in which all training seeds arrive, and
  not there where these are none; `cost_mean`, and `cost_worst`, the mean of the worst 5 %, where there are scenarios
  enough; `marks`, by metric "best" or "tie"; `failures`, in how many of all `runs` the tip did not settle and the arm
  left its workspace; `action_us`, time per action; `training`, effort of tuning or training, see
  `eval.comparison.methods.EFFORT`.
- `paired`, one per comparison on the same scenarios: `method`, `other`, `against` ("best classical" or "base"),
  `split`, and by metric the difference `iqm`, `low`, `high`, the `win_rate` (probability of improvement, `win_rate_low`
  to `win_rate_high`), `p` and, after Holm's correction within split and metric, `p_holm`, a `verdict`, and the number
  of `scenarios` that it is of. A metric is not there where both methods arrive in no two scenarios.
- `failures`, one per method and split that could not be run to the end, with its `message`.

Older files have more: performance profiles, sensitivities, latencies that stood for computing time. They are read.
Numbers are finite: NaN and infinities are refused as they are written and as they are read.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from math import isfinite
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pandas as pd

from baselines.tools.files import read_text, write_atomically, write_text
from baselines.tools.schema import INTEGER, NUMBER, TEXT, in_a_line, list_of, loads, mapping_of, object_of
from baselines.tools.schema import check as check_by
from beltarm_env.metrics import NOT_ARRIVED, OF_ARRIVED, SHOWN
from eval.comparison import splits
from eval.comparison.methods import Kind
from eval.comparison.results import PAIRED_METRICS, Against, Comparison, Mark, MethodOutcome
from eval.comparison.sets import SetLabel
from eval.comparison.statistics import Paired, tail_mean

_REMEDY = "they cannot be merged: remove it, or choose another folder"
AGAINST = ("best classical", "base")
"""Opponents of paired comparisons."""


def to_json(
    comparison: Comparison, verdict: Sequence[str] = (), primary: Sequence[dict[str, Any]] = ()
) -> dict[str, Any]:
    """Content of `results.json`, with a verdict in words and its pairwise tests."""
    best = {name: outcome.method.name for name in comparison.splits() if (outcome := comparison.best_classical(name))}
    base = {outcome.method.name: outcome.method.base for outcome in comparison.outcomes}
    return {
        "edition": splits.EDITION,
        "version": splits.VERSION,
        "scenario_set": comparison.scenario_set._asdict(),
        "provenance": comparison.provenance,
        "verdict": list(verdict),
        "primary": list(primary),
        "rows": [_row(outcome, comparison.marks[outcome.split]) for outcome in comparison.outcomes],
        "paired": [
            *_paired_rows(comparison.against_best, AGAINST[0], lambda split, _: best[split]),
            *_paired_rows(comparison.against_base, AGAINST[1], lambda _, method: base[method]),
        ],
        "failures": [{"method": f.method, "split": f.split, "message": f.message} for f in comparison.failures],
    }


def _row(outcome: MethodOutcome, marks: dict[str, dict[str, Mark]]) -> dict[str, Any]:
    name, costs = outcome.method.name, outcome.metrics["cost"]
    worst = tail_mean(costs)
    return {
        "method": name,
        "kind": outcome.method.kind,
        "split": outcome.split,
        "episodes": costs.shape[1],
        "seeds": outcome.seeds,
        "median_seed": outcome.median_seed,
        "metrics": {metric: asdict(value) for metric, value in outcome.estimates.items() if isfinite(value.iqm)},
        "cost_mean": float(costs.mean()),
        **({"cost_worst": worst} if isfinite(worst) else {}),
        "marks": {metric: of_metric[name] for metric, of_metric in marks.items() if name in of_metric},
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
            "metrics": {name: _pair(pair) for name, pair in pairs.items() if isfinite(pair.difference.iqm)},
        }
        for split, methods in against.items()
        for method, pairs in methods.items()
    ]


def _pair(pair: Paired) -> dict[str, Any]:
    wins = pair.win_rate
    rates = {"win_rate": wins.iqm, "win_rate_low": wins.low, "win_rate_high": wins.high}
    tests = {"p": pair.p, "p_holm": pair.p_holm, "verdict": pair.verdict, "scenarios": pair.scenarios}
    return {**asdict(pair.difference), **rates, **tests}


def to_episodes(comparison: Comparison) -> pd.DataFrame:
    """Content of `episodes.csv`: a line per method, split, training seed and episode."""
    frames = []
    for outcome in comparison.outcomes:
        for seed in range(outcome.seeds):
            columns = {name: values[seed] for name, values in outcome.metrics.items()}
            where = {"scenario_set": comparison.scenario_set.name, "split": outcome.split}
            run = {"method": outcome.method.name, **where, "seed": seed}
            frames.append(pd.DataFrame({**run, "episode": np.arange(len(columns["cost"])), **columns}))
    return pd.concat(frames, ignore_index=True)


def write_results(
    comparison: Comparison, folder: Path, verdict: Sequence[str] = (), primary: Sequence[dict[str, Any]] = ()
) -> None:
    """Write `results.json`, with a verdict in words and its pairwise tests, and `episodes.csv`, each atomically."""
    content = to_json(comparison, verdict, primary)
    check(content, "results.json")
    write_text(folder / "results.json", json.dumps(content, indent=1, allow_nan=False) + "\n")
    episodes = to_episodes(comparison)
    write_atomically(folder / "episodes.csv", lambda path: episodes.to_csv(path, index=False, float_format="%.6g"))


_ESTIMATE = dict.fromkeys(("iqm", "low", "high"), NUMBER)
_PAIR = dict.fromkeys((*_ESTIMATE, "win_rate", "win_rate_low", "win_rate_high", "p", "p_holm"), NUMBER)
SCHEMA = object_of(
    ("primary", "profiles"),
    edition=INTEGER,
    version=INTEGER,
    scenario_set=object_of(name=TEXT, sha256=TEXT),
    provenance=object_of(
        command=TEXT,
        commit=TEXT,
        splits_version=INTEGER,
        split_seeds=mapping_of(INTEGER),
        seconds=NUMBER,
        pairs_kept_before=INTEGER,
    ),
    verdict=list_of(TEXT),
    primary=list_of(
        object_of(
            metric=TEXT,
            split=TEXT,
            challenger=TEXT,
            classical=TEXT,
            result={"enum": ["better", "worse", "open"]},
            **dict.fromkeys((*_ESTIMATE, "relative", "p_holm", "mean", "mean_low", "mean_high"), NUMBER),
        )
    ),
    rows=list_of(
        object_of(
            ("median_seed", "cost_mean", "cost_worst", "marks"),
            method=TEXT,
            kind={"enum": list(get_args(Kind))},
            split=TEXT,
            episodes=INTEGER,
            seeds=INTEGER,
            median_seed=INTEGER,
            metrics=object_of((*OF_ARRIVED, NOT_ARRIVED), **dict.fromkeys(SHOWN, object_of(**_ESTIMATE))),
            cost_mean=NUMBER,
            cost_worst=NUMBER,
            marks=mapping_of({"enum": list(get_args(Mark))}),
            failures=object_of(runs=INTEGER, not_settled=INTEGER, left_workspace=INTEGER),
            action_us=object_of(p50=NUMBER, p99=NUMBER),
            training=mapping_of(list_of(NUMBER)),
        )
    ),
    paired=list_of(
        object_of(
            method=TEXT,
            other=TEXT,
            against={"enum": list(AGAINST)},
            split=TEXT,
            metrics=object_of(
                OF_ARRIVED,
                **dict.fromkeys(PAIRED_METRICS, object_of(("scenarios",), **_PAIR, verdict=TEXT, scenarios=INTEGER)),
            ),
        )
    ),
    profiles={"type": "array"},
    failures=list_of(object_of(method=TEXT, split=TEXT, message=TEXT)),
)
"""JSON Schema (2020-12) of `results.json`."""


def check(content: object, where: str) -> None:
    """Check the content of a `results.json`; raises the errors of `baselines.tools.schema.check`."""
    check_by(content, where, SCHEMA)


def read_results(path: Path) -> dict[str, Any]:
    """Read and check a `results.json`.

    Raises:
        ValueError: If it is damaged, or of another edition or version of the scenarios.
    """
    content = _of_this_version(path)
    check(content, str(path))
    return content


def require_same_set(path: Path, wanted: SetLabel) -> None:
    """Check that a `results.json` is of this edition and version, and of this set of scenarios.

    Raises:
        ValueError: If it is of others, or cannot be read.
    """
    content = _of_this_version(path)
    label = content.get("scenario_set")
    if label != wanted._asdict():
        name, digest = (label.get(key) for key in wanted._fields) if isinstance(label, dict) else (None, None)
        raise ValueError(
            f"{path} has results of the scenarios {in_a_line(name, 40)!r} ({str(digest)[:12]}), this run is of "
            f"{wanted.name!r} ({wanted.sha256[:12]}); {_REMEDY}"
        )


def _of_this_version(path: Path) -> Any:
    """Read a `results.json` of this edition and version; NaN and infinities become text, which the schema refuses."""
    try:
        content = loads(read_text(path), parse_constant=str)
        edition = content.get("edition", 1), content["version"]  # the first edition did not say that it was one
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{path} cannot be read ({in_a_line(error)}): remove it, or choose another folder") from None
    if edition != (splits.EDITION, splits.VERSION):
        edition, version = (in_a_line(part, 40) for part in edition)
        raise ValueError(
            f"{path} has results of edition {edition}, version {version} of the scenarios, this checkout has edition "
            f"{splits.EDITION}, version {splits.VERSION}; {_REMEDY}"
        )
    return content
