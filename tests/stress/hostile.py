"""Controllers that do what no controller should: import them only in a process of their own."""

from __future__ import annotations

import ctypes
import os
import random
import resource
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

_TROUBLE = 600  # the sample at which it begins


class Sound:
    """Gives no torque, and misbehaves in the middle of an episode."""

    def __init__(self) -> None:
        self._samples = 0

    def predict(self, observation: Any, *_: Any, **__: Any) -> tuple[Any, None]:
        """Return zeros, shape (n, 1), until it is time."""
        self._samples += 1
        torque = np.zeros((len(observation), 1), np.float32)
        return (torque if self._samples != _TROUBLE else self.misbehave(torque, observation)), None

    def misbehave(self, torque: Any, observation: Any) -> Any:
        """Return something else, or do it."""
        return torque


def hangs_in_c(torque: Any, observation: Any) -> Any:
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM, signal.SIGINT})
    ctypes.CDLL(None).pause()


def forks(torque: Any, observation: Any) -> Any:
    for _ in range(20):
        if os.fork() == 0:
            time.sleep(1e6)
    os._exit(3)


def leaks(torque: Any, observation: Any) -> Any:
    """Take more and more memory, within a limit that spares the machine."""
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + (1 << 29), resource.RLIM_INFINITY))
    leak = []
    while True:
        leak.append(bytearray(1 << 16))


def interrupts(torque: Any, observation: Any) -> Any:
    raise KeyboardInterrupt


def recurses(torque: Any, observation: Any) -> Any:
    return recurses(torque, observation)


def interferes(torque: Any, observation: Any) -> Any:
    for handle in range(3, 100):
        with suppress(OSError):
            os.write(handle, bytes(7) + b"\x40begun")
    time.sleep(1e6)


def unpicklable(torque: Any, observation: Any) -> Any:
    raise ValueError(threading.Lock())


def mutates(torque: Any, observation: Any) -> Any:
    observation[:] = 7.0
    return torque


def cheats(torque: Any, observation: Any) -> Any:
    """Change the metrics of the process that it is in."""
    for name, module in list(sys.modules.items()):
        if name.endswith("metrics"):
            vars(module).update(dict.fromkeys([key for key in vars(module) if key.islower()], None))
    return torque


def seeds(torque: Any, observation: Any) -> Any:
    np.random.seed(0)  # noqa: NPY002
    random.seed(0)
    return torque


def wanders(torque: Any, observation: Any) -> Any:
    os.chdir("/")
    sys.path.clear()
    os.environ.clear()
    return torque


def chatters(torque: Any, observation: Any) -> Any:
    print("x" * 10_000_000)
    print("x" * 10_000_000, file=sys.stderr)
    return torque


HARMLESS: dict[str, Callable[[Any, Any], Any]] = {"Seeds": seeds, "Wanders": wanders, "Chatters": chatters}
"""Kinds that no one notices: their rows are those of the sound controller."""
FAILING: dict[str, Callable[[Any, Any], Any]] = {
    "Aborts": lambda torque, observation: os.abort(),
    "HangsInC": hangs_in_c,
    "Forks": forks,
    "Leaks": leaks,
    "NotNumbers": lambda torque, observation: torque * np.nan,
    "WrongShape": lambda torque, observation: torque[:, 0],
    "Nothing": lambda torque, observation: None,
    "Interrupts": interrupts,
    "Recurses": recurses,
    "ClosesFiles": lambda torque, observation: os.closerange(0, 100),
    "Interferes": interferes,
    "Unpicklable": unpicklable,
    "Network": lambda torque, observation: socket.create_connection(("192.0.2.1", 9), timeout=0.2),  # nobody's address
    "Mutates": mutates,
    "Cheats": cheats,
}
for _name, _function in (HARMLESS | FAILING).items():
    globals()[_name] = type(_name, (Sound,), {"misbehave": staticmethod(_function)})
