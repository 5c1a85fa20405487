"""Tasks on a cluster of Ray, or on one of this machine alone that lasts as long as the command.

Tasks are plain ones of Ray. Its backend for joblib (`ray.util.joblib`) returns no generator, waits until all its
workers have a core, hands tasks out in turn whether or not a worker is free, and ends all of them where one dies.
`baselines.engines.parallel` begins a task whose process dies again: where memory is short, Ray would do so without end.

Every worker proves that its code and packages are those of the process that began the tasks: only then are numbers the
same.
"""

from __future__ import annotations

import logging
import os
import pickle
import signal
import socket
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from gymnasium.error import DependencyNotInstalled

from baselines.engines.parallel import THREADS, Workers
from baselines.tools.provenance import code_and_packages

_ROOT = Path(__file__).resolve().parents[2]
_MOST = 1000  # tasks with Ray at a time: more than there are cores for, as a cluster may grow
_PATIENCE = 10.0  # with an address that does not answer [s]
_SETTINGS = {
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",  # else Ray warns of what it will do one day
    "RAY_USAGE_STATS_ENABLED": "0",  # else Ray sends statistics of its use to its makers
    "GRPC_ENABLE_FORK_SUPPORT": "0",  # else a program that is begun later may print, or hang
}


@contextmanager
def ray_workers(address: str | None, jobs: int | None, threads: int) -> Iterator[Workers]:
    """Give workers of a cluster.

    Args:
        address: Of a running cluster; None begins one on this machine.
        jobs: Tasks at a time; None for as many as fit.
        threads: Threads of the numerical libraries, and cores of each task.

    Raises:
        DependencyNotInstalled: Without Ray.
        OSError: If no cluster answers, or it is lost.
        ValueError: If a worker has other code or packages, or no machine has enough cores.
    """
    with _connected(address, jobs and jobs * threads) as ray:
        from ray.util.queue import Queue
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        most = max((int(node["Resources"].get("CPU", 0)) for node in ray.nodes() if node["Alive"]), default=0)
        if 0 < most < threads:  # Ray would wait for a larger one forever
            raise ValueError(f"--threads {threads} are more than the {most} cores of the cluster's largest machine")
        variables = {"env_vars": dict.fromkeys(THREADS, str(threads))}
        work = ray.remote(max_retries=0, num_cpus=threads, runtime_env=variables)(_work)
        expected = code_and_packages()

        def submit(call: Callable[[], bytes]) -> Future[bytes]:
            return work.remote(ray.cloudpickle.dumps(call), expected).future()

        def is_death(error: BaseException) -> bool:
            return isinstance(error, ray.exceptions.RayError) and not isinstance(error, ray.exceptions.RayTaskError)

        # The queues are on the machine of this process, lest another that is lost take them along.
        here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=False)
        news, stops = (Queue(actor_options={"num_cpus": 0, "scheduling_strategy": here}) for _ in range(2))
        try:
            yield Workers(submit, is_death, news, stops, jobs or _MOST, one_ends_all=False)
        except ray.exceptions.RayTaskError as error:  # before a task, which catches its own
            reason = str(error).strip().splitlines()[-1]
            remedy = "every machine needs the same commit and the same packages, see docs/guide/machines.md"
            raise ValueError(f"a worker cannot take tasks ({reason}): {remedy}") from None
        except ray.exceptions.RayError as error:
            text = " ".join(str(error).split())
            raise OSError(f"the cluster of Ray was lost ({text}); what was saved is kept") from None


@contextmanager
def _connected(address: str | None, cores: int | None) -> Iterator[Any]:
    """Give the package `ray`, connected to a cluster, or to one of so many cores (None: all) that begins here."""
    for name, value in _SETTINGS.items():
        os.environ.setdefault(name, value)
    token = (Path.home() / ".ray" / "auth_token").exists() or "RAY_AUTH_TOKEN" in os.environ
    if token and address is not None:
        os.environ.setdefault("RAY_AUTH_MODE", "token")  # as Ray does by itself where it is given no address
    try:
        import ray
    except ModuleNotFoundError:
        remedy = "pip install 'beltarm-env[ray]'"
        raise DependencyNotInstalled(f"--engine ray needs Ray: `{remedy}`, or `make setup` in a checkout") from None
    logging.getLogger("ray").setLevel(logging.ERROR)  # else it tells of tokens
    options: dict[str, Any] = {}
    if address is None:
        paths = os.pathsep.join([str(_ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
        options = {"include_dashboard": False, "num_cpus": cores, "runtime_env": {"env_vars": {"PYTHONPATH": paths}}}
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        try:
            _require_listener(address or "")
            ray.init(address or "local", log_to_driver=False, configure_logging=False, **options)
        except (Exception, SystemExit) as error:
            where = f"at --address {address}" if address else "on this machine"
            raise OSError(f"no cluster of Ray answers {where} ({error}); `ray start --head` begins one") from None
        for number, handler in before.items():  # Ray sets its own
            signal.signal(number, handler)
        yield ray
    finally:
        ray.shutdown()


def _require_listener(address: str) -> None:
    """Check that somebody listens at an address: Ray would try for two minutes, and then end the process.

    Raises:
        ValueError, OSError: If it is of another kind, or nobody does.
    """
    host, _, port = address.rpartition(":")
    if host.startswith("ray://"):
        raise ValueError("it is of Ray's client: run the command on a machine of the cluster instead")
    if port.isdigit():  # not "auto"
        socket.create_connection((host.strip("[]"), int(port)), timeout=_PATIENCE).close()


# In other processes

own_code = cache(code_and_packages)


def _work(call: bytes, expected: str) -> bytes:
    """Run a pickled call.

    Raises:
        RuntimeError: If the code or packages of this worker are not those that are expected.
    """
    if own_code() != expected:
        raise RuntimeError(f"{socket.gethostname()} has other code or other packages")
    return pickle.loads(call)()
