"""Connection to a cluster of Ray, or a cluster of this machine alone that lasts as long as the command."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from gymnasium.error import DependencyNotInstalled

_ROOT = Path(__file__).resolve().parents[2]
_PATIENCE = 10.0  # with an address that does not answer [s]
_BEGIN = "begin one with `ray start --head`, or leave out --address"


@contextmanager
def connected(address: str | None, cores: int | None = None) -> Iterator[Any]:
    """Connect to a cluster of Ray, or begin one on this machine, and end the connection; gives the package `ray`.

    Args:
        address: Of the cluster; None to begin one.
        cores: Of the one that is begun; None for all.

    Raises:
        DependencyNotInstalled: Without Ray.
        OSError: If the address does not answer.
    """
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # else Ray warns of what it will do one day
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # else Ray sends statistics of its use to its makers
    os.environ.setdefault("GRPC_ENABLE_FORK_SUPPORT", "0")  # else a program that is begun later may print, or hang
    token = (Path.home() / ".ray" / "auth_token").exists() or "RAY_AUTH_TOKEN" in os.environ
    if token and address is not None:
        os.environ.setdefault("RAY_AUTH_MODE", "token")  # as Ray does by itself where it is given no address
    try:
        import ray
    except ModuleNotFoundError:
        remedy = "pip install 'beltarm-env[ray]'"
        raise DependencyNotInstalled(f"--engine ray needs Ray: `{remedy}`, or `make setup` in a checkout") from None
    if ray.is_initialized():  # by whoever calls; theirs to end
        yield ray
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    options: dict[str, Any] = {"log_to_driver": False, "configure_logging": False, "logging_level": "ERROR"}
    if address is None:
        options |= {"address": "local", "include_dashboard": False, "num_cpus": cores}
    else:
        require_answer(address)
        options |= {"address": address}
    try:
        with _quiet(), _own_packages():
            ray.init(**options)
        for number, handler in before.items():  # Ray sets its own
            signal.signal(number, handler)
        yield ray
    finally:
        ray.shutdown()


def require_answer(address: str) -> None:
    """Check that a cluster answers at an address; Ray itself would try for two minutes, and then end the process.

    Raises:
        OSError: If not.
    """
    if address.startswith("ray://"):
        raise OSError(f"--address {address} is of Ray's client: run the command on a machine of the cluster instead")
    host, _, port = address.rpartition(":")
    try:
        if host and port.isdigit():  # not "auto"
            socket.create_connection((host.strip("[]"), int(port)), timeout=_PATIENCE).close()
        words = [sys.executable, "-c", _TRY, address]
        found = subprocess.run(words, capture_output=True, text=True, timeout=_PATIENCE, check=False)
        reason = found.stderr if found.returncode else None
    except subprocess.TimeoutExpired as error:
        reason = (error.stderr or b"").decode()
    except (OSError, OverflowError) as error:
        reason = str(error)
    if reason is not None:
        last = (reason.strip().splitlines() or ["it says nothing"])[-1]
        raise OSError(f"no cluster of Ray answers at --address {address} ({last}): {_BEGIN}")


_TRY = "import sys, ray; ray.init(address=sys.argv[1], log_to_driver=False, configure_logging=False)"


@contextmanager
def _own_packages() -> Iterator[None]:
    """Have workers find the packages of this checkout, and not the folder of the command.

    Ray would put that folder before all others, and a file there could have the name of a package.
    """
    scripts, paths = os.path.dirname(os.path.realpath(sys.argv[0])), sys.path[:]
    searched = os.environ.get("PYTHONPATH")
    sys.path[:] = [path for path in paths if path != scripts]
    os.environ["PYTHONPATH"] = os.pathsep.join([str(_ROOT), *filter(None, [searched])])  # of a cluster that begins here
    try:
        yield
    finally:
        sys.path[:] = paths
        if searched is None:
            del os.environ["PYTHONPATH"]
        else:
            os.environ["PYTHONPATH"] = searched


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep Ray's words about its authentication from the terminal; errors come as exceptions."""
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
