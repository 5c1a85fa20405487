"""What makes learning work on this arm: variants of a student's training, trained side by side and scored.

Each variant changes one thing of `train/student.py` (see `runs.py`). All have the same shortened budget of
simulated samples, over which the learning rate falls to zero. Finished runs are kept in `--runs` and not repeated;
interrupted ones continue. Beside them are the learning curves of the shipped policies.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from agents.policy.bundle import POLICIES
from agents.residual.bases import make_base
from agents.runs.checkpoint import CHECKPOINT
from baselines.engines.options import WithStorage
from baselines.engines.parallel import Failure, Interrupted, StopRequest, run_side_by_side, stop_on_signals
from baselines.engines.workplace import Workplace
from baselines.tools.command import require_known
from baselines.tools.files import require_writable
from beltarm_env.task.seeds import ABLATIONS
from eval.report.curves import BEST_CLASSICAL, classical_cost, find_curves, levels
from eval.studies._frame import Bounds, StudyOptions
from eval.studies.learning.page import pictures, tables
from eval.studies.learning.runs import DEFAULT, FACTORS, VARIANTS, Run, Variant, score

__all__ = ["QUICK", "Options", "measure", "pictures", "tables"]
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
    (validated,) = {run["validation_arms"] for run in variants[0]["runs"]}
    shipped = find_curves([path for path in sorted(POLICIES.glob("*")) if path.is_dir()])
    return {
        "samples": options.samples,
        "arms": options.arms,
        "first_seed": ABLATIONS.first,
        "variants": variants,
        "references": {name: score(make_base(name), options.arms) for name in dict.fromkeys([*bases, BEST_CLASSICAL])},
        "best_classical": {"name": BEST_CLASSICAL, "validated": classical_cost(validated)},
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
