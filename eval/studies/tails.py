"""Tail risk: what happens once in a thousand moves.

The best controllers and policies on 25000 scenarios that were drawn afresh. A learned method has several policies. Each
scenario is played by one of them, scenario i by policy i modulo their number: so the scenarios of a method are
independent of one another, as the intervals take them to be. What is done is kept in results/compare, as the parts of
a comparison are, and an interrupted run goes on.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console
from scipy.stats import binomtest, ks_2samp, quantile_test

from baselines.tools.progress import progress_count
from beltarm_env.arm import params_columns
from beltarm_env.metrics import ARRIVAL_BOUND, NOT_ARRIVED, OF_ARRIVED, TORQUE_QUALITY, heading
from beltarm_env.metrics import METRICS as KNOWN
from beltarm_env.task.moves import MOVE_FIELDS
from eval.comparison.cache import LEFT, Part, parts_of, run_parts
from eval.comparison.methods import Method
from eval.comparison.provenance import ROOT
from eval.comparison.rollouts import Failure
from eval.comparison.run import choose_methods
from eval.comparison.sets import SetLabel, development_set, fresh_scenarios, require_same_physics
from eval.comparison.splits import EPISODES, SPLITS, Split
from eval.comparison.statistics import CONFIDENCE, holm, interquartile_mean
from eval.report.style import COLOURS, below, mark_one_two_five
from eval.report.text import rounded
from eval.studies._frame import Bounds, Pictures, StudyOptions

Floats = NDArray[np.float64]
Interval = tuple[float, float, float]
"""An estimate and the ends of its 95 % interval; an end that too few values show is not a number."""
SEED, SPLIT = 1, "randomized"
METHODS = ("paper", "preview", "adaptive", "ppo", "student")
DISTRIBUTIONS = ("cost", "tip_rms_mm", "tip_max_mm", "residual_pp_mm", "settling_s")
"""Metrics with a table of their own."""
MEASURED = (*DISTRIBUTIONS, *TORQUE_QUALITY)
DRAWN = ("cost", "tip_max_mm")
SHARES = (0.5, 0.9, 0.99, 0.999)  # of the percentiles that are shown
OF_DIFFERENCE = (0.001, 0.01, 0.5, 0.99, 0.999)  # of those of the difference between two methods
WORST = 0.001  # share of all scenarios that counts as the tail
CASES = 5  # worst scenarios that are named
QUICK = {"episodes": 20, "jobs": 1}
_KEPT = Path("results/compare")  # where `eval/compare.py` keeps its parts too
_POINTS = 200  # of a drawn distribution
_USUAL = 10_000  # scenarios that say how arms are distributed


@dataclass(frozen=True)
class Options(StudyOptions):
    """Options of the study."""

    bounds = Bounds(episodes=(20, 1_000_000), jobs=(1, 256))

    episodes: int = 25_000
    """Number of scenarios."""
    jobs: int = 2
    """Number of processes."""


# Estimates


def percentile(values: Floats, share: float) -> Interval:
    """Smallest value that at least this share of all values does not exceed, with its interval.

    The ends of the interval are two other values, whose places in the order follow from the binomial distribution,
    whatever the values' own distribution is (W. J. Conover, Practical Nonparametric Statistics, 1999, section 3.2).
    """
    point = float(np.quantile(values, share, method="inverted_cdf"))
    ends = quantile_test(values, p=share).confidence_interval(CONFIDENCE)
    return point, float(ends.low), float(ends.high)


def share_of(happened: NDArray[np.bool_]) -> Interval:
    """Share of scenarios in which something happened, with its exact interval (Clopper and Pearson)."""
    ends = binomtest(int(happened.sum()), len(happened)).proportion_ci(CONFIDENCE, method="exact")
    return float(happened.mean()), float(ends.low), float(ends.high)


def tail_size(count: int) -> int:
    """Number of values that count as the tail of `count`."""
    return max(1, round(WORST * count))


def tail_of(values: Floats) -> dict[str, Any]:
    """Mean with its standard error, IQM, percentiles, and mean of the tail; nothing of fewer than two values."""
    if len(values) < 2:
        nothing = dict.fromkeys(("mean", "error", "iqm", "worst_mean", "worst"), math.nan)
        return nothing | {"percentiles": [(math.nan, math.nan, math.nan)] * len(SHARES)}
    ordered = np.sort(values)
    return {
        "mean": values.mean(),
        "error": _standard_error(values),
        "iqm": interquartile_mean(values),
        "percentiles": [percentile(ordered, share) for share in SHARES],
        "worst_mean": ordered[-tail_size(len(values)) :].mean(),
        "worst": ordered[-1],
    }


def _standard_error(values: Floats) -> float:
    return float(values.std(ddof=1) / math.sqrt(len(values)))


def paired_with(values: Floats, others: Floats) -> dict[str, Any]:
    """Compare the values of two methods on the same scenarios, shape (n,) both."""
    difference = np.sort(values - others)
    return {
        "dearer": share_of(difference > 0),
        "mean": difference.mean(),
        "error": _standard_error(difference),
        "percentiles": [percentile(difference, share) for share in OF_DIFFERENCE],
        "most": difference[-1],
    }


def distinguishing_parameters(tail: Mapping[str, Floats], usual: Mapping[str, Floats]) -> list[dict[str, Any]]:
    """Parameters whose distribution in the tail differs from that of all scenarios (KS test, Holm), farthest first."""
    tests: dict[str, Any] = {name: ks_2samp(values, usual[name], method="asymp") for name, values in tail.items()}
    adjusted = holm([float(test.pvalue) for test in tests.values()])
    shown = [name for name, p in zip(tests, adjusted, strict=True) if p < 1 - CONFIDENCE]
    distances = {name: tests[name].statistic for name in shown}
    return [
        {"name": name, "distance": distance, "median": np.median(tail[name]), "usual": np.median(usual[name])}
        for name, distance in sorted(distances.items(), key=lambda entry: -entry[1])
    ]


def exceedance(values: Floats) -> dict[str, Floats]:
    """Values from the least to the largest, and the share of all that reaches each; equally spread in its logarithm."""
    ordered = np.sort(values)
    ranks = np.unique(np.geomspace(1, len(values), _POINTS).round().astype(np.intp))[::-1]
    return {"values": ordered[-ranks], "shares": ranks / len(values)}


# Measuring


def measure(options: Options) -> dict[str, Any]:
    """Tails of all methods."""
    require_same_physics(development_set().only([SPLIT]))
    split = fresh_scenarios(SEED, SPLIT, range(options.episodes))
    methods = sorted(choose_methods(METHODS), key=lambda method: METHODS.index(method.name))
    values = played(methods, split, options.jobs)
    classical = [method.name for method in methods if method.kind == "classical"]
    best = min(classical, key=lambda method: interquartile_mean(values[method]["cost"]))
    usual = _parameters(split.part(slice(_USUAL)))
    return {
        "scenario_seed": SEED,
        "episodes": options.episodes,
        "split": SPLIT,
        "best": best,
        "methods": {
            method.name: {
                "kind": method.kind,
                "sources": [source.removeprefix(f"{ROOT}/") for source in method.sources],
                **_outcome(values[method.name], split, len(method.sources), usual),
                "against": paired_with(values[method.name]["cost"], values[best]["cost"]),
            }
            for method in methods
        },
    }


def played(methods: Sequence[Method], split: Split, jobs: int | None, folder: Path = _KEPT) -> dict[str, Any]:
    """Values of each method and metric, shape (n,); the policies of a learned method take turns.

    Raises:
        ValueError: If a method fails.
    """
    places, parts = list[tuple[str, slice]](), list[Part]()
    for method in methods:
        turns = len(method.sources)
        for policy, source in enumerate(method.sources):
            alone = replace(method, name=f"{method.name}-{policy}", sources=(source,)) if turns > 1 else method
            own = split.part(slice(policy, None, turns))
            for part in parts_of(alone, own, len(own.table)):
                first = turns * part.first + policy
                places.append((method.name, slice(first, first + turns * part.count, turns)))
                parts.append(part)
    with progress_count("parts", Console()) as done:
        results = run_parts(parts, folder, jobs, done)
    values = {method.name: {name: np.empty(len(split.table)) for name in (*KNOWN, LEFT)} for method in methods}
    for (method, place), result in zip(places, results, strict=True):
        if isinstance(result, Failure):
            raise ValueError(f"{method} failed: {result.message}")
        for name, table in result.items():
            values[method][name][place] = table[0]
    return values


def _outcome(values: dict[str, Floats], split: Split, policies: int, usual: Mapping[str, Floats]) -> dict[str, Any]:
    cost, away = values["cost"], values[NOT_ARRIVED] > 0
    order = np.argsort(-cost, kind="stable")
    return {
        "tails": {name: tail_of(values[name][~away] if name in OF_ARRIVED else values[name]) for name in MEASURED},
        "few": tail_of(cost[:EPISODES]),
        "policies": [tail_of(cost[policy::policies]) for policy in range(policies)] if policies > 1 else [],
        "left": share_of(values[LEFT] > 0),
        "not_arrived": share_of(away),
        "not_settled": share_of(values["failure_share"] > 0),
        "curves": {name: exceedance(values[name]) for name in DRAWN},
        "worst": [
            {
                "scenario": k,
                "policy": k % policies,
                "cost": cost[k],
                "tip_max_mm": values["tip_max_mm"][k],
                **dict(zip(MOVE_FIELDS, split.moves[k], strict=True)),
            }
            for k in order[:CASES].tolist()
        ],
        "distinguishing": distinguishing_parameters(_parameters(split.part(order[: tail_size(len(cost))])), usual),
    }


def _parameters(split: Split) -> dict[str, Floats]:
    """Constants, move and delay of scenarios, by name; shape (n,) each."""
    moves = dict(zip(MOVE_FIELDS, split.moves.T, strict=True))
    length = {"length of the move": np.abs(moves["goal"] - moves["start"])}
    return {**params_columns(split.table), **moves, **length, "delay": split.delays}


# Page


def tables(data: dict[str, Any]) -> dict[str, Any]:
    """Names, bounds and texts of intervals for the template."""
    methods: dict[str, Any] = data["methods"]
    learned = [name for name, entry in methods.items() if entry["kind"] == "learned"]
    challenger = min(learned, key=lambda name: methods[name]["tails"]["cost"]["iqm"])
    rare = [methods[name]["tails"]["cost"]["percentiles"][-1] for name in (challenger, data["best"])]
    ends = [[math.nan if end is None else end for end in interval] for interval in rare]
    return {
        "note": SetLabel(f"seed {data['scenario_seed']}", "").note,
        "few": EPISODES,
        "description": SPLITS[data["split"]].description,
        "arrival_mm": 1000 * ARRIVAL_BOUND,
        "challenger": challenger,
        "rare": rare,
        "apart": ends[0][2] < ends[1][1] or ends[1][2] < ends[0][1],
        "shares": [f"{100 * share:g} %" for share in SHARES],
        "differences": [f"{100 * share:g} %" for share in OF_DIFFERENCE],
        "worst": f"worst {100 * WORST:g} %",
        "tail_size": tail_size(data["episodes"]),
        "distributions": DISTRIBUTIONS,
        "torques": TORQUE_QUALITY,
        "drawn": DRAWN,
        "digits": {name: KNOWN[name].digits for name in DISTRIBUTIONS},
        "interval": _interval,
        "share": _share,
        "rounded": _rounded,
    }


def _rounded(metric: str, value: float | None) -> str:
    return rounded(metric, math.nan if value is None else value)


def _interval(metric: str, interval: Sequence[float | None]) -> str:
    point, low, high = (_rounded(metric, end) for end in interval)
    return f"{point} [{low}, {high}]"


def _share(interval: Sequence[float]) -> str:
    """A share with its interval, in percent."""
    return "{:.3g} [{:.3g}, {:.3g}]".format(*(100 * end for end in interval))


def pictures(data: dict[str, Any]) -> Pictures:
    """Share of scenarios that reach a cost, and a tip error."""
    return {"tails.png": lambda: _draw(data["methods"])}


def _draw(methods: Mapping[str, Any]) -> Figure:
    figure, axes = plt.subplots(1, len(DRAWN), figsize=(10.5, 4.8), sharey=True, layout="constrained")
    for axis, metric in zip(axes, DRAWN, strict=True):
        for (name, entry), colour in zip(methods.items(), COLOURS, strict=False):
            values, shares = (np.array(entry["curves"][metric][key]) for key in ("values", "shares"))
            axis.plot(values, 100 * shares, color=colour, lw=1.8, label=name)
            axis.plot(values[-1:], 100 * shares[-1:], "o", color=colour, ms=4)
        axis.axhline(100 / EPISODES, color="0.45", lw=0.9, ls=(0, (4, 3)))
        axis.set(xscale="log", yscale="log", xlabel=heading(metric))
        mark_one_two_five(axis.xaxis)
        axis.yaxis.set_major_formatter("{x:g}")
        axis.grid(color="0.9", lw=0.6)
    axes[0].set_ylabel("share of scenarios that reach it (%)")
    at = {"xycoords": ("axes fraction", "data"), "xytext": (4, 3), "textcoords": "offset points", "fontsize": 9}
    axes[0].annotate(f"one in {EPISODES}", (0.0, 100 / EPISODES), color="0.35", **at)
    below(figure, axes[0], len(methods))
    return figure
