"""Tasks on Ray, with a mailbox for their messages; `baselines.engines.parallel` is its face.

Ray places tasks on machines and tells of deaths. A task whose process or machine dies is begun again here, where Ray
would do it silently and, for want of memory, without end. Every worker proves that its code and packages are those of
the process that began the tasks: only then are numbers the same.

Workers end with the process that began the tasks. Results come to it, and it alone writes them.
"""

from __future__ import annotations

import os
import pickle
import socket
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, Literal, NamedTuple

from baselines.engines.ray_cluster import connected
from baselines.engines.task import BrokenOff, Channel, Failure, PolledStop, StopRequest, Task, attempt, pickled
from baselines.tools.provenance import code_and_packages

ATTEMPTS = 3
"""How often a task is begun in all: machines of a cluster may be taken away at any time."""
_POLL = 0.1  # [s]
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


class _Message(NamedTuple):
    """Message from a worker."""

    name: str  # of the task
    kind: Literal["began", "news"]
    content: Any = None


class _Unlike(NamedTuple):
    """Answer of a worker whose code or packages are others."""

    host: str
    what: str


class _LeftOut:
    """Answer of a worker that was asked to stop before it began."""


class RayPool:
    """Tasks on a cluster of Ray.

    Args:
        address: Of a running cluster; None begins one on this machine.
        jobs: Tasks at a time; None for as many as fit.
        threads: Threads of the numerical libraries, and cores of each task.
        stop: Passed on to the tasks.
        tell: Called with a task's name and its news.
    """

    def __init__(
        self, address: str | None, jobs: int | None, threads: int, stop: StopRequest, tell: Callable[[str, Any], object]
    ) -> None:
        self._address = address
        self._jobs = jobs
        self._threads = threads
        self._stop = stop
        self._tell = tell
        self._begun = set[str]()

    def run(self, tasks: dict[str, Task[Any]]) -> Iterator[tuple[str, Any]]:
        """Yield the outcomes of all tasks.

        Raises:
            DependencyNotInstalled: Without Ray.
            OSError: If no cluster answers, or it is lost.
            ValueError: If a worker has other code or packages, or no machine has enough cores.
        """
        with connected(self._address, self._jobs and self._jobs * self._threads) as ray:
            self._require_cores(ray)
            waiting, attempts, running = list(tasks), dict.fromkeys(tasks, 0), dict[Any, str]()
            mailbox = self._mailbox(ray)
            expected, variables = code_and_packages(), dict.fromkeys(_THREADS, str(self._threads))
            remote = ray.remote(max_retries=0, num_cpus=self._threads, runtime_env={"env_vars": variables})(_work)
            try:
                while running or (waiting and not self._stop.made):
                    while waiting and not self._stop.made and len(running) < self._room(ray):
                        name = waiting.pop(0)
                        attempts[name] += 1
                        call = ray.cloudpickle.dumps(_Call(name, tasks[name], os.getcwd()))
                        running[remote.remote(call, mailbox, expected)] = name
                    if not running:
                        break
                    ray.wait(list(running), timeout=_POLL)
                    ended, _ = ray.wait(list(running), num_returns=len(running), timeout=0)
                    self._read(ray, mailbox)
                    for reference in ended:
                        name = running.pop(reference)
                        outcome = _outcome(ray, reference)
                        if isinstance(outcome, BrokenOff) and attempts[name] < ATTEMPTS and not self._stop.made:
                            waiting.append(name)
                        elif not isinstance(outcome, _LeftOut):
                            yield name, Failure(outcome) if isinstance(outcome, BrokenOff) else outcome
                    if self._stop.made and not self._begun & {*running.values()}:
                        break  # what is left has not begun
            finally:
                with suppress(ray.exceptions.RayError):  # where the cluster is lost
                    for reference in running:
                        ray.cancel(reference, force=True)

    def _room(self, ray: Any) -> int:
        """Tasks that may be with Ray at a time: more than there are cores for, to which a cluster may add some."""
        return self._jobs or max(16, 4 * int(ray.cluster_resources().get("CPU", 0)))

    def _mailbox(self, ray: Any) -> Any:
        """Begin the mailbox on the machine of this process, lest another that is lost take it along."""
        here = ray.util.scheduling_strategies.NodeAffinitySchedulingStrategy(
            ray.get_runtime_context().get_node_id(), soft=False
        )
        return ray.remote(num_cpus=0, scheduling_strategy=here)(_Mailbox).remote()

    def _require_cores(self, ray: Any) -> None:
        """Check that some machine has the cores of a task; without, Ray would wait for one forever."""
        most = max((int(node["Resources"].get("CPU", 0)) for node in ray.nodes() if node["Alive"]), default=0)
        if 0 < most < self._threads:
            raise ValueError(
                f"--threads {self._threads} are more than the {most} cores of the cluster's largest machine"
            )

    def _read(self, ray: Any, mailbox: Any) -> None:
        """Read the mailbox, and tell it of a request to stop.

        Raises:
            OSError: If the cluster is lost.
            ValueError: If its processes do not find this project.
        """
        try:
            messages = ray.get(mailbox.take.remote(self._stop.made))
        except ray.exceptions.RayError as error:
            if "ModuleNotFoundError" in str(error):
                raise ValueError(f"a worker finds no code of this project: {_REMEDY}") from None
            words = " ".join(str(error).split())
            raise OSError(f"the cluster of Ray was lost ({words}); what was saved is kept") from None
        for message in messages:
            if message.kind == "began":
                self._begun.add(message.name)
            else:
                self._tell(message.name, message.content)


def _outcome(ray: Any, reference: Any) -> Any:
    """Result or failure of a task that has ended; `BrokenOff` where its process or machine died.

    Raises:
        ValueError: If its worker has other code or packages.
    """
    try:
        outcome = ray.get(reference)
    except ray.exceptions.RayTaskError as error:  # before the task: its worker could not even read it
        reason = str(error).strip().splitlines()[-1]
        raise ValueError(f"a worker has no code of this project, or other code ({reason}): {_REMEDY}") from None
    except ray.exceptions.RayError as error:
        memory = isinstance(error, ray.exceptions.OutOfMemoryError)
        return BrokenOff(f"the process broke off {ATTEMPTS} times" + (", for want of memory" if memory else ""))
    if isinstance(outcome, _Unlike):
        raise ValueError(f"the worker on {outcome.host} has {outcome.what}: {_REMEDY}")
    return outcome


_REMEDY = "every machine needs the same commit and the same packages, see docs/guide/machines.md"


# In other processes


class _Mailbox:
    """Messages of all tasks on their way to the process that began them, and its request to stop on the way back."""

    def __init__(self) -> None:
        self._messages: list[_Message] = []
        self._asked = False

    def put(self, message: _Message) -> None:
        self._messages.append(message)

    def take(self, asked: bool) -> list[_Message]:
        self._asked = asked
        messages, self._messages = self._messages, []
        return messages

    def asked(self) -> bool:
        return self._asked


@dataclass(frozen=True)
class _Call:
    """Call of a task with its channel, for a worker."""

    name: str
    task: Task[Any]
    folder: str

    def run(self, mailbox: Any) -> Any:
        """Run the task, unless a request to stop came first."""
        import ray

        stop = PolledStop(lambda: bool(ray.get(mailbox.asked.remote())))
        if stop.made:
            return _LeftOut()
        with suppress(OSError):  # another machine may not have it
            os.chdir(self.folder)
        ray.get(mailbox.put.remote(_Message(self.name, "began")))
        outcome = attempt(self.task, Channel(partial(self._report, mailbox), stop))
        ray.get(mailbox.asked.remote())  # news arrive before the result
        return pickle.loads(pickled(_located(outcome)))

    def _report(self, mailbox: Any, news: Any) -> None:
        mailbox.put.remote(_Message(self.name, "news", news))


def _located(outcome: Any) -> Any:
    """The outcome; an error about files says on which machine."""
    if isinstance(outcome, Failure) and isinstance(outcome.error, OSError):
        return Failure(OSError(f"on {socket.gethostname()}: {outcome.message}"))
    return outcome


def _work(call: bytes, mailbox: Any, expected: str) -> Any:
    """Run a pickled call, if the code and packages of this worker are those that are expected."""
    if _own_code() != expected:
        return _Unlike(socket.gethostname(), "other code or other packages than the process that began the tasks")
    return pickle.loads(call).run(mailbox)


@cache
def _own_code() -> str:
    return code_and_packages()
