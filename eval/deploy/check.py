"""Check of generated sources: the torques of the controller in Python and of the compiled program, sample by sample."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from beltarm_env.arrays import Floats
from beltarm_env.rollout import Controller, Recording, rollout
from beltarm_env.task.sensors import ENCODER_COUNTS
from eval.comparison.splits import Split
from eval.deploy.building import Toolchain, here
from eval.deploy.in_the_loop import InTheLoop, StepTimes
from eval.deploy.source import Loop


@dataclass(frozen=True)
class Agreement:
    """How far a program agrees with the controller, in closed loop on the scenarios of a split."""

    samples: int
    equal: int  # of them, torques that are equal to the last bit
    largest: float  # difference of torques [N m]
    costs: tuple[Floats, Floats]  # of the controller, of the program; shape (episodes,)
    times: StepTimes

    def words(self) -> str:
        """Say what was found."""
        times = self.times
        return (
            f"{self.equal} of {self.samples} torques are equal to the last bit, and the mean cost is "
            f"{100 * (self.costs[1].mean() / self.costs[0].mean() - 1):+.2f} % off. On this machine a sample takes "
            f"{times.median:.2g} us (median), {times.longest:.0f} us at most, and a reset {times.longest_reset:.0f} us."
        )


def compare(
    folder: Path,
    loop: Loop,
    controller: Controller,
    split: Split,
    episodes: int,
    toolchain: Toolchain | None = None,
    flags: tuple[str, ...] = (),
) -> Agreement:
    """Run controller and program side by side on the first scenarios of a split.

    Args:
        folder: With the sources.
        loop: That they were made from.
        controller: The same in Python.
        split: Whose scenarios.
        episodes: How many.
        toolchain: To compile and run with; by default this machine's.
        flags: More for the compiler.

    Raises:
        ValueError: If there is no compiler, or the sources do not compile.
    """
    python = rollout(controller, episodes, **split.arguments(slice(episodes)))
    return agreement(folder, loop, python, split, episodes, toolchain, flags)


def agreement(
    folder: Path,
    loop: Loop,
    python: Recording,
    split: Split,
    episodes: int,
    toolchain: Toolchain | None = None,
    flags: tuple[str, ...] = (),
) -> Agreement:
    """Run a program on the scenarios that the controller has been recorded on, see `compare`."""
    with program_for(folder, loop, split, episodes, toolchain, flags) as program:
        compiled = rollout(program, episodes, **split.arguments(slice(episodes)))
        times = program.times()
    length = min(len(python.torque), len(compiled.torque))
    a, b = python.torque[:length], compiled.torque[:length]
    same = (a == b) | (np.isnan(a) & np.isnan(b))
    largest = float(np.nanmax(np.abs(a - b), initial=0.0))
    return Agreement(same.size, int(same.sum()), largest, (python.cost, compiled.cost), times)


def program_for(
    folder: Path, loop: Loop, split: Split, episodes: int, toolchain: Toolchain | None, flags: tuple[str, ...]
) -> InTheLoop:
    """Compile a program for the first scenarios of a split, and start it; see `compare`."""
    counts = int(split.settings.get("encoder_counts", ENCODER_COUNTS))
    moves, limit = split.moves[:episodes], loop.params.torque_limit
    return InTheLoop(folder, loop.name, moves, limit, toolchain or here(), counts, flags)
