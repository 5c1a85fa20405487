"""Trouble at any event in the file system: a run that is begun again reaches the end that it would have had.

A process that is killed leaves what it has written so far, and so does one whose disk is full or read-only. Trainings,
comparisons and searches for gains promise that `--resume`, or the same command again, then goes on to the same files.
A forked child counts the events that change its folder, by Python's audit hooks, and gets into trouble at one of them;
another child goes on.
"""

from __future__ import annotations

import errno
import json
import os
import resource
import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context, get_start_method, set_start_method
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from tests.stress.subjects import SUBJECTS, Subject, assert_same

LONGEST = 120.0  # that a child may take [s]
CHANGES = ("os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.chmod", "os.link", "os.symlink", "os.truncate")
DAY = 86400.0  # [s]
KINDS = ("killed", "killed", "cut", "cut", "full", "read-only", "clock")
"""Kinds of trouble: killed at once, killed within the next write, a disk that is full or read-only from then on, and a
clock that jumps to and fro by a day."""


class Trouble(NamedTuple):
    """What happens to a run, and at which share of its events."""

    kind: str
    share: float
    size: int = 0  # bytes that are still written of a file that is cut


TROUBLES = st.builds(Trouble, st.sampled_from(KINDS), st.floats(0, 1, exclude_max=True), st.integers(0, 400))


@pytest.fixture(scope="module")
def pool() -> Iterator[ProcessPoolExecutor]:
    """A process without threads, which can be forked."""
    if get_start_method(allow_none=True) == "loky":  # joblib's, which a process that is spawned does not know
        set_start_method("spawn", force=True)
    with ProcessPoolExecutor(1, get_context("spawn"), initializer=torch.set_num_threads, initargs=(1,)) as executor:
        yield executor


@pytest.mark.parametrize("name", SUBJECTS)
def test_it_goes_on_to_the_same_files(name: str, pool: ProcessPoolExecutor):
    with TemporaryDirectory() as scratch:
        folder = Path(scratch) / "run"
        events, wanted = pool.submit(undisturbed, name, folder).result()

        @examples(6, shrink=False)
        @given(st.lists(TROUBLES, min_size=1, max_size=2))
        def run(troubles: list[Trouble]) -> None:
            pool.submit(disturbed, name, folder, troubles, events, wanted).result()

        run()


def undisturbed(name: str, folder: Path) -> tuple[list[str], dict[str, Any]]:
    """Events of a run without trouble, and the meaning of its files."""
    subject = SUBJECTS[name]
    prepare(subject, folder)
    subject.begin(folder)  # so that all children have what is compiled
    prepare(subject, folder)
    return in_child(subject.begin, folder), subject.meaning(folder)


def disturbed(name: str, folder: Path, troubles: list[Trouble], events: list[str], wanted: dict[str, Any]) -> None:
    """Run into trouble, go on, and compare the files."""
    subject = SUBJECTS[name]
    prepare(subject, folder)
    for k, trouble in enumerate(troubles):
        in_child(subject.go_on if k else subject.begin, folder, trouble, events)
        for path in folder.rglob(".*"):  # as if an hour had passed, after which half-written files are taken away
            os.utime(path, (0, 0))
    in_child(subject.go_on, folder)
    assert [path.name for path in folder.rglob(".*") if path.name != ".lock"] == []
    assert_same(subject.meaning(folder), wanted)


def prepare(subject: Subject, folder: Path) -> None:
    """Empty the folder, except for given files."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for name, text in subject.given.items():
        (folder / name).write_text(text)


def in_child(
    run: Callable[[Path], object], folder: Path, trouble: Trouble | None = None, known: list[str] | None = None
) -> list[str]:
    """Run something in a forked child, with trouble or without, and return the child's events if it ends by itself.

    Args:
        run: What the child runs.
        folder: Its folder.
        trouble: That it gets into.
        known: Events of a run without trouble.
    """
    at = int(trouble.share * len(known)) if trouble and known else 0
    if trouble and trouble.kind == "cut" and known and known[at] != "open":
        trouble = trouble._replace(kind="killed")
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        be_child(run, folder, trouble, at, writing)
    os.close(writing)
    deadline, ended, status = time.monotonic() + LONGEST, 0, 0
    while not ended:
        ended, status = os.waitpid(child, os.WNOHANG)
        if not ended and time.monotonic() > deadline:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            raise AssertionError(f"it does not come to an end within {LONGEST:g} s")
        time.sleep(0.002)
    with open(reading, encoding="utf-8") as file:
        report = file.read()
    if report:
        events, error = json.loads(report)
        assert not error, error
        return events
    assert trouble and trouble.kind in ("killed", "cut"), f"it died with the status {status}"
    assert os.WTERMSIG(status) in (signal.SIGKILL, signal.SIGXFSZ)
    return []


def be_child(run: Callable[[Path], object], folder: Path, trouble: Trouble | None, at: int, report: int) -> None:
    """Run something as a child, report its events and its error, and end this process."""
    events, words = list[str](), ""
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)
    os.dup2(nothing, 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGXFSZ, signal.SIG_DFL if trouble and trouble.kind == "cut" else signal.SIG_IGN)

    def watch(event: str, arguments: tuple[Any, ...]) -> None:
        if not changes(event, arguments, str(folder)):
            return
        events.append(event)
        if trouble is None or len(events) <= at:
            return
        if trouble.kind == "read-only":
            raise OSError(errno.EROFS, os.strerror(errno.EROFS), arguments[0])
        if len(events) == at + 1:
            strike(trouble)

    try:
        sys.addaudithook(watch)
        run(folder)
    except BaseException as error:
        no_disk = trouble is not None and trouble.kind in ("full", "read-only")
        refused = no_disk and isinstance(error, OSError | ValueError) and str(folder) in str(error)
        words = "" if refused else f"{type(error).__name__}: {error}"
    os.write(report, json.dumps([events, words[:1000]]).encode())
    os._exit(0)


def strike(trouble: Trouble) -> None:
    """Get this process into trouble."""
    if trouble.kind == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    elif trouble.kind == "clock":
        now, calls = time.time, iter(range(sys.maxsize))
        time.time = lambda: now() + (DAY if next(calls) % 2 else -DAY)
    else:  # the system lets a file grow that far; then it kills a run that is to be cut, and refuses writes of others
        most = trouble.size or 1 if trouble.kind == "cut" else 0
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))


def changes(event: str, arguments: tuple[Any, ...], folder: str) -> bool:
    """Whether an audit event changes something in a folder."""
    if event == "open":
        if isinstance(arguments[0], int) or not arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
            return False
    elif event not in CHANGES:
        return False
    relative = event in ("os.remove", "os.rmdir") and arguments[1] != -1  # to a folder that is open, as rmtree does it
    paths = [os.fsdecode(path) for path in arguments[:2] if isinstance(path, str | bytes | os.PathLike)]
    return relative or any(path.startswith(folder) for path in paths)
