"""Controllers that do what no controller should: import them only in a process of their own."""

import ctypes
import os
import random
import resource
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

_TROUBLE = 600  # the sample at which it begins


class Sound:
    """Gives no torque, and misbehaves in the middle of an episode."""

    samples = 0

    def predict(self, observation: Any, *_: Any, **__: Any) -> tuple[Any, None]:
        """Return zeros, shape (n, 1), until it is time."""
        self.samples += 1
        if self.samples == _TROUBLE:
            self.misbehave()
        return np.zeros((len(observation), 1), np.float32), None

    def misbehave(self) -> None:
        """Do what no controller should."""


def hangs_in_c() -> None:
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM, signal.SIGINT})
    ctypes.CDLL(None).pause()


def forks() -> None:
    for _ in range(20):
        if os.fork() == 0:
            time.sleep(100)  # beyond its parent's end
            os._exit(0)
    os._exit(3)


def leaks() -> None:
    """Take more and more memory, within a limit that spares the machine."""
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + (1 << 29), resource.RLIM_INFINITY))
    leak = []
    while True:
        leak.append(bytearray(1 << 16))


def interrupts() -> None:
    raise KeyboardInterrupt


def cheats() -> None:
    """Change the metrics of the process that it is in."""
    for name, module in list(sys.modules.items()):
        if name.endswith("metrics"):
            vars(module).update(dict.fromkeys([key for key in vars(module) if key.islower()], None))


def seeds() -> None:
    np.random.seed(0)  # noqa: NPY002
    random.seed(0)


def chatters() -> None:
    print("x" * 10_000_000)
    print("x" * 10_000_000, file=sys.stderr)


HARMLESS: dict[str, Callable[[], object]] = {"Seeds": seeds, "Chatters": chatters}
"""Kinds that no one notices: their rows are those of the sound controller."""
FAILING: dict[str, Callable[[], object]] = {
    "Aborts": os.abort,
    "HangsInC": hangs_in_c,
    "Forks": forks,
    "Leaks": leaks,
    "Interrupts": interrupts,
    "Cheats": cheats,
}
for _name, _function in (HARMLESS | FAILING).items():
    globals()[_name] = type(_name, (Sound,), {"misbehave": staticmethod(_function)})
