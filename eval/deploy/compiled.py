"""Generated sources, compiled on this machine and called from Python."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

WARNINGS = ("-Wall", "-Wextra", "-Wpedantic", "-Werror")
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", *WARNINGS)
"""How generated sources are compiled."""

_SIZE = """#include "{name}.h"
size_t size_of_state(void);
size_t size_of_state(void) {{ return sizeof({name}); }}
"""


def compiler() -> str:
    """Find a C compiler: that of the environment variable CC, cc, gcc or clang.

    Raises:
        ValueError: If there is none.
    """
    named = os.environ.get("CC")
    for name in [named] if named else ["cc", "gcc", "clang"]:
        if found := shutil.which(name):
            return found
    looked = f"CC={named!r} is not there" if named else "neither cc, gcc nor clang is there"
    raise ValueError(f"no C compiler: {looked}. Install one, name it in CC, or export with --no-check")


def build(command: list[str]) -> None:
    """Run a compiler.

    Raises:
        ValueError: If it fails; with its first lines.
    """
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise ValueError(f"{' '.join(command)} failed:\n" + "\n".join(done.stderr.splitlines()[:20]))


class Move(ctypes.Structure):
    """A move, as the C functions take it, in double precision."""

    _fields_ = [(name, ctypes.c_double) for name in ("start", "goal", "duration", "ramp_time")]


class SingleMove(ctypes.Structure):
    """The same in single precision."""

    _fields_ = [(name, ctypes.c_float) for name in ("start", "goal", "duration", "ramp_time")]


class CompiledController:
    """One arm's controller in C.

    Args:
        folder: With the sources.
        name: Of the controller.
        single: Whether it computes in single precision.
        flags: More for the compiler.
    """

    def __init__(self, folder: Path, name: str, single: bool = False, flags: tuple[str, ...] = ()) -> None:
        with tempfile.TemporaryDirectory() as made:
            library = Path(made) / "controller.so"
            size = Path(made) / "size.c"
            size.write_text(_SIZE.format(name=name))
            precision = ("-DBELTARM_SINGLE",) if single else ()
            files = [str(folder / f"{name}.c"), str(size), "-I", str(folder), "-o", str(library), "-lm"]
            build([compiler(), *FLAGS, *precision, *flags, "-shared", "-fPIC", *files])
            loaded = ctypes.CDLL(str(library))
        loaded.size_of_state.restype = ctypes.c_size_t
        self._move = SingleMove if single else Move
        self._init, self._reset, self._step = (loaded[f"{name}_{verb}"] for verb in ("init", "reset", "step"))
        self._step.restype = ctypes.c_float if single else ctypes.c_double
        for function in (self._init, self._step):
            function.argtypes = [ctypes.c_void_p, ctypes.c_int32]
        self._reset.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int32]
        self.state = ctypes.create_string_buffer(loaded.size_of_state())
        self._library = loaded

    def init(self, counts_per_turn: int) -> None:
        """Set up for an encoder."""
        self._init(self.state, counts_per_turn)

    def reset(self, move: tuple[float, float, float, float], count: int) -> None:
        """Begin a move: start, goal [rad], duration, ramp time [s]."""
        self._reset(self.state, ctypes.byref(self._move(*map(float, move))), count)

    def step(self, count: int) -> float:
        """Torque of a sample [N m]."""
        return float(self._step(self.state, count))
