"""What makes learning work on this arm: variants of a student's training, trained side by side and scored.

Each variant changes one thing of `train/student.py` (see `runs.py`). All have the same shortened budget of
simulated samples, over which the learning rate falls to zero. Finished runs are kept in `--runs` and not repeated;
interrupted ones continue. Beside them are the learning curves of the shipped policies.
"""

import shlex
import sys
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agents.policy.bundle import POLICIES
from agents.residual.bases import make_base
from agents.runs.checkpoint import CHECKPOINT
from baselines.engines.options import WithStorage
from baselines.engines.parallel import Failure, Interrupted, StopRequest, run_side_by_side, stop_on_signals
from baselines.engines.workplace import Workplace
from baselines.tools.command import require_known
from baselines.tools.files import require_writable
from beltarm_env.task.seeds import ABLATIONS
from eval.report.curves import BEST_CLASSICAL, Curve, classical_cost, curves_figure, find_curves, levels
from eval.report.style import COLOURS, mark_one_two_five, panels
from eval.studies._frame import Bounds, Pictures, StudyOptions
from eval.studies.learning.runs import DEFAULT, FACTORS, VARIANTS, Run, Variant, score

QUICK = {"only": ("default",), "samples": 5_000, "seeds": 1, "arms": 4, "runs": Path("runs/ablations-quick")}


@dataclass(frozen=True, kw_only=True)
class Options(StudyOptions, WithStorage):
    """Options of the study."""

    bounds = Bounds(samples=(1, 10**9), seeds=(1, 100), arms=(1, 10_000))

    runs: Path = Path("runs/ablations")
    """Folder of the runs. Finished runs are kept and not repeated."""
    only: tuple[str, ...] = ()
    """Factors or variants to run, such as told or gru-0, with the runs that they are compared with. Default: all."""
    samples: int = 8_000_000
    """Samples that each run simulates."""
    seeds: int = 3
    """Runs of each variant, with training seeds 0, 1, ... Some variants need only one."""
    arms: int = 256
    """Arms on which the last policy is scored."""


def measure(options: Options) -> dict[str, Any]:
    """Train and score what is not kept, and read the curves of the shipped policies."""
    options.check_engine()
    plan = planned(options)
    require_writable(options.runs)
    tell, stop = partial(print, file=sys.stderr, flush=True), StopRequest()
    with stop_on_signals(stop, lambda: tell("stopping after these updates; press Ctrl-C again to stop at once")):
        results = run_all(plan, options, tell, stop)
    variants = [
        {**asdict(variant), "runs": [results[run.label] for run in plan if run.variant == variant]}
        for variant in chosen(options.only)
    ]
    bases = [variant["runs"][0]["base"] for variant in variants]
    (validated,) = {(run["validation_arms"], run["moves"]) for run in variants[0]["runs"]}
    shipped = find_curves([path for path in sorted(POLICIES.glob("*")) if path.is_dir()])
    return {
        "samples": options.samples,
        "arms": options.arms,
        "first_seed": ABLATIONS.first,
        "variants": variants,
        "references": {name: score(make_base(name), options.arms) for name in dict.fromkeys([*bases, BEST_CLASSICAL])},
        "best_classical": {"name": BEST_CLASSICAL, "validated": classical_cost(*validated)},
        "shipped": shipped,
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


def run_all(plan: list[Run], options: Options, tell: Callable[[str], object], stop: StopRequest) -> dict[str, Any]:
    """Results of runs, by label; those that had finished before are only read.

    Args:
        plan: The runs.
        options: Options of the study.
        tell: Called with lines of text.
        stop: Whether to stop.

    Raises:
        ValueError: If runs fail, once the others are through; finished ones are kept.
        OSError: If files cannot be written, or processes broke off.
        KeyboardInterrupt: If asked to stop; what was begun is saved.
    """
    results: dict[str, Any] = {run.label: run.finished(options.arms) for run in plan}
    left = {run.label: run for run in plan if results[run.label] is None}
    tell(f"{len(plan)} run{'s' if len(plan) > 1 else ''}, {len(plan) - len(left)} finished before")
    failures: list[str] = []
    with Workplace(options, options.runs) as workplace:
        tasks = {}
        for label, run in left.items():
            workplace.prepare(label, run.folder, resume=True)
            tasks[label] = workplace.task(label, run.folder, partial(run.finish, options.arms), CHECKPOINT)
        with closing(run_side_by_side(tasks, options.jobs, engine=options.runs_on, stop=stop)) as outcomes:
            for label, done in outcomes:
                workplace.collect(label, left[label].folder)
                if not isinstance(done, Failure):
                    results[label] = done
                    tell(f"{label}: cost {done['scores']['cost_mean']:.0f}, {done['minutes']:.1f} min")
                elif not isinstance(done.error, Interrupted):
                    failures.append(done.message)
    if failures:
        raise ValueError("; ".join(failures))
    if stop.made:
        raise KeyboardInterrupt("interrupted; all runs that had started are saved, and the same command continues")
    return results


# Page

Data = dict[str, Any]

COLUMNS = {
    "cost_mean": ("cost, mean", 0),
    "cost_median": ("cost, median", 0),
    "tip_rms_mm_mean": ("tip RMS (mm)", 2),
    "residual_pp_mm_mean": ("residual p-p (mm)", 2),
    "torque_reversals_hz_mean": ("reversals (1/s)", 1),
    "left_percent": ("left (%)", 1),
}
"""Title and decimals of the scores that are shown."""
_TOP = 5  # of the picture, over the base's cost; what is above has lost arms


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
        "seeds": len(first),
        "base": first[0]["base"],
        "common": first[0]["command"].rsplit(" --seed ", 1)[0],
        "minutes": sum(run["minutes"] for run in runs),
        "commits": sorted({run["commit"] for run in runs}),
        "unknown_code": sum(run["digest"] is None for run in runs),
    }


def by_factor(data: Data) -> dict[str, list[Data]]:
    """Variants by factor; the first of each is the run that its variants are compared with."""
    by_name = {variant["name"]: variant for variant in data["variants"]}
    grouped = {factor: [v for v in data["variants"] if v["factor"] == factor] for factor in FACTORS}
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

    return {"ablations.png": lambda: _ablations(data), "shipped.png": shipped}


def _ablations(data: Data) -> Figure:
    """Draw the curves of every factor, on common axes."""
    factors = by_factor(data) or {"": data["variants"][:1]}
    figure, axes = panels(len(factors), 4, (3.6, 3.3), sharey=True)
    best, default = data["best_classical"], data["variants"][0]["runs"][0]
    levels = {default["base"]: default["validation_of_base"], best["name"]: best["validated"]}
    lowest = min(point[2] for variant in data["variants"] for run in variant["runs"] for point in run["curve"])
    for axis, (factor, variants) in zip(axes, factors.items(), strict=True):
        _panel(axis, levels, factor, variants)
        bottom, top = 0.7 * min(lowest, best["validated"]), _TOP * default["validation_of_base"]
        axis.set(yscale="log", xlim=(0, None), ylim=(bottom, top))
        mark_one_two_five(axis.yaxis)
    figure.supxlabel("simulated samples (millions)", fontsize=10)
    figure.supylabel("mean episode cost, validation arms", fontsize=10)
    return figure


def _panel(axis: Axes, levels: dict[str, float], factor: str, variants: list[Data]) -> None:
    sides = ("center",) if len(levels) == 1 else ("bottom", "top")
    for (name, level), dashes, side in zip(levels.items(), ("--", ":"), sides, strict=False):
        axis.axhline(level, color="0.45", lw=1, ls=dashes, zorder=1)
        end = axis.get_yaxis_transform()
        axis.text(1.01, level, name, transform=end, color="0.35", va=side, ha="left", fontsize=7)
    for variant, colour in zip(variants, ("0.2", *COLOURS), strict=False):
        curves = [np.array(run["curve"]) for run in variant["runs"]]
        for curve in curves:
            axis.plot(curve[:, 0] / 1e6, curve[:, 2], color=colour, lw=0.6, alpha=0.6)
        shortest = min(len(curve) for curve in curves)
        middle = np.exp(np.mean([np.log(curve[:shortest, 2]) for curve in curves], axis=0))
        axis.plot(curves[0][:shortest, 0] / 1e6, middle, color=colour, lw=1.8, label=_label(variant, factor))
    axis.set_title(FACTORS[factor].question if factor else "", fontsize=9, loc="left")
    axis.legend(fontsize=7, frameon=False, handlelength=1.2, loc="upper left", bbox_to_anchor=(0, -0.08), ncols=2)
    axis.grid(alpha=0.3, which="both")
    axis.tick_params(labelsize=8)
