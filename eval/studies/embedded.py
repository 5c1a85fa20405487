"""Controllers as programs: whether they are what was compared, and what they take.

Exports controllers behind the guard, compiles each and runs it in the loop with arms of the development set, in double
and in single precision.
"""

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from agents.policy.bundle import POLICIES
from baselines import CONTROLLERS
from baselines.tools.progress import progress_over
from beltarm_env import CONTROL_PERIOD
from beltarm_env.arrays import Floats
from beltarm_env.rollout import Controller, Recording, rollout
from eval.comparison.methods import chosen
from eval.comparison.sets import development_set
from eval.comparison.splits import Split
from eval.exports.compilers import PROCESSORS, SINGLE, Footprint, footprint, native, processors_for
from eval.exports.in_the_loop import Agreement, StepTimes, compare, program_for
from eval.exports.program import controller_of, exportable, loop_of, write_program
from eval.exports.source import Loop
from eval.studies._frame import Bounds, StudyOptions

_MOVES = 2  # of a shift, the first ones
QUICK = {"controllers": ("smooth",), "splits": ("shift",), "episodes": 1}
PLAN_SAMPLES = 8
"""Samples over which plans are spread."""
_LEARNED = tuple(f"{method}/seed0" for method in ("ppo", "student"))
_ANYWAY = (SINGLE, "-DBELTARM_SINGLE_ANYWAY")  # also where sources refuse single precision
_SHARES = (0.5, 0.999, 1.0)  # quantiles of the torque's error in single precision
_AGREES, _COSTS = 1e-3, 0.01  # most that counts as the same: of that error over the limit, and of the cost's change


@dataclass(frozen=True)
class Options(StudyOptions):
    """Options of the study."""

    bounds = Bounds(episodes=(1, 200))

    controllers: tuple[str, ...] = (
        *("paper", "ei", "smooth", "flat", "disturbance", "adrc", "lqg", "robust", "preview", "adaptive"),
        *_LEARNED,
    )
    """Controllers, folders of policies, and shipped policies such as student/seed0. Default: classical controllers
    without variants of others, and a policy of each method."""
    splits: tuple[str, ...] = ()
    """Splits of the development set. Default: all."""
    episodes: int = 8
    """Scenarios per split, 1 to 200."""


def measure(options: Options) -> dict[str, Any]:
    """Measure each controller as a program."""
    native()  # before the work, not after it
    known = development_set()
    scenarios = known.only(chosen("split", options.splits, known.splits), options.episodes, _MOVES)
    splits = list(scenarios.splits.values())
    rows = [_row(name, splits, options.episodes) for name in progress_over("controllers", options.controllers)]
    names, able = [row["name"] for row in rows], exportable()
    return {
        "note": scenarios.label.note,
        "period_us": 1e6 * CONTROL_PERIOD,
        "plan_samples": PLAN_SAMPLES,
        "not_measured": [name for name in able if name not in names],
        "not_exported": [name for name in CONTROLLERS if name not in able],
        "rows": rows,
    }


def _row(name: str, splits: list[Split], episodes: int) -> dict[str, Any]:
    """Export a controller into a temporary folder, and measure it on the first scenarios of splits."""
    source = str(POLICIES / name) if name in _LEARNED else name
    loop, controller = loop_of(source), controller_of(source)
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made) / "export"
        write_program(folder, loop)
        recordings, errors = _with_single_precision(folder, loop, controller, splits, episodes)

        def agreements(folder: Path, loop: Loop, *flags: str) -> list[Agreement]:
            pairs, toolchain = zip(recordings, splits, strict=True), replace(native(), flags=flags)
            return [compare(folder, loop, python, split, episodes, toolchain) for python, split in pairs]

        double, single = agreements(folder, loop), agreements(folder, loop, *_ANYWAY)
        sizes = {core: footprint(folder, loop.name, core) for core in processors_for(loop.identifies)}
        spread = None
        if loop.plans:
            spread_loop = loop_of(source, plan_samples=PLAN_SAMPLES)
            write_program(folder, spread_loop)
            programs = agreements(folder, spread_loop)
            spread = {"times": _slowest(programs), "cost": _excess(programs)}
    errors = np.quantile(errors, _SHARES)
    return {
        "name": loop.name,
        "identifies": loop.identifies,
        "samples": sum(each.samples for each in double),
        "equal": sum(each.equal for each in double),
        "times": _slowest(double),
        "spread": spread,
        "sizes": {core: size._asdict() if (size := sizes.get(core)) else None for core in PROCESSORS},
        "single": {"errors": errors, "cost": _excess(single)},
    }


def _slowest(programs: list[Agreement]) -> dict[str, float]:
    """Times [us], each the largest of all splits."""
    return {name: max(getattr(each.times, name) for each in programs) for name in StepTimes._fields}


def _excess(programs: list[Agreement]) -> float:
    """Mean cost of the programs over that of their controllers, less 1."""
    python, compiled = (np.concatenate([each.costs[k] for each in programs]) for k in (0, 1))
    return float(compiled.mean() / python.mean() - 1)


def _with_single_precision(
    folder: Path, loop: Loop, controller: Controller, splits: list[Split], episodes: int
) -> tuple[list[Recording], Floats]:
    """Record a controller on splits; and a program's errors in single precision over the limit, for the same counts."""
    errors, recordings, in_single = list[Floats](), list[Recording](), replace(native(), flags=_ANYWAY)
    for split in splits:
        with program_for(folder, loop, split, split.all_moves[:, :episodes], in_single) as program:

            class Both:
                params, profile = loop.params, program.profile

                def predict(
                    self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
                ) -> Any:
                    """Action of the controller; see `Controller`."""
                    action, memory = controller.predict(observation, state and state[0], episode_start)
                    beside, kept = program.predict(observation, state and state[1], episode_start)
                    errors.append(np.abs(beside - action)[:, 0])
                    return action, (memory, kept)

            recordings.append(rollout(Both(), episodes, **split.arguments(slice(episodes))))
    return recordings, np.concatenate(errors)


def tables(data: dict[str, Any]) -> dict[str, Any]:
    """Parts of the sizes, and names of the controllers that some sentences are about."""
    rows = data["rows"]
    return {
        "parts": Footprint._fields,
        "holding": [row["name"] for row in rows if _holds(row)],
        "identifying": [row["name"] for row in rows if row["identifies"]],
        "measured_sizes": any(size for row in rows for size in row["sizes"].values()),
    }


def _holds(row: dict[str, Any]) -> bool:
    """Tell whether single precision does for a controller."""
    return row["single"]["errors"][1] <= _AGREES and abs(row["single"]["cost"]) <= _COSTS
