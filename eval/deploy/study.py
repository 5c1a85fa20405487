"""What generated controllers take, and whether they are what was compared: on development scenarios of every split."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from agents.policy.bundle import POLICIES
from beltarm_env.arrays import Floats
from beltarm_env.rollout import Controller, Recording, rollout
from eval.comparison.splits import Split
from eval.deploy.building import SINGLE
from eval.deploy.check import Agreement, agreement, program_for
from eval.deploy.controllers import controller_of, loop_of
from eval.deploy.in_the_loop import StepTimes
from eval.deploy.package import write
from eval.deploy.sizes import PROCESSORS, Footprint, footprint, processors_for
from eval.deploy.source import Loop

CONTROLLERS = (
    *("paper", "ei", "smooth", "flat", "disturbance", "adrc", "lqg", "robust", "preview", "adaptive"),
    *(str(POLICIES / method / "seed0") for method in ("ppo", "student")),
)
"""What is measured by default: classical controllers without the variants of others, and the first seed of each shipped
method."""
SPREAD = 8
"""Samples over which plans are spread, for those that plan while the arm moves."""
ANYWAY = (SINGLE, "-DBELTARM_SINGLE_ANYWAY")


@dataclass(frozen=True)
class SinglePrecision:
    """How a program in single precision does."""

    off: Floats  # torque beside the controller's, over its limit, for the same counts; all samples
    cost: float  # mean, over the controller's, less 1


@dataclass(frozen=True)
class Spread:
    """How a program does whose plans are spread over samples."""

    times: StepTimes
    cost: float  # mean, over the controller's, less 1


@dataclass(frozen=True)
class Exported:
    """What was found of one controller, behind the guard, as it is exported."""

    name: str
    identifies: bool
    samples: int
    equal: int  # of them, torques that are equal to the last bit
    times: StepTimes
    single: SinglePrecision
    spread: Spread | None  # where plans are made while the arm moves
    footprints: dict[str, Footprint | None]  # by processor; of those that it is for


def examine(source: str, splits: list[Split], episodes: int) -> Exported:
    """Export a controller into a temporary folder, and compare program and Python on the first scenarios of splits.

    Raises:
        ValueError: If there is no compiler, or something cannot be translated.
    """
    loop, controller = loop_of(source), controller_of(source)
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made) / "export"
        write(folder, loop)
        off, recordings = [], []
        for split in splits:
            recordings.append(_beside(folder, loop, controller, split, episodes, off))
        found = _agreements(folder, loop, recordings, splits, episodes)
        singles = _agreements(folder, loop, recordings, splits, episodes, ANYWAY)
        footprints = {core: footprint(folder, loop.name, core) for core in processors_for(loop)}
    return Exported(
        loop.name,
        loop.identifies,
        sum(each.samples for each in found),
        sum(each.equal for each in found),
        max((each.times for each in found), key=lambda times: times.longest),
        SinglePrecision(np.concatenate(off), _more(singles)),
        _spread(source, recordings, splits, episodes) if loop.plans else None,
        {core: footprints.get(core) for core in PROCESSORS},
    )


def _more(found: list[Agreement]) -> float:
    """Mean cost of the programs over that of the controllers, less 1."""
    before, after = (np.concatenate([each.costs[k] for each in found]) for k in (0, 1))
    return float(after.mean() / before.mean() - 1)


def _agreements(
    folder: Path,
    loop: Loop,
    recordings: list[Recording],
    splits: list[Split],
    episodes: int,
    flags: tuple[str, ...] = (),
) -> list[Agreement]:
    pairs = zip(recordings, splits, strict=True)
    return [agreement(folder, loop, python, split, episodes, flags=flags) for python, split in pairs]


def _spread(source: str, recordings: list[Recording], splits: list[Split], episodes: int) -> Spread:
    loop = loop_of(source, plan_samples=SPREAD)
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made) / "export"
        write(folder, loop)
        found = _agreements(folder, loop, recordings, splits, episodes)
    return Spread(max((each.times for each in found), key=lambda times: times.longest), _more(found))


def _beside(
    folder: Path, loop: Loop, controller: Controller, split: Split, episodes: int, differences: list[Floats]
) -> Recording:
    """Record a controller, with a program in single precision beside it, which moves nothing.

    Adds to `differences` by how much the program's torque is off in each sample, over the limit.
    """
    with program_for(folder, loop, split, episodes, None, ANYWAY) as program:

        class Both:
            params = loop.params

            def predict(
                self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
            ) -> Any:
                """Action of the controller; see `Controller`."""
                action, memory = controller.predict(observation, state and state[0], episode_start)
                beside, kept = program.predict(observation, state and state[1], episode_start)
                differences.append(np.abs(beside - action)[:, 0])
                return action, (memory, kept)

        return rollout(Both(), episodes, **split.arguments(slice(episodes)))
