"""Software in the loop: the generated sources, compiled, as a controller of simulated arms, over a pipe."""

from __future__ import annotations

import contextlib
import subprocess
import tempfile
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

import numpy as np

from beltarm_env.arrays import Flags, Floats, Integers, Singles
from beltarm_env.observation import index, scales
from eval.deploy.building import Toolchain

_ANGLE = index("motor_angle")
_ANGLE_SCALE = scales()[_ANGLE]


def counts_of(observation: Singles, resolution: float) -> Integers:
    """Counts of the encoders that observations are of, shape (n,); resolution in rad per count."""
    return np.rint(observation[:, _ANGLE] * _ANGLE_SCALE / resolution).astype(np.intp)


class StepTimes(NamedTuple):
    """Time per sample of one arm [us]."""

    samples: int
    median: float
    high: float  # 99th percentile
    longest: float
    longest_reset: float


class InTheLoop:
    """A generated controller as a `Controller`: from an observation it takes the encoder's count and nothing else.

    Args:
        folder: With the sources.
        name: Of the controller.
        moves: Asked of the arms: start, goal [rad], duration, ramp time [s]; shape (n, 4).
        torque_limit: Of the arms [N m].
        toolchain: To compile and run with.
        counts_per_turn: Of their encoders.
        flags: More for the compiler: `-DBELTARM_SINGLE`, sanitizers.

    Raises:
        ValueError: If the sources do not compile, or the program refuses to run.
    """

    def __init__(
        self,
        folder: Path,
        name: str,
        moves: Floats,
        torque_limit: float,
        toolchain: Toolchain,
        counts_per_turn: int,
        flags: tuple[str, ...] = (),
    ) -> None:
        self._limit, self._moves = torque_limit, moves
        self._quantum = 2 * np.pi / counts_per_turn
        self._made = tempfile.TemporaryDirectory()
        program = Path(self._made.name) / name
        try:
            toolchain.build([folder / f"{name}.c", folder / "in_the_loop.c"], program, *flags)
        except BaseException:
            self._made.cleanup()
            raise
        command = [*toolchain.runner, str(program)]
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True)
        try:
            self._say(f"arms {len(moves)} {counts_per_turn}")
            self._answer()
        except BaseException:
            self.__exit__(None, None, None)
            raise

    def predict(
        self, observation: Singles, state: Any = None, episode_start: Flags | None = None, deterministic: bool = True
    ) -> tuple[Singles, Any]:
        """Torque over its limit, shape (n, 1), see `Controller`; the memory is in the program."""
        counts = counts_of(observation, self._quantum)
        begins = np.ones(len(counts), np.bool_) if state is None else episode_start
        torques = self.torques(counts, begins)
        return (torques / self._limit).astype(np.float32)[:, None], True

    def torques(self, counts: Integers, begins: Flags | None = None) -> Floats:
        """Torques [N m] for the counts of the encoders, shape (n,); of arms that begin a move it is the first."""
        for arm in [] if begins is None else np.flatnonzero(begins):
            move = " ".join(f"{number:.17g}" for number in self._moves[arm])
            self._say(f"reset {arm} {move} {counts[arm]}")
        self._say(f"step {' '.join(map(str, counts))}")
        return np.array(self._answer(), np.float64)

    def times(self) -> StepTimes:
        """Times of all samples so far."""
        self._say("times")
        samples, *rest = self._answer()
        return StepTimes(int(samples), *map(float, rest))

    def _say(self, line: str) -> None:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(line + "\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            raise self._ended() from None

    def _answer(self) -> list[str]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise self._ended()
        return line.split()

    def _ended(self) -> ValueError:
        assert self._process.stderr is not None
        said = self._process.stderr.read().strip()
        return ValueError(said or f"the program has ended, with status {self._process.wait()}")

    def __enter__(self) -> Self:
        """Return the controller."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the program."""
        for stream in (self._process.stdin, self._process.stdout, self._process.stderr):
            if stream is not None:
                with contextlib.suppress(BrokenPipeError):
                    stream.close()
        self._process.wait()
        self._made.cleanup()
