"""Calls of somebody else's code in a process of its own, whose end is no more than a failure of the call.

The process is kept for later calls of the same owner, since to start one takes seconds.
"""

from __future__ import annotations

import atexit
import os
import pickle
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeVar

from baselines.engines.parallel import BrokenOff, Channel, Failure, attempt, end_with_parent, pickled

Result = TypeVar("Result")
_POLL = 0.1  # [s]
_SIZE, _AT_ONCE = 8, 1 << 20  # bytes that tell how many follow, and those that are read at once
_LAST_WORDS = 1.0  # time that a process which has closed its connection has to end [s]


def run_isolated(call: Callable[[], Result], owner: str, limit: float) -> Result:
    """Return what a call returns, or raise what it raises, in a process that runs nothing but calls of its owner.

    Args:
        call: Picklable.
        owner: Whose code it is.
        limit: Time that the call may take [s].

    Raises:
        BrokenOff: If the process ended before the call did, or the call took longer and was ended.
    """
    global _kept
    if _kept is not None and _kept.owner != owner:
        _kept.end()
        _kept = None
    process = _kept = _kept or _Process(owner)
    try:
        outcome = process.run(call, limit)
    except BaseException:  # Ctrl-C too
        process.end()
        _kept = None
        raise
    if isinstance(outcome, Failure):
        raise outcome.error
    return outcome


class _Process:
    """Process of an owner, in a session of its own: a terminal's Ctrl-C does not reach it."""

    def __init__(self, owner: str) -> None:
        self.owner = owner
        self._connection, theirs = Pipe()
        begin = f"import sys; sys.path[:] = {sys.path!r}; from {__name__} import serve; serve({theirs.fileno()})"
        self._child = subprocess.Popen(
            [sys.executable, "-c", begin], stdin=subprocess.DEVNULL, pass_fds=[theirs.fileno()], start_new_session=True
        )
        theirs.close()
        atexit.register(self.end)

    def run(self, call: Callable[[], Any], limit: float) -> Any:
        """Return the result or failure of a call; the time begins when all that it needs is imported."""
        with suppress(BrokenPipeError):  # it has ended meanwhile, as is seen next
            self._connection.send(call)
        self._receive()
        return self._receive(limit)

    def _receive(self, limit: float = float("inf")) -> Any:
        deadline = time.monotonic() + limit
        try:
            size = int.from_bytes(self._read(_SIZE, deadline), "big")
            return pickle.loads(self._read(size, deadline))
        except TimeoutError:
            raise BrokenOff(f"it took longer than {limit:g} s, and was ended") from None
        except Exception:  # what comes may be anything: somebody else's code has the handle too
            with suppress(subprocess.TimeoutExpired):
                self._child.wait(_LAST_WORDS)
            raise BrokenOff(self._cause()) from None

    def _read(self, count: int, deadline: float) -> bytes:
        """Read so many bytes, of which some may come and the rest never.

        Raises:
            TimeoutError: If they do not come in time.
            EOFError: If the process has ended, or closed the connection.
        """
        data = bytearray()
        while len(data) < count:
            if self._connection.poll(_POLL):
                part = os.read(self._connection.fileno(), min(count - len(data), _AT_ONCE))
                if not part:
                    raise EOFError
                data += part
            elif self._child.poll() is not None and not self._connection.poll():
                raise EOFError
            if len(data) < count and time.monotonic() > deadline:
                raise TimeoutError
        return bytes(data)

    def _cause(self) -> str:
        """Why nothing came."""
        status = self._child.returncode
        if status is None:
            return "its process closed the connection over which its results come, or wrote into it"
        if status >= 0:
            return f"its process ended with exit status {status} before it was done"
        name, memory = signal.strsignal(-status), ", for want of memory perhaps" if status == -signal.SIGKILL else ""
        return f"its process was ended by signal {-status} ({name}){memory}"

    def end(self) -> None:
        """End the process, and those that it began."""
        atexit.unregister(self.end)
        with suppress(ProcessLookupError):
            os.killpg(self._child.pid, signal.SIGKILL)
        self._child.wait()
        self._connection.close()


_kept: _Process | None = None


# In the other process


def serve(handle: int) -> None:
    """Run calls that come over a connection, one after the other, as long as there is somebody at its other end."""
    end_with_parent()
    with suppress(OSError):  # on Linux: who takes all memory is ended first, not the comparison
        Path("/proc/self/oom_score_adj").write_text("1000", encoding="ascii")
    connection = Connection(handle)
    with suppress(EOFError, OSError):
        while True:
            call = connection.recv()
            _send(handle, pickle.dumps("begun"))
            _send(handle, pickled(attempt(lambda _, call=call: call(), Channel())))


def _send(handle: int, data: bytes) -> None:
    left = memoryview(len(data).to_bytes(_SIZE, "big") + data)
    while left:
        left = left[os.write(handle, left) :]
