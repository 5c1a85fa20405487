"""Tests of mutants: a process that is told mutants of one module, and says of each whether a test fails.

Nothing is written to the checkout: a mutant is imported in the module's place, by a process of its own. That one is
forked from a process which has loaded other people's packages, for they take seconds to load, and nothing of this
project. Compiled kernels would take half a minute to be compiled anew: here the same code runs as plain Python.
"""

from __future__ import annotations

import builtins
import contextlib
import json
import os
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
    *("-x", "-q", "-p", "no:cacheprovider", "--hypothesis-profile", "mutants"),
    *("-W", "ignore::pytest.PytestAssertRewriteWarning"),  # pytest would like to load hypothesis itself
)
_CAUGHT_INSTEAD = "CosmicRayTestingException"  # of what a mutant no longer catches
_LOADED = (
    *("numba", "scipy.integrate", "scipy.stats", "sympy", "torch", "gymnasium", "hypothesis", "jsonschema", "pytest"),
    *("control", "matplotlib.pyplot", "stable_baselines3"),
)


@contextmanager
def trials(module: str, tests: Sequence[str]) -> Iterator[Callable[[str, float], bool]]:
    """Start the process that tries mutants of a module; it ends with the `with`.

    Args:
        module: Path of the module from the root of the checkout.
        tests: What pytest is told to run.

    Yields:
        A function of a source of the module and a time [s]: whether all tests pass with it, and within that time.
    """
    command = [sys.executable, "-c", "from eval.mutation.trial import serve; serve()", module, *tests]
    environment = {**os.environ, **_PLAIN, "PYTHONPATH": str(_ROOT)}
    with Popen(command, cwd=_ROOT, env=environment, stdin=PIPE, stdout=PIPE, text=True) as server:
        assert server.stdin is not None and server.stdout is not None
        ask, answers = server.stdin, server.stdout

        def survives(source: str, limit: float) -> bool:
            print(json.dumps({"source": source, "limit": limit}), file=ask, flush=True)
            return answers.readline().strip() == "survived"

        try:
            yield survives
        finally:
            server.kill()


def serve() -> None:
    """Answer what `trials` asks: a line of JSON for each mutant, on stdin, by a word on stdout."""
    path, tests = Path(sys.argv[1]).resolve(), sys.argv[2:]
    for name in _LOADED:
        if find_spec(name):
            import_module(name)
    for line in sys.stdin:
        asked = json.loads(line)
        print(_outcome(path, asked["source"], tests, asked["limit"]), flush=True)


def _outcome(path: Path, source: str, tests: list[str], limit: float) -> str:
    """Run tests on a mutant, one after the other until one fails.

    Args:
        path: Of the module.
        source: Of the mutant.
        tests: What pytest is told to run.
        limit: Time that they are given [s].
    """
    child = os.fork()
    if child == 0:
        _test(path, source, tests)
    ends, status = time.monotonic() + limit, None
    while status is None and time.monotonic() < ends:
        done, found = os.waitpid(child, os.WNOHANG)
        status = found if done else None
        time.sleep(0.01)
    if status is None:
        with contextlib.suppress(ProcessLookupError):  # it may not have its own group yet
            os.killpg(child, signal.SIGKILL)
        with contextlib.suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
    return "survived" if status == 0 else "killed"


def _test(path: Path, source: str, tests: list[str]) -> None:
    os.setsid()
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
