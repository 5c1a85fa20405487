"""What all tests need."""

import contextlib
import gc
import io
import os
import signal

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read as numpy is imported; a worker per core keeps all cores busy
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")

import properties  # noqa: F401  # registers the profiles before pytest looks for the one it is told
import pytest
from hypothesis import settings

from beltarm_env.engine import library

gc.disable()  # until tests run: to look for garbage among all that collection makes takes a quarter of its time

settings.load_profile("suite")

with contextlib.redirect_stderr(io.StringIO()):
    library.announce()  # which it does once: an empty cache adds no line to what commands say within this process

LONG = tuple(f"test_{name}" for name in ("vector_env", "tuning", "compare", "studies", "training", "cache", "program"))


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--slow", action="store_true", help="run the tests that are marked slow, too")


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
