"""Waiting for other threads and processes."""

import time
from collections.abc import Callable


def until(true: Callable[[], object], patience: float = 60.0) -> None:
    """Wait for something that comes soon, or fail after a time [s]."""
    deadline = time.monotonic() + patience
    while not true():
        assert time.monotonic() < deadline
        time.sleep(1e-3)
