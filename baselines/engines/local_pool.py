"""Worker processes of joblib, with a mailbox for the messages of their tasks; `baselines.engines.parallel` is its face.

A worker that dies takes its pool with it, so the tasks that were under way are begun again, each alone in its pool:
what fails then has itself to blame, and is reported as broken off.

Workers take no signals; this process passes requests to stop on. Where it dies itself, tasks are asked to stop.
"""

from __future__ import annotations

import os
import pickle
import queue
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.managers import SyncManager
from typing import Any, Literal, NamedTuple

from joblib import Parallel, delayed, parallel_config
from joblib.externals.loky import get_reusable_executor
from joblib.externals.loky.backend import get_context
from joblib.externals.loky.backend import resource_tracker as loky_resource_tracker

from baselines.engines.task import BrokenOff, Channel, Failure, PolledStop, StopRequest, Task, attempt, pickled

_BACKEND = "loky"  # of joblib
_POLL = 0.1  # [s]
_GONE = (EOFError, OSError)
"""Errors of a call to the mailbox after the process that began the tasks has ended."""


class _Message(NamedTuple):
    """Message from a worker."""

    name: str  # of the task
    kind: Literal["began", "news", "outcome"]
    content: Any = None


class LocalPool:
    """Tasks in worker processes, in rounds: all of them, and after a death those that were under way, one by one."""

    def __init__(self, jobs: int, threads: int, stop: StopRequest, tell: Callable[[str, Any], object]) -> None:
        self._jobs = jobs
        self._threads = threads
        self._stop = stop
        self._tell = tell
        self._waiting: dict[str, Task[Any]] = {}
        self._begun = set[str]()

    def run(self, tasks: dict[str, Task[Any]]) -> Iterator[tuple[str, Any]]:
        """Yield the outcomes of all tasks."""
        self._waiting = tasks
        with _mailbox() as (inbox, asked):
            while self._waiting and not self._stop.made:
                suspect = next((name for name in self._waiting if name in self._begun), None)
                yield from self._round([suspect] if suspect else list(self._waiting), inbox, asked)
                if suspect in self._waiting and not self._stop.made:
                    del self._waiting[suspect]
                    yield suspect, Failure(_broken_off())
        yield from ((name, Failure(_broken_off())) for name in self._waiting if name in self._begun)

    def _round(self, names: list[str], inbox: Any, asked: Any) -> Iterator[tuple[str, Any]]:
        """Run some tasks, and yield the outcomes of those whose worker lives to tell.

        The thread that starts the workers blocks signals, which they inherit from their first instruction on.
        """
        calls = [_Call(name, self._waiting[name], inbox, asked, os.getcwd()) for name in names]
        dispatcher = _Dispatcher(calls, min(self._jobs, max(2, len(names))), self._threads)
        dispatcher.start()
        try:
            while True:
                if self._stop.made:
                    asked.set()
                over = not dispatcher.is_alive()
                try:
                    message: _Message = inbox.get(timeout=0 if over else _POLL)
                except queue.Empty:
                    if over:
                        break
                    continue
                if message.kind == "began":
                    self._begun.add(message.name)
                elif message.kind == "news":
                    self._tell(message.name, message.content)
                else:
                    del self._waiting[message.name]
                    yield message.name, pickle.loads(message.content)
        finally:
            before, threading.excepthook = threading.excepthook, _ignore_manager
            while dispatcher.is_alive():
                get_reusable_executor(reuse=True).shutdown(kill_workers=True)  # pyright: ignore[reportArgumentType]
                dispatcher.join(timeout=1)
            threading.excepthook = before
        if dispatcher.error is not None:
            raise dispatcher.error


def _ignore_manager(failure: threading.ExceptHookArgs) -> None:
    """Report a thread's exception, but for loky's manager: it may trip over workers that are killed under it."""
    if failure.thread is None or failure.thread.name != "ExecutorManagerThread":
        threading.__excepthook__(failure)


def _broken_off() -> BrokenOff:
    return BrokenOff("the process broke off, for want of memory perhaps")


class _Dispatcher(threading.Thread):
    """Hands calls to joblib; ends when all are done, or when a worker has died."""

    def __init__(self, calls: list[_Call], jobs: int, threads: int) -> None:
        super().__init__(daemon=True)
        self._calls = calls
        self._jobs = jobs
        self._threads = threads
        self.error: Exception | None = None

    def run(self) -> None:
        """Run all calls."""
        _block_signals()
        try:
            with parallel_config(backend=_BACKEND, inner_max_num_threads=self._threads):
                parallel = Parallel(n_jobs=self._jobs, batch_size=1, pre_dispatch="all")  # pyright: ignore[reportArgumentType]
                parallel(delayed(call)() for call in self._calls)
        except BrokenProcessPool:
            pass  # the pool begins again what has no outcome
        except Exception as error:
            self.error = error


def _block_signals() -> None:
    """Block signals in this thread, and in every process that it starts."""
    for tracker in (resource_tracker, loky_resource_tracker):
        tracker.ensure_running()  # as the start of a process does, unblocking signals where it is the first
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))


@contextmanager
def _mailbox() -> Iterator[tuple[Any, Any]]:
    """A queue of messages and an event for the request to stop, in a process of their own that outlives any worker."""
    manager = SyncManager(ctx=get_context(_BACKEND), shutdown_timeout=60)  # as it takes no signal to end
    starter = threading.Thread(target=lambda: (_block_signals(), manager.start(end_with_parent)))
    starter.start()
    starter.join()
    try:
        yield manager.Queue(), manager.Event()
    finally:
        manager.shutdown()


# In other processes


def end_with_parent() -> None:
    """End this process when the one that began it has ended; the mailbox's end is a request to stop to all tasks."""
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@dataclass(frozen=True)
class _Call:
    """Picklable call of a task with its channel, for a worker."""

    name: str
    task: Task[Any]
    inbox: Any
    asked: Any
    folder: str

    def __call__(self) -> None:
        """Run the task, unless a request to stop came first."""
        stop = PolledStop(self._is_asked)
        if stop.made:
            return
        os.chdir(self.folder)  # a worker of earlier tasks may be elsewhere
        self._put("began")
        outcome = attempt(self.task, Channel(lambda news: self._put("news", news), stop))
        # As bytes, which the mailbox passes on without importing what they are made of.
        self._put("outcome", pickled(outcome))

    def _is_asked(self) -> bool:
        """Whether a request to stop was made, or the process that began the task has ended."""
        try:
            return self.asked.is_set()
        except _GONE:
            return True

    def _put(self, kind: Literal["began", "news", "outcome"], content: Any = None) -> None:
        try:
            self.inbox.put(_Message(self.name, kind, content))
        except _GONE:  # nobody waits: the request to stop says so to the task, and after it the worker is of no use
            if kind == "outcome":
                os._exit(1)
