"""Options of commands that run tasks side by side: how many at a time, and on which engine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

from baselines.tools.command import require_bounds


class Engine(NamedTuple):
    """What runs tasks: processes of this machine ("local"), or a cluster of Ray, which may be this machine alone."""

    name: Literal["local", "ray"] = "local"
    address: str | None = None  # of a running cluster of Ray; None begins one on this machine


LOCAL = Engine()


@dataclass(frozen=True, kw_only=True)
class SideBySide:
    """Options of a command that runs tasks side by side; its own options inherit from it."""

    jobs: int | None = None
    """Tasks at the same time, each in a process of its own. Default: one per core; with Ray, as many as there are cores
    for in the cluster."""
    engine: Literal["local", "ray"] = "local"
    """What runs the tasks: processes of this machine ("local"), or Ray, on this machine or a cluster
    (docs/guide/machines.md). Numbers are the same."""
    address: str | None = None
    """Address of a running cluster of Ray, such as 10.0.0.1:6379, or auto. Default: begin one on this machine."""

    @property
    def runs_on(self) -> Engine:
        """The engine that was chosen."""
        return Engine(self.engine, self.address)

    def check_engine(self) -> None:
        """Check the options of the engine.

        Raises:
            ValueError: If one is out of range, or an address is given to the local engine.
        """
        require_bounds(self, jobs=(1, 10_000 if self.engine == "ray" else 256))
        if self.address and self.engine == "local":
            raise ValueError(f"--address {self.address} is of a cluster: add --engine ray")


@dataclass(frozen=True, kw_only=True)
class WithStorage(SideBySide):
    """The same, for tasks that save their work as they go."""

    storage: str | None = None
    """With Ray: where tasks save their work, as a path or a URL of fsspec (s3://bucket/folder, ...) that all machines
    reach. Default: --out, which all machines then have to share."""

    def check_engine(self) -> None:
        """Check the options of the engine.

        Raises:
            ValueError: As above, or if the local engine is given a storage.
        """
        super().check_engine()
        if self.storage and self.engine == "local":
            raise ValueError(f"--storage {self.storage} is for --engine ray: here, work is saved in its folder")
