"""What all tests need."""

from __future__ import annotations

import contextlib
import gc
import io
import os
import signal

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read as numpy is imported; a worker per core keeps all cores busy
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")

import properties  # registers the profiles before pytest looks for the one it is told
import pytest
from hypothesis import seed, settings

from beltarm_env.jit import cache

gc.disable()  # until tests run: to look for garbage among all that collection makes takes a quarter of its time

settings.load_profile("suite")
assert properties.FUZZ != settings.get_current_profile_name()

with contextlib.redirect_stderr(io.StringIO()):
    cache.announce()  # which it does once: an empty cache adds no line to what commands say within this process

LONG = tuple(
    f"test_{name}"
    for name in (
        "compare",
        "export",
        "jit",
        "pairs",
        "ray",
        "recipes",
        "scripts",
        "training",
        "tune",
        "vector_env",
        "watch",
    )
)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--slow", action="store_true", help="run the tests that are marked slow, too")
    parser.addoption("--seeds", default="", help="run each property test under these seeds, with commas between")


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Call a property test under each of the seeds, if some are given; the error of one that fails says which."""
    seeds = [int(word) for word in str(pyfuncitem.config.getoption("--seeds")).split(",") if word]
    if not seeds or not getattr(pyfuncitem.obj, "is_hypothesis_test", False):
        return None
    arguments = {name: pyfuncitem.funcargs[name] for name in pyfuncitem._fixtureinfo.argnames}
    for given in seeds:
        seed(given)(pyfuncitem.function)
        try:
            pyfuncitem.obj(**arguments)
        except BaseException as error:
            error.add_note(f"with the seed {given}")
            raise
    return True


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what is slow, unless it is asked for or named, and run the longest files first.

    A worker that begins a long file last leaves the other one without work.
    """
    items.sort(key=lambda item: item.path.stem not in LONG)
    if not config.getoption("--slow") and not any("::" in word for word in config.args):
        config.hook.pytest_deselected(items=[item for item in items if item.get_closest_marker("slow")])
        items[:] = [item for item in items if not item.get_closest_marker("slow")]


def pytest_collection_finish() -> None:
    """Look for garbage from here on, but not among what all tests share."""
    gc.freeze()
    gc.enable()


signal.signal(signal.SIGINT, signal.default_int_handler)
"""Where the tests run in the background, Ctrl-C is ignored, and what they start would inherit that."""
