"""Software in the loop: exported sources, compiled, drive simulated arms over a pipe, and are compared with Python."""

import contextlib
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from baselines.reading import beginning
from beltarm_env.arrays import Flags, Floats, Integers, Singles
from beltarm_env.observation import index, scales
from beltarm_env.rollout import Controller, Recording, rollout
from beltarm_env.task.sensors import ENCODER_COUNTS
from eval.comparison.splits import Split
from eval.exports.compilers import Toolchain, native
from eval.exports.source import Loop

_ANGLE = index("motor_angle")
_ANGLE_SCALE = scales()[_ANGLE]
_HOLDS_PART = index("holds_part")


def counts_of(observation: Singles, resolution: float) -> Integers:
    """Counts of the encoders behind observations, shape (n,); resolution in rad per count."""
    return np.rint(observation[:, _ANGLE] * _ANGLE_SCALE / resolution).astype(np.intp)


class StepTimes(NamedTuple):
    """Time of one arm per sample [us]."""

    samples: int
    median: float
    high: float  # 99th percentile
    longest: float
    longest_reset: float


class InTheLoop:
    """An exported controller as a `Controller` that sees counts alone and, where a move begins, `holds_part`.

    Args:
        folder: Folder with the sources of the controller.
        loop: What they are of, with the torque limit of the arms.
        moves: Moves of the arms: start, goal [rad], duration, ramp time [s]; shape (n, 4), or (moves, n, 4) of several.
        toolchain: Compiler, and what runs its programs.
        counts_per_turn: Counts of the encoders.

    Raises:
        ValueError: If the sources do not compile, or the program refuses to run.
    """

    profile = "trapezoid"  # of the reference that all exported programs compute

    def __init__(
        self,
        folder: Path,
        loop: Loop,
        moves: Floats,
        toolchain: Toolchain,
        counts_per_turn: int,
    ) -> None:
        self._limit, self._moves, name = loop.params.torque_limit, moves.reshape(-1, *moves.shape[-2:]), loop.name
        self._numbers = np.zeros(moves.shape[-2], np.intp)  # of the move that each arm is in
        self._quantum = 2 * np.pi / counts_per_turn
        with contextlib.ExitStack() as stack:
            program = Path(stack.enter_context(tempfile.TemporaryDirectory())) / name
            toolchain.build([folder / f"{name}.c", folder / "in_the_loop.c"], program)
            command, pipe = [*toolchain.runner, str(program)], subprocess.PIPE
            self._process: Any = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True)
            stack.callback(self._process.communicate)
            self._ask(f"arms {len(self._numbers)} {counts_per_turn}")
            self._ends = stack.pop_all()

    def predict(
        self, observation: Singles, state: Any = None, episode_start: Flags | None = None, deterministic: bool = True
    ) -> tuple[Singles, Any]:
        """Torque over its limit, shape (n, 1), see `Controller`; the memory is in the program."""
        counts = counts_of(observation, self._quantum)
        begins = beginning(state, episode_start, observation)
        anew = begins if state is None else np.asarray(episode_start, np.bool_)
        self._numbers = np.where(anew, 0, self._numbers + begins)
        torques = self.torques(counts, begins, observation[:, _HOLDS_PART] > 0)
        return (torques / self._limit).astype(np.float32)[:, None], True

    def torques(self, counts: Integers, begins: Flags, holding: Flags) -> Floats:
        """Torques [N m] for the counts of the encoders, shape (n,).

        Args:
            counts: Of the encoders, shape (n,).
            begins: Which arms begin a move, whose torque is its first, shape (n,).
            holding: Which grippers hold a part, shape (n,); counts where a move begins.
        """
        lines = []
        for arm in np.flatnonzero(begins):
            number = self._numbers[arm]
            move = " ".join(f"{value:.17g}" for value in np.append(self._moves[number, arm], holding[arm]))
            lines.append(f"{'next' if number else 'reset'} {arm} {move} {counts[arm]}")
        return np.array(self._ask(*lines, f"step {' '.join(map(str, counts))}"), np.float64)

    def times(self) -> StepTimes:
        """Times of all samples so far."""
        samples, *rest = self._ask("times")
        return StepTimes(int(samples), *map(float, rest))

    def _ask(self, *lines: str) -> list[str]:
        """Write lines, and read the words that answer the last."""
        with contextlib.suppress(BrokenPipeError):  # it has ended, and does not answer
            print(*lines, sep="\n", file=self._process.stdin, flush=True)
        if answer := self._process.stdout.readline():
            return answer.split()
        message = self._process.communicate()[1].strip()
        raise ValueError(message or f"the program has ended, with status {self._process.returncode}")

    def __enter__(self) -> Self:
        """Return the controller."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the program."""
        self._ends.close()


@dataclass(frozen=True)
class Agreement:
    """How far a program agrees with the controller, in closed loop on the scenarios of a split."""

    samples: int
    equal: int  # samples whose torques are equal to the last bit
    costs: tuple[Floats, Floats]  # of the controller, of the program; shape (episodes,)
    times: StepTimes

    def words(self) -> str:
        """Sentences on equality, cost and time."""
        times, (python, compiled) = self.times, self.costs
        return (
            f"{self.equal} of {self.samples} torques are equal to the last bit, and the mean cost is "
            f"{100 * (compiled.mean() / python.mean() - 1):+.2f} % off. On this machine a sample takes "
            f"{times.median:.2g} us (median), {times.longest:.0f} us at most, and a reset {times.longest_reset:.0f} us."
        )


def compare(
    folder: Path,
    loop: Loop,
    python: Controller | Recording,
    split: Split,
    episodes: int,
    toolchain: Toolchain | None = None,
) -> Agreement:
    """Run the program in a folder beside its controller on the first scenarios of a split.

    `python` is the same controller in Python, or what was recorded of it on these scenarios. The compiler is by default
    this machine's.

    Raises:
        ValueError: If there is no compiler, or the sources do not compile.
    """
    arguments = split.arguments(slice(episodes))
    recording = python if isinstance(python, Recording) else rollout(python, episodes, **arguments)
    moves = recording.moves.reshape(recording.num_moves, -1, 4)
    with program_for(folder, loop, split, moves, toolchain) as program:
        compiled = rollout(program, episodes, **arguments)
        times = program.times()
    a, b = recording.torque, compiled.torque
    same = (a == b) | (np.isnan(a) & np.isnan(b))
    return Agreement(same.size, int(same.sum()), (recording.cost, compiled.cost), times)


def program_for(folder: Path, loop: Loop, split: Split, moves: Floats, toolchain: Toolchain | None = None) -> InTheLoop:
    """Compile a program for moves of the first scenarios of a split and start it; see `InTheLoop` and `compare`."""
    counts = int(split.settings.get("encoder_counts", ENCODER_COUNTS))
    return InTheLoop(folder, loop, moves, toolchain or native(), counts)
