"""A cluster of Ray on this machine, for tests."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from baselines.engines import ray_cluster

ROOT = Path(__file__).resolve().parents[2]


@contextmanager
def local_cluster() -> Iterator[None]:
    """Begin a cluster of two cores, whose processes find the tests' own tasks; skip the test where Ray is missing."""
    pytest.importorskip("ray", reason="Ray is not installed: pip install 'beltarm-env[ray]'")
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("PYTHONPATH", f"{ROOT}:{ROOT / 'tests' / 'helpers'}")
        patched.setenv("RAY_worker_niceness", "0")  # else nothing is left for its workers on a machine that is busy
        with ray_cluster.connected(None, 2):
            yield
    for number, handler in before.items():
        signal.signal(number, handler)
