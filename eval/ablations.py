"""What makes learning work on this arm: `python eval/ablations.py` trains and scores variants of PPO's run.

Each variant changes one thing of `train/ppo.py` (`eval/learning/ablation_runs.py` has the list), at one shortened
budget, over which the learning rate falls to zero. Finished runs are kept in `--runs` and not repeated; an interrupted
one goes on where it stopped. Writes ablations.md, ablations.json and curves.png.
"""

from __future__ import annotations

import difflib
import sys
import time
from collections.abc import Callable
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import one_line_errors, stop_without

try:
    import tyro

    from agents.residual.bases import make_base
    from baselines.tools.files import require_writable, write_text
    from eval.curves import BEST_CLASSICAL, classical_cost
    from eval.learning.ablation_report import Outcome, Study, as_json, draw, markdown
    from eval.learning.ablation_runs import DEFAULT, QUESTIONS, VARIANTS, Run, Variant, score
except ModuleNotFoundError as error:
    stop_without("eval/ablations.py", error)

_QUICK_STEPS = 128


@dataclass(frozen=True)
class Config:
    """Train variants of PPO's default run, and score them."""

    out: Path = Path("results/learning")
    """Folder for ablations.md, ablations.json and curves.png."""
    runs: Path = Path("runs/ablations")
    """Folder of the runs; finished ones are kept and not repeated."""
    only: tuple[str, ...] = ()
    """Factors or variants, such as told or gamma-0.95; all by default. The default run is always among them."""
    steps: int = 1_000_000
    """Agent steps of every run; a student has a budget of its own."""
    seeds: int = 2
    """Runs of each variant, with training seeds 0, 1, ..."""
    jobs: int = 2
    """Runs side by side, each on one core."""
    arms: int = 256
    """Arms on which the last policy is scored."""
    quick: bool = False
    """A first look whether everything runs: a few arms, one update's worth of steps."""

    def check(self) -> None:
        """Check the numbers.

        Raises:
            ValueError: Naming the option, its value and the bound.
        """
        for name, most in {"steps": 10**9, "seeds": 100, "jobs": 256, "arms": 10_000}.items():
            if not 1 <= getattr(self, name) <= most:
                raise ValueError(f"--{name} must lie within 1 and {most}, got {getattr(self, name)}")

    def chosen(self) -> list[Variant]:
        """The variants to train, the default run first.

        Raises:
            ValueError: If there is no such factor or variant.
        """
        known = [*QUESTIONS, *(variant.name for variant in VARIANTS)]
        for name in self.only:
            if name not in known:
                near = difflib.get_close_matches(name, known, n=1)
                hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(known)}"
                raise ValueError(f"nothing to vary is called {name!r}; {hint}")
        wanted = {DEFAULT.name, *self.only} if self.only else set(known)
        return [variant for variant in VARIANTS if variant.name in wanted or variant.factor in wanted]

    def planned(self) -> list[Run]:
        """All trainings; seeds in turn, so that every variant has its first before any has its second."""
        runs = [(variant, seed) for seed in range(self.seeds) for variant in self.chosen()]
        return [Run(variant, seed, self.budget, self.runs, self.quick) for variant, seed in runs]

    @property
    def budget(self) -> int:
        """Agent steps of every run."""
        return _QUICK_STEPS if self.quick else self.steps


def run_all(config: Config, report: Callable[[str], object]) -> list[Outcome]:
    """What came out of every run; those that had finished before are only read.

    Raises:
        ValueError: If one fails; finished ones are kept.
        KeyboardInterrupt: If interrupted; what was begun is saved.
    """
    plan = config.planned()
    found = {run: run.finished(config.arms) for run in plan}
    left = [run for run in plan if found[run] is None]
    report(f"{len(plan)} run{'s' if len(plan) > 1 else ''}, {len(plan) - len(left)} finished before")

    def finish(run: Run) -> None:
        found[run] = done = run.finish(config.arms)
        cost = done["scores"]["cost_mean"]
        report(f"{run.variant.name}, seed {run.seed}: cost {cost:.0f}, {done['minutes']:.1f} min")

    with ThreadPoolExecutor(config.jobs) as pool:
        futures = [pool.submit(finish, run) for run in left]
        try:
            wait(futures, return_when=FIRST_EXCEPTION)
        finally:
            pool.shutdown(cancel_futures=True)
    for future in futures:
        if not future.cancelled():
            future.result()
    return [Outcome(variant, _of(variant, found)) for variant in config.chosen()]


def _of(variant: Variant, found: dict[Run, dict[str, Any] | None]) -> list[dict[str, Any]]:
    return [done for run, done in found.items() if run.variant == variant and done is not None]


def study(config: Config, report: Callable[[str], object]) -> Study:
    """Everything that is reported."""
    outcomes = run_all(config, report)
    bases = [run.base for run in outcomes] + [BEST_CLASSICAL]
    references = {name: score(make_base(name), config.arms) for name in dict.fromkeys(bases)}
    (validated,) = {run["validation_arms"] for run in outcomes[0].runs}
    return Study(outcomes, references, config.budget, config.arms, classical_cost(validated))


def main() -> None:
    """Command line."""
    began = time.perf_counter()
    config = tyro.cli(Config, description=__doc__)
    with one_line_errors("eval/ablations.py"):
        config.check()
        config.chosen()
        require_writable(config.out)
        require_writable(config.runs)
        found = study(config, lambda line: print(line, file=sys.stderr, flush=True))
        data, page = as_json(found), markdown(found, time.perf_counter() - began)  # before a file of the commit changes
        draw(found, config.out / "curves.png")
        write_text(config.out / "ablations.json", data)
        write_text(config.out / "ablations.md", page)
        print(f"written to {config.out}: ablations.md, ablations.json, curves.png")


if __name__ == "__main__":
    main()
