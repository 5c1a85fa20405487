"""Tasks side by side, with news, results as they come, and requests to stop.

    task(channel) -> result        a picklable callable, which may be called again

A task reports news and looks for a request to stop through its `Channel`. Whatever it raises becomes the `Failure` of
this task alone. A task whose process dies is begun again: trainings and searches go on from what they have saved.

The processes are joblib's (loky), or Ray's (`baselines.engines.cluster`); both take a call and return a future. What
joblib has on top of them, `Parallel`, ends all tasks where one process dies, loses results that nobody has taken yet,
and hears no news while it waits.
"""

from __future__ import annotations

import os
import pickle
import queue
import signal
import threading
import time
import traceback
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import resource_tracker
from multiprocessing.managers import SyncManager
from typing import Any, Literal, NamedTuple, TypeVar

from joblib import cpu_count
from joblib.externals.loky import get_reusable_executor
from joblib.externals.loky.backend import get_context
from joblib.externals.loky.backend import resource_tracker as loky_resource_tracker

from baselines.tools.command import require_bounds

Result = TypeVar("Result")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Variables that limit the threads of numerical libraries."""
default_jobs = cpu_count
"""Number of cores that this process may use."""
_POLL, _LOOK = 0.1, 0.5  # time between looks for what has ended, and in a task for a request to stop [s]


# Options


@dataclass(frozen=True, kw_only=True)
class SideBySide:
    """How tasks run side by side; options of a command that runs some inherit from it."""

    jobs: int | None = None
    """Tasks at the same time, each in a process of its own. Default: one per core; with Ray, as many as there are cores
    for in the cluster."""
    engine: Literal["local", "ray"] = "local"
    """What runs the tasks: processes of this machine ("local"), or Ray, on this machine or a cluster
    (docs/guide/machines.md). Numbers are the same."""
    address: str | None = None
    """Address of a running cluster of Ray, such as 10.0.0.1:6379, or auto. Default: begin one on this machine."""

    def check_engine(self) -> None:
        """Check the options of the engine.

        Raises:
            ValueError: If one is out of range, or an address is given to the local engine.
        """
        require_bounds(self, jobs=(1, 10_000 if self.engine == "ray" else 256))
        if self.address and self.engine == "local":
            raise ValueError(f"--address {self.address} is of a cluster: add --engine ray")


# A task, and how it ends


@dataclass
class StopRequest:
    """Request to end early, made by a signal, by a test, or by another process."""

    made: bool = False


@dataclass(frozen=True, slots=True)
class Channel:
    """Connection of a task to whoever began it; by default nobody."""

    report: Callable[[Any], object] = lambda _: None
    """Sends news."""
    stop: StopRequest = field(default_factory=StopRequest)
    """Whether the task should end; it may then raise `Interrupted`."""


Task = Callable[[Channel], Result]


class Interrupted(Exception):  # noqa: N818
    """Raised by a task that ends early because it was asked to, with its work saved."""


class BrokenOff(Exception):  # noqa: N818
    """A task whose process died, and died again when the task was begun anew."""


@dataclass(frozen=True, slots=True)
class Failure:
    """The exception with which a task ended."""

    error: Exception

    @property
    def message(self) -> str:
        """The error in one line, with its kind and place unless it is about options or files."""
        text = " ".join(str(self.error).split())
        if isinstance(self.error, (OSError, ValueError, Interrupted, BrokenOff)):
            return text
        return " ".join([f"{type(self.error).__name__}: {text}", *getattr(self.error, "__notes__", [])[:1]])

    @property
    def resumable_message(self) -> str:
        """The message, with a remedy for a task that saves its work and whose process died."""
        return f"{self.message}; to continue, use --resume" if isinstance(self.error, BrokenOff) else self.message


def attempt(task: Task[Result], channel: Channel) -> Result | Failure:
    """Run a task, and return its result or failure."""
    try:
        return task(channel)
    except SystemExit as end:
        return Failure(ValueError(f"exit status {end.code}"))
    except Exception as error:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        error.add_note(f"({os.path.basename(frame.filename)}, line {frame.lineno})")
        return Failure(error)


@contextmanager
def stop_on_signals(stop: StopRequest, asked: Callable[[], object] = lambda: None) -> Iterator[None]:
    """Turn the first Ctrl-C or SIGTERM into a request to stop, and the second into KeyboardInterrupt.

    `asked` is called at the first signal.
    """

    def ask(*_: object) -> None:
        if stop.made:
            raise KeyboardInterrupt
        stop.made = True
        asked()

    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


# Many tasks


class Workers(NamedTuple):
    """Processes that run calls of `work`."""

    submit: Callable[[Callable[[], bytes]], Future[bytes]]
    is_death: Callable[[BaseException], bool]  # whether a future has this error because its process died
    news: Any  # queues of the calls
    stops: Any
    room: int  # calls that may be with them at a time
    one_ends_all: bool  # whether a process that dies takes the others along


def run_side_by_side(
    tasks: Mapping[str, Task[Result]],
    options: SideBySide,
    *,
    threads: int = 1,
    stop: StopRequest | None = None,
    tell: Callable[[str, Any], object] = lambda *_: None,
) -> Generator[tuple[str, Result | Failure]]:
    """Yield the result or failure of every task, as they come; wrap in `contextlib.closing` to leave none running.

    Args:
        tasks: Tasks by name. On a request to stop, those that have not begun are left out.
        options: How many run at a time, each in a worker process, and what runs them. Locally, a task that is alone, or
            one at a time, runs in this process. A task whose process or machine dies is begun again once.
        threads: Threads of the numerical libraries in a worker.
        stop: Passed on to the tasks, see `stop_on_signals`.
        tell: Called in this thread with a task's name and its news, all of them before its result.

    Raises:
        DependencyNotInstalled, OSError, ValueError: If the engine cannot be had, see `baselines.engines.cluster`.
    """
    stop, at_a_time = stop or StopRequest(), min(options.jobs or default_jobs(), len(tasks))
    if options.engine == "ray":
        from baselines.engines.cluster import ray_workers  # which needs this module

        there = ray_workers(options.address, options.jobs, threads)
    elif at_a_time > 1:
        there = _processes(at_a_time, threads)
    else:
        for name, task in tasks.items():
            if not stop.made:
                yield name, attempt(task, Channel(partial(tell, name), stop))
        return
    with there as workers:
        yield from _outcomes(tasks, workers, stop, tell)


def _outcomes(
    tasks: Mapping[str, Task[Any]], workers: Workers, stop: StopRequest, tell: Callable[[str, Any], object]
) -> Iterator[tuple[str, Any]]:
    """Yield the outcomes of all tasks.

    Where one process that dies takes the others along, any task that ran may be to blame: each is begun again alone.
    """
    waiting, deaths, passed_on = list(tasks), Counter[str](), False
    running: dict[Future[bytes], str] = {}
    outcomes: list[tuple[str, Any]] = []
    while True:
        suspects = workers.one_ends_all and deaths.keys() & {*waiting, *running.values()}
        while waiting and not stop.made and len(running) < (1 if suspects else workers.room):
            name = waiting.pop(0)
            call = partial(work, name, tasks[name], workers.news, workers.stops, os.getcwd())
            running[workers.submit(call)] = name
        yield from outcomes  # now that no worker waits for what is done with them
        if not running:
            return
        ended, _ = wait(running, _POLL, FIRST_COMPLETED)
        if stop.made and not passed_on:
            workers.stops.put(passed_on := True)
        with suppress(queue.Empty):
            while True:
                tell(*pickle.loads(workers.news.get_nowait()))
        outcomes = []
        for future in ended:
            name, error = running.pop(future), future.exception()
            if error is None:
                outcomes += [(name, pickle.loads(data))] if (data := future.result()) else []
                continue
            if not workers.is_death(error):
                raise error
            deaths[name] += 1
            if deaths[name] == 1 and not stop.made:
                waiting.insert(0, name)
            else:
                outcomes.append((name, Failure(BrokenOff("the process broke off, for want of memory perhaps"))))


@contextmanager
def _processes(jobs: int, threads: int) -> Iterator[Workers]:
    """Give processes of this machine, with their queues in one of its own that outlives any of them.

    They take no signals: this process passes requests to stop on. Where it dies itself, their queues do so too, which
    is a request to stop.
    """
    executor = partial(get_reusable_executor, jobs, env=dict.fromkeys(THREADS, str(threads)))

    def submit(call: Callable[[], bytes]) -> Future[bytes]:
        with _blocked_signals():  # as this may begin processes
            return executor().submit(call)

    def is_death(error: BaseException) -> bool:
        return isinstance(error, BrokenProcessPool)

    manager = SyncManager(ctx=get_context("loky"), shutdown_timeout=60)  # as it takes no signal to end
    with _blocked_signals():
        manager.start(end_with_parent)
    try:
        yield Workers(submit, is_death, manager.Queue(), manager.Queue(), jobs, one_ends_all=True)
    except BaseException:
        executor().shutdown(kill_workers=True)
        raise
    finally:
        manager.shutdown()


@contextmanager
def _blocked_signals() -> Iterator[None]:
    """Block signals in this thread, and for good in processes that it begins, from their first instruction on."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    for tracker in (resource_tracker, loky_resource_tracker):
        tracker.ensure_running()  # which unblocks signals as it begins
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


# In other processes


def work(name: str, task: Task[Any], news: Any, stops: Any, folder: str) -> bytes:
    """Run a task in a worker, and return its pickled outcome; nothing where it is asked to stop before.

    News and outcomes travel as bytes: what is between the processes need not import what they are made of.

    Args:
        name: Of the task.
        task: What to do.
        news: Queue for pairs of the task's name and its news.
        stops: Queue; whatever is in it is a request to stop.
        folder: Where to work, if this machine has it.
    """
    stop, over, parent = StopRequest(), threading.Event(), os.getppid()

    def asked_to_stop() -> bool:
        try:
            return not stops.empty()
        except Exception:  # the process that began the task has ended
            return True

    def watch() -> None:
        while not (stop.made or over.wait(_LOOK)):
            stop.made = asked_to_stop()

    def report(what: Any) -> None:
        data = pickle.dumps((name, what))
        with suppress(EOFError, OSError):
            news.put(data)

    if asked_to_stop():
        return b""
    threading.Thread(target=watch, daemon=True).start()
    with suppress(OSError):
        os.chdir(folder)
    outcome = pickled(attempt(task, Channel(report, stop)))
    over.set()
    if os.getppid() != parent:  # nobody waits for it, nor has another task
        os._exit(1)
    return outcome


def pickled(outcome: Any) -> bytes:
    """Pickle an outcome, or where it cannot be or be read again, a failure that says so."""
    try:
        data = pickle.dumps(outcome)
        pickle.loads(data)
    except Exception as error:
        lost = Failure(outcome.error).message if isinstance(outcome, Failure) else f"its result is lost: {error!r}"
        return pickle.dumps(Failure(RuntimeError(lost)))
    return data


def end_with_parent() -> None:
    """End this process when the one that began it has ended."""
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
