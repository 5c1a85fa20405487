"""Tests of mutants: a process that is told mutants of one module, and says of each whether a test fails.

Nothing is written to the checkout: a mutant is imported in the module's place, by a process of its own. That one is
forked from a process which has loaded other people's packages, for they take seconds to load, and nothing of this
project. Compiled kernels would take half a minute to be compiled anew: here the same code runs as plain Python.
"""

from __future__ import annotations

import builtins
import contextlib
import json
import math
import os
import resource
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.machinery import SourceFileLoader
from importlib.util import find_spec
from pathlib import Path
from subprocess import PIPE, Popen
from types import CodeType

_ROOT = Path(__file__).resolve().parents[2]
_PLAIN = {"NUMBA_DISABLE_JIT": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
_OPTIONS = (
    *("-x", "-q", "--slow", "-p", "no:cacheprovider", "--hypothesis-profile", "mutants"),
    *("-W", "ignore::pytest.PytestAssertRewriteWarning"),  # pytest would like to load hypothesis itself
)
_PATIENCE = 30.0
_CAUGHT_INSTEAD = "CosmicRayTestingException"  # of what a mutant no longer catches
_LOADED = (
    *("numba", "scipy.integrate", "scipy.stats", "sympy", "torch", "gymnasium", "hypothesis", "jsonschema", "pytest"),
    *("control", "matplotlib.pyplot", "stable_baselines3"),
)


@contextmanager
def trials(module: str, tests: Sequence[str]) -> Iterator[Callable[[str, float], float | None]]:
    """Start the process that tries mutants of a module; it ends with the `with`.

    Args:
        module: Path of the module from the root of the checkout.
        tests: What pytest is told to run.

    Yields:
        A function of a source of the module and a limit of CPU time [s]: the CPU time in which all tests pass with it
        [s]; None if one fails, or they take longer.
    """
    command = [sys.executable, "-c", "from eval.mutation.trial import serve; serve()", module, *tests]
    environment = {**os.environ, **_PLAIN, "PYTHONPATH": str(_ROOT)}
    with Popen(command, cwd=_ROOT, env=environment, stdin=PIPE, stdout=PIPE, text=True) as server:
        assert server.stdin is not None and server.stdout is not None
        ask, answers = server.stdin, server.stdout

        def seconds(source: str, limit: float) -> float | None:
            print(json.dumps({"source": source, "limit": limit}), file=ask, flush=True)
            return json.loads(answers.readline())

        try:
            yield seconds
        finally:
            server.kill()


def serve() -> None:
    """Answer what `trials` asks: a line of JSON for each mutant, on stdin, by one on stdout."""
    path, tests = Path(sys.argv[1]).resolve(), sys.argv[2:]
    for name in _LOADED:
        if find_spec(name):
            import_module(name)
    for line in sys.stdin:
        asked = json.loads(line)
        print(json.dumps(_seconds(path, asked["source"], tests, asked["limit"])), flush=True)


def _seconds(path: Path, source: str, tests: list[str], limit: float) -> float | None:
    """Run tests on a mutant, one after the other until one fails.

    Args:
        path: Of the module.
        source: Of the mutant.
        tests: What pytest is told to run.
        limit: CPU time that they are given [s]: a busy machine kills no mutants. Tests that wait for something have
            `_PATIENCE` times as long.

    Returns:
        CPU time that they took [s]; None if one failed, or they did not end.
    """
    child = os.fork()
    if child == 0:
        _test(path, source, tests, limit)
    ends = time.monotonic() + _PATIENCE * limit
    done, status, usage = os.wait4(child, os.WNOHANG)
    while not done and time.monotonic() < ends:
        time.sleep(0.01)
        done, status, usage = os.wait4(child, os.WNOHANG)
    if not done:
        with contextlib.suppress(ProcessLookupError):  # it may not have its own group yet
            os.killpg(child, signal.SIGKILL)
        os.kill(child, signal.SIGKILL)
        os.wait4(child, 0)
    return usage.ru_utime + usage.ru_stime if done and status == 0 else None


def _test(path: Path, source: str, tests: list[str], limit: float) -> None:
    os.setsid()
    resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(limit), math.ceil(limit) + 1))
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(nowhere, stream)
    try:
        import pytest

        setattr(builtins, _CAUGHT_INSTEAD, type(_CAUGHT_INSTEAD, (Exception,), {}))
        _import_from(path, source)
        os._exit(pytest.main([*_OPTIONS, *tests]))
    finally:
        os._exit(1)


def _import_from(path: Path, source: str) -> None:
    """Import another source in a module's place."""
    get_code = SourceFileLoader.get_code

    def mutated(self: SourceFileLoader, fullname: str) -> CodeType | None:
        if Path(self.path).resolve() == path:
            return compile(source, self.path, "exec", dont_inherit=True)
        return get_code(self, fullname)

    SourceFileLoader.get_code = mutated
