"""Content, writing, reading and checking of `results.json` (`SCHEMA`) and `episodes.csv`.

Numbers are finite: NaN and infinities are refused as they are written and as they are read.
"""

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
from eval.comparison.cache import SENSITIVE
from eval.comparison.methods import Kind
from eval.comparison.results import PAIRED_METRICS, Against, Comparison, Mark, MethodOutcome
from eval.comparison.sets import SetLabel
from eval.comparison.statistics import LEAST_OF_TAIL, Paired, worst_mean

_REMEDY = "they cannot be merged: remove it, or choose another folder"
AGAINST: tuple[Against, ...] = get_args(Against)
"""Others of paired comparisons."""


def to_json(
    comparison: Comparison, verdict: Sequence[str] = (), primary: Sequence[dict[str, Any]] = ()
) -> dict[str, Any]:
    """Content of `results.json`, with a verdict in words and its pairwise tests."""
    return {
        "edition": splits.EDITION,
        "version": splits.VERSION,
        "scenario_set": comparison.scenario_set._asdict(),
        "provenance": comparison.provenance,
        "verdict": list(verdict),
        "primary": list(primary),
        "rows": [_row(outcome, comparison.marks[outcome.split]) for outcome in comparison.outcomes],
        "paired": [
            {
                "method": pair.outcome.name,
                "other": pair.other.name,
                "against": pair.against,
                "split": pair.outcome.split,
                "metrics": {name: _pair(p) for name, p in pair.metrics.items() if isfinite(p.difference.iqm)},
            }
            for pair in comparison.pairs
        ],
        "failures": [{"method": f.method, "split": f.split, "message": f.message} for f in comparison.failures],
    }


def _row(outcome: MethodOutcome, marks: dict[str, dict[str, Mark]]) -> dict[str, Any]:
    name, costs = outcome.name, outcome.metrics["cost"]
    return {
        "method": name,
        "kind": outcome.method.kind,
        "split": outcome.split,
        "episodes": costs.shape[1],
        "moves": outcome.moves,
        "seeds": outcome.seeds,
        "median_seed": outcome.median_seed,
        "metrics": {metric: asdict(value) for metric, value in outcome.estimates.items() if isfinite(value.iqm)},
        "cost_mean": float(costs.mean()),
        **({"cost_worst": worst_mean(costs)} if costs.shape[1] >= LEAST_OF_TAIL else {}),
        "marks": {metric: of_metric[name] for metric, of_metric in marks.items() if name in of_metric},
        "failures": outcome.failures,
        **({"sensitivity": float(outcome.metrics[SENSITIVE].mean())} if SENSITIVE in outcome.metrics else {}),
        "action_us": {"p50": outcome.action_times[0], "p99": outcome.action_times[1]},
        "training": outcome.method.training,
    }


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
            run = {"method": outcome.name, **where, "seed": seed}
            frames.append(pd.DataFrame({**run, "episode": np.arange(len(columns["cost"])), **columns}))
    return pd.concat(frames, ignore_index=True)


def require_rows_kept(path: Path, comparison: Comparison) -> None:
    """Check that a results.json, if there is one, has no row of what failed now; raises ValueError if it has one."""
    rows = {(row["method"], row["split"]) for row in read_results(path)["rows"]} if path.exists() else set()
    lost = rows - {(outcome.name, outcome.split) for outcome in comparison.outcomes}
    for failure in comparison.failures:
        if (failure.method, failure.split) in lost:
            failed = f"{failure.method} failed on {failure.split} ({failure.message})"
            raise ValueError(f"{failed}, and {path} has its results, which would be lost: give another --out")


def write_results(
    comparison: Comparison, folder: Path, verdict: Sequence[str] = (), primary: Sequence[dict[str, Any]] = ()
) -> dict[str, Any]:
    """Write `results.json`, with a verdict and its pairwise tests, and `episodes.csv`; return content of the former."""
    content = to_json(comparison, verdict, primary)
    check(content, "results.json")
    write_text(folder / "results.json", json.dumps(content, indent=1, allow_nan=False) + "\n")
    episodes = to_episodes(comparison)
    write_atomically(folder / "episodes.csv", lambda path: episodes.to_csv(path, index=False, float_format="%.6g"))
    return content


_ESTIMATE = dict.fromkeys(("iqm", "low", "high"), NUMBER)  # interquartile mean (of shares: a mean), 95 % interval
_PAIR = dict.fromkeys((*_ESTIMATE, "win_rate", "win_rate_low", "win_rate_high", "p", "p_holm"), NUMBER)
_METRICS = dict.fromkeys(SHOWN, object_of(**_ESTIMATE))
_PAIRS = dict.fromkeys(PAIRED_METRICS, object_of(("scenarios",), **_PAIR, verdict=TEXT, scenarios=INTEGER))
_TEST = dict.fromkeys((*_ESTIMATE, "relative", "p_holm", "mean", "mean_low", "mean_high"), NUMBER)
_PROVENANCE = {"command": TEXT, "commit": TEXT, "splits_version": INTEGER, "split_seeds": mapping_of(INTEGER)}
_PRIMARY = object_of(  # a test of the primary comparison: a metric on a split
    metric=TEXT,
    split=TEXT,
    challenger=TEXT,
    classical=TEXT,
    result={"enum": ["better", "worse", "open"]},  # "open": no difference shown
    **_TEST,  # difference, its share of the classical controller's value, p after all corrections
)
_ROW = object_of(  # a method on a split
    ("median_seed", "cost_worst", "marks", "sensitivity"),
    method=TEXT,
    sensitivity=NUMBER,  # on the main split: share of episodes whose cost changes with the first torque
    kind={"enum": list(get_args(Kind))},  # "added": a user's own; "privileged": an oracle, never ranked
    split=TEXT,
    episodes=INTEGER,
    moves=INTEGER,  # of an episode; metrics are averages over them
    seeds=INTEGER,
    median_seed=INTEGER,  # training seed of median cost
    metrics=object_of((*OF_ARRIVED, NOT_ARRIVED, "still_s"), **_METRICS),  # `OF_ARRIVED` where all seeds arrive
    cost_mean=NUMBER,
    cost_worst=NUMBER,  # mean of the worst 5 %, where there are scenarios enough
    marks=mapping_of({"enum": list(get_args(Mark))}),  # by metric
    failures=object_of(runs=INTEGER, not_settled=INTEGER, left_workspace=INTEGER),
    action_us=object_of(p50=NUMBER, p99=NUMBER),  # time per action
    training=mapping_of(list_of(NUMBER)),  # see `eval.comparison.methods.EFFORT`
)
_COMPARED = object_of(  # two methods on the same scenarios
    method=TEXT,
    other=TEXT,
    against={"enum": list(AGAINST)},
    split=TEXT,
    metrics=object_of(OF_ARRIVED, **_PAIRS),  # difference; probability of improvement; p, also after Holm's correction
)
SCHEMA = object_of(
    ("primary",),
    edition=INTEGER,  # of the comparison: results of two editions, versions or sets of scenarios are not compared
    version=INTEGER,  # of the scenarios
    scenario_set=object_of(name=TEXT, sha256=TEXT),
    provenance=object_of(("added",), **_PROVENANCE, seconds=NUMBER, pairs_kept_before=INTEGER, added=mapping_of(TEXT)),
    verdict=list_of(TEXT),  # sentences, made from these numbers
    primary=list_of(_PRIMARY),
    rows=list_of(_ROW),
    paired=list_of(_COMPARED),
    failures=list_of(object_of(method=TEXT, split=TEXT, message=TEXT)),  # could not be run to the end, or not again
)
"""JSON Schema (2020-12) of `results.json`."""


def check(content: object, where: str) -> None:
    """Check the content of a `results.json`; raises the errors of `baselines.tools.schema.check`."""
    check_by(content, where, SCHEMA)


def read_results(path: Path, wanted: SetLabel | None = None) -> dict[str, Any]:
    """Read and check a `results.json`, which must be of the wanted set of scenarios.

    Raises:
        ValueError: If it is missing, damaged, or of another edition, version or set of the scenarios.
    """
    if not path.exists():
        raise ValueError(f"there is no {path}: name a folder that eval/compare.py has written")
    try:
        content: Any = loads(read_text(path), parse_constant=str)  # NaN as text, which the schema refuses
        edition = content.get("edition", 1), content["version"]  # the first edition did not say that it was one
        label = content.get("scenario_set")
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{path} cannot be read ({in_a_line(error)}): remove it, or choose another folder") from None
    if edition != (splits.EDITION, splits.VERSION):
        edition, version = (in_a_line(part, 40) for part in edition)
        raise ValueError(
            f"{path} has results of edition {edition}, version {version} of the scenarios, this checkout has edition "
            f"{splits.EDITION}, version {splits.VERSION}; {_REMEDY}"
        )
    if wanted and label != wanted._asdict():
        name, digest = (label.get(key) for key in wanted._fields) if isinstance(label, dict) else (None, None)
        raise ValueError(
            f"{path} has results of the scenarios {in_a_line(name, 40)!r} ({str(digest)[:12]}), this run is of "
            f"{wanted.name!r} ({wanted.sha256[:12]}); {_REMEDY}"
        )
    check(content, str(path))
    return content
