"""What makes learning work on this arm: variants of a student's training, trained side by side and scored.

Each variant changes one thing of `train/student.py` (see `runs.py`). All have the same shortened budget of
simulated samples, over which the learning rate falls to zero, but for SAC's. Finished runs are kept in `--runs` and not
repeated; interrupted ones continue. Beside them are the learning curves of the shipped policies.
"""

import shlex
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator

from agents.residual.bases import make_base
from baselines.tools.command import require_known
from baselines.tools.files import require_writable
from beltarm_env.task.seeds import ABLATIONS
from eval.comparison.methods import shipped_policies
from eval.comparison.rollouts import calls_side_by_side
from eval.report.curves import BEST_CLASSICAL, Curve, classical_cost, curves_figure, find_curves, levels
from eval.report.style import COLOURS, panels
from eval.studies._frame import Bounds, OptionsWithJobs, Pictures
from eval.studies.learning import bins, limits
from eval.studies.learning.runs import DEFAULT, FACTORS, VARIANTS, Run, Variant, score

QUICK: dict[str, Any] = {"only": ("default",), "samples": 5_000, "seeds": 1, "arms": 4, "jobs": 1}
QUICK |= {"bins": 1, "bin_arms": 1, "advice_arms": 2, "runs": Path("runs/ablations-quick")}


@dataclass(frozen=True)
class Options(OptionsWithJobs):
    """Options of the study."""

    bounds = (
        OptionsWithJobs.bounds
        | Bounds(samples=(1, 10**9), seeds=(1, 100), arms=(1, 10_000))
        | Bounds(bins=(1, 100), bin_arms=(1, 20), advice_arms=(1, 800))
    )

    runs: Path = Path("runs/ablations")
    """Folder of the runs. Finished runs are kept and not repeated."""
    only: tuple[str, ...] = ()
    """Factors or variants to run, such as told or nothing, with the runs that they are compared with. Default: all."""
    samples: int = 2_000_000
    """Samples that each run simulates."""
    seeds: int = 3
    """Runs of each variant, with training seeds 0, 1, ... Some variants need only one."""
    arms: int = 256
    """Arms on which the last policy is scored."""
    bins: int = 20
    """Bins of presliding, of friction and of payload, in which shipped policies are compared with the base."""
    bin_arms: int = 20
    """Arms of a bin for each of a method's policies."""
    advice_arms: int = 192
    """Arms for each of the shipped students, on which the teacher's advice to them is predicted."""


def measure(options: Options) -> dict[str, Any]:
    """Train and score what is not kept, and read the curves of the shipped policies."""
    plan = planned(options)
    require_writable(options.runs)
    kept = {run.label: run.finished(options.arms) for run in plan}  # refused before any training
    calls = {run.label: partial(run.finish, options.arms) for run in plan if kept[run.label] is None}
    results = kept | calls_side_by_side("trainings", calls, options.jobs)
    variants = [
        {**asdict(variant), "runs": [results[run.label] for run in plan if run.variant == variant]}
        for variant in chosen(options.only)
    ]
    bases = [variant["runs"][0]["base"] for variant in variants]
    validated = {(run["validation_arms"], run["moves"]) for variant in variants for run in variant["runs"]}
    shipped = find_curves(shipped_policies())
    return {
        "samples": options.samples,
        "arms": options.arms,
        "first_seed": ABLATIONS.first,
        "variants": variants,
        "references": {name: score(make_base(name), options.arms) for name in dict.fromkeys([*bases, BEST_CLASSICAL])},
        "best_classical": BEST_CLASSICAL,
        "validated": [[arms, moves, classical_cost(arms, moves)] for arms, moves in sorted(validated)],
        "shipped": shipped,
        "bins": bins.measure(options.bins, options.bin_arms, options.jobs),
        "limits": limits.measure(options.advice_arms, options.jobs),
        "shipped_levels": levels(shipped),
    }


def chosen(only: tuple[str, ...]) -> list[Variant]:
    """Variants to train, the default run first.

    Raises:
        ValueError: If there is no such factor or variant.
    """
    known = [*FACTORS, *(variant.name for variant in VARIANTS)]
    require_known(only, known, "--only: nothing to vary is called {}")
    wanted = {DEFAULT.name, *only} if only else set(known)
    wanted |= {FACTORS[variant.factor].against for variant in VARIANTS[1:] if wanted & {variant.name, variant.factor}}
    return [variant for variant in VARIANTS if variant.name in wanted or variant.factor in wanted]


def planned(options: Options) -> list[Run]:
    """All trainings; seeds in turn, so that every variant has its first before any has its second."""
    seeds, variants = range(options.seeds), chosen(options.only)
    pairs = [(variant, seed) for seed in seeds for variant in variants if seed == 0 or not variant.once]
    return [Run(variant, seed, options.samples, options.runs, options.quick) for variant, seed in pairs]


# Page

Data = dict[str, Any]

COLUMNS = {
    "cost_mean": ("cost, mean", 0),
    "cost_median": ("cost, median", 0),
    "tip_rms_mm_mean": ("tip RMS (mm)", 2),
    "still_s_median": ("still (s), median", 3),
    "residual_pp_mm_mean": ("residual p-p (mm)", 2),
    "torque_reversals_hz_mean": ("reversals (1/s)", 1),
    "left_percent": ("left (%)", 1),
}
"""Title and decimals of the scores that are shown."""
_BOTTOM, _TOP = 0.88, 1.2  # of the picture
_TICKS = (0.9, 0.95, 1.0, 1.05, 1.1)


def tables(data: Data) -> Data:
    """Variants by factor, columns of the scores, and what the sentences need."""
    runs = [run for variant in data["variants"] for run in variant["runs"]]
    first = data["variants"][0]["runs"]
    return {
        "factors": {FACTORS[name].question: (name, variants) for name, variants in by_factor(data).items()},
        "columns": COLUMNS,
        "scores": _scores,
        "label": _label,
        "words": _words,
        "compared": bins.COMPARED,
        "worst": bins.worst,
        "seeds": len(first),
        "common": first[0]["command"].rsplit(" --seed ", 1)[0],
        "minutes": sum(run["minutes"] for run in runs),
        "commits": sorted({run["commit"] for run in runs}),
    }


def by_factor(data: Data) -> dict[str, list[Data]]:
    """Variants by factor; the first of each is the run that its variants are compared with."""
    by_name = {variant["name"]: variant for variant in data["variants"]}
    of = {v["name"]: FACTORS[v["factor"]] for v in data["variants"][1:]}
    grouped = {name: [by_name[v] for v in of if of[v] is factor] for name, factor in FACTORS.items()}
    return {factor: [by_name[FACTORS[factor].against], *group] for factor, group in grouped.items() if group}


def _label(variant: Data, factor: str) -> str:
    default = factor and variant["name"] == FACTORS[factor].against
    return f"{FACTORS[factor].default} (default)" if default else variant["label"]


def _scores(variant: Data, name: str) -> Data:
    """Mean of the runs' score, and the least and the largest of several runs."""
    values = np.array([run["scores"][name] for run in variant["runs"]])
    return {"mean": values.mean(), "ends": [values.min(), values.max()] if len(values) > 1 else []}


def _words(variant: Data) -> str:
    """What the command of a variant has that the default's has not."""
    script = [] if variant["script"] == DEFAULT.script else [f"train/{variant['script']}.py"]
    return shlex.join([*script, *variant["options"]])


def pictures(data: Data) -> Pictures:
    """Curves of the ablations and of the shipped policies."""

    def shipped() -> Figure:
        arrays = ("steps", "minutes", "cost")
        curves = [Curve(**(row | {name: np.array(row[name]) for name in arrays})) for row in data["shipped"]]
        return curves_figure(curves, data["shipped_levels"])

    return {
        "ablations.png": lambda: _ablations(data),
        "shipped.png": shipped,
        "bins.png": lambda: bins.drawn(data["bins"]),
    }


def _ablations(data: Data) -> Figure:
    """Draw the curves of every factor, on common axes, over the best classical controller's cost on the same arms."""
    factors = by_factor(data) or {"": data["variants"][:1]}
    figure, axes = panels(len(factors), 3, (4.2, 3.3), sharey=True)
    levels = {(arms, moves): cost for arms, moves, cost in data["validated"]}
    for axis, (factor, variants) in zip(axes, factors.items(), strict=True):
        axis.axhline(1.0, color="0.45", lw=1, ls="--", zorder=1)
        for variant, colour in zip(variants, ("0.2", *COLOURS), strict=False):
            _draw(axis, levels, variant, colour, _label(variant, factor))
        axis.set_title(FACTORS[factor].question if factor else "", fontsize=10, loc="left")
        axis.legend(fontsize=8, frameon=False, handlelength=1.2, loc="upper right")
        axis.grid(alpha=0.3, which="both")
        axis.set(yscale="log", xlim=(0, None), ylim=(_BOTTOM, _TOP))
        axis.yaxis.set_major_locator(FixedLocator(_TICKS))
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_locator(NullLocator())
    figure.supxlabel("simulated samples (millions)", fontsize=10)
    figure.supylabel(f"cost on validation arms, over that of {data['best_classical']}", fontsize=10)
    return figure


def _draw(axis: Axes, levels: dict[tuple[int, int], float], variant: Data, colour: str, label: str) -> None:
    """Draw a variant's runs thin, and their geometric mean thick; none that lie above the picture."""
    curves = [(np.array(run["curve"]), levels[run["validation_arms"], run["moves"]]) for run in variant["runs"]]
    if min(curve[:, 2].min() / level for curve, level in curves) > _TOP:
        return
    for curve, level in curves:
        axis.plot(curve[:, 0] / 1e6, curve[:, 2] / level, color=colour, lw=0.6, alpha=0.6)
    shortest = min(len(curve) for curve, _ in curves)
    middle = np.exp(np.mean([np.log(curve[:shortest, 2] / level) for curve, level in curves], axis=0))
    axis.plot(curves[0][0][:shortest, 0] / 1e6, middle, color=colour, lw=1.8, label=label)
