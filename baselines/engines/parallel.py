"""Tasks side by side, with news, results as they come, and requests to stop.

    task(channel) -> result        a picklable callable, which may be called again

A task reports news and looks for a request to stop through its `Channel`. Whatever it raises becomes the `Failure` of
this task alone. A task whose process dies is begun again: trainings and searches go on from what they have saved.

The processes are joblib's (loky), or Ray's (`baselines.engines.cluster`); both take a call and return a future. What
joblib has on top of them, `Parallel`, was not enough: where one process dies it ends all tasks, and loses results that
nobody has taken yet; and it hears no news while it waits.
"""

from __future__ import annotations

import os
import pickle
import queue
import signal
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from functools import partial
from multiprocessing import resource_tracker
from multiprocessing.managers import SyncManager
from typing import Any

from joblib import cpu_count
from joblib.externals.loky import get_reusable_executor
from joblib.externals.loky.backend import get_context
from joblib.externals.loky.backend import resource_tracker as loky_resource_tracker

from baselines.engines.cluster import ray_workers
from baselines.engines.options import LOCAL, Engine
from baselines.engines.task import (
    LEFT_OUT,
    THREADS,
    BrokenOff,
    Channel,
    Failure,
    Interrupted,
    Result,
    StopRequest,
    Task,
    Workers,
    attempt,
    end_with_parent,
    work,
)

__all__ = ["LOCAL", "BrokenOff", "Channel", "Engine", "Failure", "Interrupted", "StopRequest", "Task"]
__all__ += ["default_jobs", "run_side_by_side", "stop_on_signals"]
_POLL = 0.1  # [s]
default_jobs = cpu_count
"""Number of cores that this process may use."""


def run_side_by_side(
    tasks: Mapping[str, Task[Result]],
    jobs: int | None = None,
    *,
    engine: Engine = LOCAL,
    threads: int = 1,
    stop: StopRequest | None = None,
    tell: Callable[[str, Any], object] = lambda *_: None,
) -> Generator[tuple[str, Result | Failure]]:
    """Yield the result or failure of every task, as they come; wrap in `contextlib.closing` to leave none running.

    Args:
        tasks: Tasks by name. On a request to stop, those that have not begun are left out.
        jobs: Tasks at a time, each in a worker process; by default one per core. Locally, one task, or 1, runs in this
            process.
        engine: What runs the tasks. A task whose process or machine dies is begun again once.
        threads: Threads of the numerical libraries in a worker.
        stop: Passed on to the tasks, see `stop_on_signals`.
        tell: Called in this thread with a task's name and its news, all of them before its result.

    Raises:
        DependencyNotInstalled, OSError, ValueError: If the engine cannot be had, see `baselines.engines.cluster`.
    """
    stop, at_a_time = stop or StopRequest(), min(jobs or default_jobs(), len(tasks))
    if engine.name == "local" and at_a_time <= 1:
        for name, task in tasks.items():
            if not stop.made:
                yield name, attempt(task, Channel(partial(tell, name), stop))
        return
    there = _processes(at_a_time, threads) if engine.name == "local" else ray_workers(engine.address, jobs, threads)
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

    def fill() -> None:
        while waiting and not stop.made:
            suspects = workers.one_ends_all and deaths.keys() & {*waiting, *running.values()}
            if len(running) >= (1 if suspects else workers.room):
                break
            name = waiting.pop(0)
            call = partial(work, name, tasks[name], workers.news, workers.stops, os.getcwd())
            running[workers.submit(call)] = name

    fill()
    while running:
        ended, _ = wait(running, _POLL, FIRST_COMPLETED)
        if stop.made and not passed_on:
            workers.stops.put(passed_on := True)
        with suppress(queue.Empty):
            while True:
                tell(*pickle.loads(workers.news.get_nowait()))
        outcomes = list[tuple[str, Any]]()
        for future in ended:
            name, error = running.pop(future), future.exception()
            if error is None:
                outcomes += [(name, pickle.loads(future.result()))] if future.result() != LEFT_OUT else []
                continue
            if not workers.is_death(error):
                raise error
            deaths[name] += 1
            if deaths[name] == 1 and not stop.made:
                waiting.insert(0, name)
            else:
                broken_off = BrokenOff("the process broke off, for want of memory perhaps")
                outcomes.append((name, Failure(broken_off)))
        fill()  # before anybody works on the outcomes
        yield from outcomes


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


@contextmanager
def stop_on_signals(stop: StopRequest, asked: Callable[[], object] = lambda: None) -> Iterator[None]:
    """Turn the first Ctrl-C or SIGTERM into a request to stop, and the second into KeyboardInterrupt.

    Args:
        stop: The request.
        asked: Called at the first signal.
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
