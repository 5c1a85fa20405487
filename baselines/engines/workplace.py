"""Where tasks save their work, wherever they run: in a folder that all machines see, or in a storage.

A storage is a path or a URL of fsspec that all machines reach. It gets `NAME.zip` of each task, its folder: fsspec
copies folders file by file, and a process that dies in between would leave an old file beside a new one.
What lies in a storage is trusted as a run's own folder is: checkpoints are pickles.
"""

from __future__ import annotations

import shutil
import socket
import time
import uuid
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import fsspec

from baselines.engines.parallel import Channel, Result, SideBySide, Task
from baselines.tools.files import write_text

_WORK_PER_COPY = 20  # times as long as a copy to the storage takes
InFolder = Callable[[Path, Channel], Result]
"""Task that works in a folder, and goes on from what is there."""


@dataclass(frozen=True, kw_only=True)
class WithStorage(SideBySide):
    """Options of a command whose tasks side by side save their work as they go."""

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


class Workplace:
    """Folders in which tasks of a command save their work, wherever they run.

    Args:
        options: Of the command.
        out: Folder of all of them on this machine.
    """

    def __init__(self, options: WithStorage, out: Path) -> None:
        self._remote = options.engine == "ray"
        url = options.storage
        self._url = url if url is None or "://" in url or "::" in url else str(Path(url).resolve())
        self._proof = out.resolve() / f".seen-{uuid.uuid4().hex}"

    def __enter__(self) -> Workplace:
        """Begin.

        Raises:
            OSError: If the storage cannot be written or read.
            ValueError: If fsspec cannot make anything of the URL, or lacks a package for it.
        """
        if self._url:
            with _stored(self._url, ".writable") as (files, place):
                files.makedirs(place.rpartition("/")[0], exist_ok=True)
                files.pipe_file(place, b"")
                files.rm_file(place)
        elif self._remote:
            write_text(self._proof, "")
        return self

    def __exit__(self, *_: object) -> None:
        """End."""
        self._proof.unlink(missing_ok=True)

    def prepare(self, name: str, folder: Path, *, resume: bool, overwrite: bool = False) -> None:
        """Fetch what there is of a task that is to go on; or see that there is nothing of one that is to begin.

        Raises:
            OSError: If the storage cannot be written or read.
            ValueError: If there is something, and it is not to be overwritten.
        """
        if resume:
            self.collect(name, folder)
        elif self._url:
            with _stored(self._url, f"{name}.zip") as (files, place):
                there = files.exists(place)
                if there and overwrite:
                    files.rm_file(place)
            if there and not overwrite:
                remedy = "continue it with --resume, delete it with --overwrite, or choose another --storage"
                raise ValueError(f"{self._url} already holds {name}: {remedy}")

    def task(self, name: str, folder: Path, work: InFolder[Result], checkpoint: Path) -> Task[Result]:
        """Task that does its work in a folder, and goes on from a checkpoint in it, where there is one."""
        if self._url:
            return partial(_in_copy, self._url, name, work, checkpoint)
        return partial(_in_shared, folder.resolve(), work, self._proof) if self._remote else partial(work, folder)

    def collect(self, name: str, folder: Path) -> None:
        """Bring what a task has left in its folder to this machine."""
        if self._url:
            _fetch(self._url, name, folder)


@contextmanager
def _stored(url: str, name: str) -> Iterator[tuple[Any, str]]:
    """Give the file system of a storage and a path on it; any error, as its drivers raise what they like, names it."""
    try:
        files, root = fsspec.url_to_fs(url)
    except (ImportError, ValueError) as error:
        raise ValueError(f"--storage {url} cannot be used: {error}") from None
    try:
        files.invalidate_cache()
        yield files, f"{root.rstrip('/')}/{name}"
    except Exception as error:
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        where = f"--storage {url} from {socket.gethostname()}"
        raise OSError(f"cannot write to or read from {where}: {reason}; choose another") from None


def _keep(url: str, name: str, folder: Path) -> None:
    with TemporaryDirectory() as scratch, _stored(url, f"{name}.zip") as (files, place):
        files.put_file(shutil.make_archive(f"{scratch}/{name}", "zip", folder), f"{place}.new")
        files.mv(f"{place}.new", place)


def _fetch(url: str, name: str, folder: Path) -> None:
    """Unpack what is kept over what is in the folder, if there is any."""
    with TemporaryDirectory() as scratch:
        with _stored(url, f"{name}.zip") as (files, place):
            if not files.exists(place):
                return
            files.get_file(place, archive := f"{scratch}/{name}.zip")
        try:
            shutil.unpack_archive(archive, folder)
        except (shutil.ReadError, zipfile.BadZipFile) as error:
            raise ValueError(f"{name}.zip in {url} is damaged ({error}): delete it, and begin anew") from None


# On the machine of a task


@contextmanager
def _named_machine() -> Iterator[None]:
    """Have errors about files say on which machine."""
    try:
        yield
    except OSError as error:
        raise OSError(f"on {socket.gethostname()}: {error}") from error


def _in_shared(folder: Path, work: InFolder[Result], proof: Path, channel: Channel) -> Result:
    """Work in a folder that all machines see, as a file in it proves that the process of the command has written."""
    if not proof.exists():
        remedy = "give --storage, a path or a URL that all machines reach"
        raise ValueError(f"{socket.gethostname()} does not see {folder}: {remedy}")
    with _named_machine():
        return work(folder, channel)


def _in_copy(url: str, name: str, work: InFolder[Result], checkpoint: Path, channel: Channel) -> Result:
    """Work in a copy of a folder, which is kept on the way, for a twentieth of the time at most, and at the end."""
    due = 0.0

    def keep() -> None:
        nonlocal due
        if (folder / checkpoint).exists() and (began := time.monotonic()) >= due:
            _keep(url, name, folder)
            due = time.monotonic() + _WORK_PER_COPY * (time.monotonic() - began)

    with TemporaryDirectory(prefix="beltarm-") as scratch, _named_machine():
        folder = Path(scratch) / name
        folder.mkdir()
        _fetch(url, name, folder)
        try:
            return work(folder, Channel(lambda news: (keep(), channel.report(news)), channel.stop))
        finally:
            due = 0.0
            keep()
