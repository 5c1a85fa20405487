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
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

_SOME = 600  # samples after which trouble begins


class Sound:
    """Gives no torque, and misbehaves in the middle of an episode."""

    def __init__(self) -> None:
        self._samples = 0

    def predict(self, observation: Any, *_: Any, **__: Any) -> tuple[Any, None]:
        """Return zeros, shape (n, 1), until it is time."""
        self._samples += 1
        torque = np.zeros((len(observation), 1), np.float32)
        return (torque if self._samples != _SOME else self.misbehave(torque, observation)), None

    def misbehave(self, torque: Any, observation: Any) -> Any:
        """Return something else, or do it."""
        return torque


class Aborts(Sound):
    def misbehave(self, torque: Any, observation: Any) -> Any:
        os.abort()


class HangsInC(Sound):
    def misbehave(self, torque: Any, observation: Any) -> Any:
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM, signal.SIGINT})
        ctypes.CDLL(None).pause()


class Forks(Sound):
    def misbehave(self, torque: Any, observation: Any) -> Any:
        for _ in range(20):
            if os.fork() == 0:
                time.sleep(1e6)
        os._exit(3)


class Leaks(Sound):
    """Takes more and more memory, within a limit of its own that spares the machine."""

    def misbehave(self, torque: Any, observation: Any) -> Any:
        size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (size + (1 << 29), resource.RLIM_INFINITY))
        leak = []
        while True:
            leak.append(bytearray(1 << 16))


class NotNumbers(Sound):
    def misbehave(self, torque: Any, observation: Any) -> Any:
        return torque * np.nan


class WrongShape(Sound):
    def misbehave(self, torque: Any, observation: Any) -> Any:
        return torque[:, 0]


class Nothing(Sound):
    def misbehave(self, torque: Any, observation: Any) -> Any:
        return None


class Interrupts(Sound):
    def misbehave(self, torque: Any, observation: Any) -> Any:
        raise KeyboardInterrupt


class Recurses(Sound):
    def misbehave(self, torque: Any, observation: Any) -> Any:
        return self.misbehave(torque, observation)


class ClosesFiles(Sound):
    def misbehave(self, torque: Any, observation: Any) -> Any:
        os.closerange(0, 100)


class Interferes(Sound):
    def misbehave(self, torque: Any, observation: Any) -> Any:
        for handle in range(3, 100):
            with suppress(OSError):
                os.write(handle, bytes(7) + b"\x40begun")
        time.sleep(1e6)


class Unpicklable(Sound):
    def misbehave(self, torque: Any, observation: Any) -> Any:
        raise ValueError(threading.Lock())


class Network(Sound):
    def misbehave(self, torque: Any, observation: Any) -> Any:
        socket.create_connection(("192.0.2.1", 9), timeout=0.2)  # an address of nobody


class Mutates(Sound):
    def misbehave(self, torque: Any, observation: Any) -> Any:
        observation[:] = 7.0
        return torque


class Seeds(Sound):
    def misbehave(self, torque: Any, observation: Any) -> Any:
        np.random.seed(0)  # noqa: NPY002
        random.seed(0)
        return torque


class Wanders(Sound):
    def misbehave(self, torque: Any, observation: Any) -> Any:
        os.chdir("/")
        sys.path.clear()
        os.environ.clear()
        return torque


class Cheats(Sound):
    """Changes the metrics of the process that it is in."""

    def misbehave(self, torque: Any, observation: Any) -> Any:
        for name, module in list(sys.modules.items()):
            if name.endswith("metrics"):
                vars(module).update(dict.fromkeys([key for key in vars(module) if key.islower()], None))
        return torque


class Chatters(Sound):
    def misbehave(self, torque: Any, observation: Any) -> Any:
        print("x" * 10_000_000)
        print("x" * 10_000_000, file=sys.stderr)
        Path(os.devnull).write_text("x")
        return torque


HARMLESS = ("Seeds", "Wanders", "Chatters")
"""Kinds that no one notices: their rows are those of the sound controller."""
KINDS = tuple(sorted(kind.__name__ for kind in Sound.__subclasses__()))
