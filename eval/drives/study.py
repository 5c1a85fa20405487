"""Runs of all controllers on the same arms and moves, with every effect of the drive in several sizes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from agents.policy.bundle import read_spec
from baselines.engines.parallel import Channel, Failure, run_side_by_side
from beltarm_env import BeltArmVectorEnv
from beltarm_env.arm import params_columns
from beltarm_env.arrays import Flags, Floats
from beltarm_env.metrics import TORQUE_QUALITY
from beltarm_env.rollout import rollout
from beltarm_env.task.moves import MOVE_FIELDS
from beltarm_env.task.seeds import DRIVE_SIZES
from eval.comparison.methods import Method, chosen, classical_methods, learned_methods, shipped_policies
from eval.comparison.statistics import average
from eval.drives.effects import EFFECTS, IDEAL, with_effect

SHOWN = ("cost", "tip_rms_mm", "residual_pp_mm", *TORQUE_QUALITY)
"""Metrics of the study."""
UPPER_END = 1.0
"""Size of an effect at the upper end of its training range."""
SIZES = (0.25, 0.5, UPPER_END, 1.5, 2.0)
"""Beside the ideal drive."""
_LARGEST_SIZE = 2.0  # beyond it the latency is longer than any arm's
MOST_ARMS = 1000


@dataclass(frozen=True, slots=True)
class Outcome:
    """One controller with one effect, by its size; the first size is 0."""

    metrics: dict[str, Floats]  # by name of `SHOWN`, each of shape (sizes, arms)
    left: Flags  # whether the arm left the workspace, shape (sizes, arms)


@dataclass(frozen=True, slots=True)
class DriveStudy:
    """Everything that page and pictures show."""

    arms: int
    sizes: tuple[float, ...]  # the first is 0
    names: list[str]  # of the controllers
    found: dict[tuple[str, str], Outcome]  # by controller and effect
    trained: dict[str, str]  # of learned ones: the arms that they were trained on, as `--randomization` names them

    @property
    def upper_end(self) -> int:
        """Place of the training ranges' upper ends among the sizes."""
        return self.sizes.index(UPPER_END)

    def cost(self, name: str, effect: str) -> Floats:
        """Costs with an effect at the upper end of its range, or on the ideal drive; shape (arms,)."""
        outcome, k = self._place(name, effect)
        return outcome.metrics["cost"][k]

    def level(self, name: str, effect: str, metric: str) -> float:
        """Interquartile mean of a metric there, of shares the plain mean."""
        outcome, k = self._place(name, effect)
        return average(metric, outcome.metrics[metric][k])

    def left(self, name: str, effect: str) -> int:
        """Number of arms that left the workspace there."""
        outcome, k = self._place(name, effect)
        return int(outcome.left[k].sum())

    def _place(self, name: str, effect: str) -> tuple[Outcome, int]:
        ideal = effect == IDEAL
        return self.found[name, next(iter(EFFECTS)) if ideal else effect], 0 if ideal else self.upper_end


def check_sizes(sizes: Sequence[float]) -> None:
    """Check sizes that a user asks for.

    Raises:
        ValueError: If one is out of bounds, or the upper ends of the training ranges are not among them.
    """
    for size in sizes:
        if not 0 < size <= _LARGEST_SIZE:
            raise ValueError(f"--sizes must lie above 0 and at most at {_LARGEST_SIZE:g}, got {size:g}")
    if UPPER_END not in sizes:
        raise ValueError(f"--sizes must have {UPPER_END:g} among them, the upper ends of the training ranges")


def choose_methods(names: Sequence[str]) -> list[Method]:
    """Choose controllers by name, all shipped ones by default; of a learned one its first training seed.

    Raises:
        ValueError: If a name is unknown, suggesting the nearest.
    """
    known = [*classical_methods(), *learned_methods(shipped_policies())]
    wanted = chosen("controller", names, [method.name for method in known])
    return [replace(method, sources=method.sources[:1]) for method in known if method.name in wanted]


def run_study(
    methods: Sequence[Method], arms: int, sizes: Sequence[float], jobs: int, done: Callable[[int, int], object]
) -> DriveStudy:
    """Run controllers on arms of the training ranges, with an ideal drive and with every effect in every size.

    Args:
        methods: See `choose_methods`.
        arms: Number of arms; the same ones, with the same moves, for every controller, effect and size.
        sizes: Of the effects, without 0.
        jobs: Number of processes.
        done: Called with the number of runs that are done, and of all.

    Raises:
        OSError: If a process died.
        ValueError: If a controller cannot be made.
    """
    ordered = tuple(sorted({*sizes}))
    pairs = [(method, effect) for effect in (IDEAL, *EFFECTS) for method in methods]
    tasks = {
        f"{method.name}, {effect}": partial(_run, method, effect, arms, (0.0,) if effect == IDEAL else ordered)
        for method, effect in pairs
    }
    results: dict[str, Outcome] = {}
    done(0, len(tasks))
    with closing(run_side_by_side(tasks, jobs)) as outcomes:
        for name, outcome in outcomes:
            if isinstance(outcome, Failure):
                raise outcome.error
            results[name] = outcome
            done(len(results), len(tasks))
    found = {
        (method.name, effect): _joined(results[f"{method.name}, {IDEAL}"], results[f"{method.name}, {effect}"])
        for method, effect in pairs
        if effect != IDEAL
    }
    return DriveStudy(arms, (0.0, *ordered), [method.name for method in methods], found, trained_on(methods))


def trained_on(methods: Sequence[Method]) -> dict[str, str]:
    """Arms that learned methods were trained on, as their policies say; "unknown" where one does not."""
    policies = {method.name: Path(method.sources[0]) for method in methods if method.kind == "learned"}
    specs = {name: read_spec(folder)[0] for name, folder in policies.items()}
    return {name: spec.provenance.get("config", {}).get("randomization", "unknown") for name, spec in specs.items()}


def _joined(ideal: Outcome, driven: Outcome) -> Outcome:
    metrics = {name: np.concatenate([ideal.metrics[name], driven.metrics[name]]) for name in SHOWN}
    return Outcome(metrics, np.concatenate([ideal.left, driven.left]))


def _run(method: Method, effect: str, arms: int, sizes: tuple[float, ...], _: Channel) -> Outcome:
    """Run a controller on all sizes of an effect, side by side."""
    env = BeltArmVectorEnv(arms, randomization="train")
    env.reset(seed=DRIVE_SIZES.first)
    table = np.concatenate([with_effect(env.params_table, effect, size) for size in sizes])
    move = dict(zip(MOVE_FIELDS, np.tile(env.moves, (len(sizes), 1)).T, strict=True))
    run = rollout(
        method.controller(0, []),
        len(table),
        seed=DRIVE_SIZES.first,
        options={"params": params_columns(table), "move": move},
    )
    found = run.metrics()
    shape = (len(sizes), arms)
    return Outcome({name: found[name].reshape(shape) for name in SHOWN}, ~run.finished.reshape(shape))
