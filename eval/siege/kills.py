"""Trouble at every event in the file system: what is begun again has to come to the end that it would have had.

A process that is killed leaves what it has written so far, and so does one whose disk is full or cannot be written any
more. Trainings, comparisons and searches for gains promise that this is enough: `--resume`, or the same command again,
goes on to the same files. A child process counts the events that change its folder, as Python's audit hooks tell them,
and at one of them gets into trouble; another child goes on.
"""

from __future__ import annotations

import errno
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context, get_start_method, set_start_method
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from eval.siege.report import Siege
from eval.siege.subjects import SUBJECTS, Subject, differences

_LONGEST = 120.0  # that a child may take [s]
_CHANGES = ("os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.chmod", "os.link", "os.symlink", "os.truncate")
_HALF = 400  # largest number of bytes after which a write is cut [bytes]
_TROUBLES = 1.2  # per event, in a whole siege
_WORKERS = 2
_SMALL = 0.05  # share up to which one subject has to do, which the seed chooses
_DAY = 86400.0  # [s]
_KILLS = ("killed", "cut")
_LIKELY = {"killed": 0.35, "cut": 0.25, "full": 0.15, "read-only": 0.15, "clock": 0.1}
"""Kinds of trouble: killed at once, killed within the next write, a disk that is full or read-only from then on, and a
clock that jumps to and fro by a day."""


class _Trouble(NamedTuple):
    at: int  # number of the event
    kind: str
    half: int = 0  # bytes that are still written of a file that is cut

    def __str__(self) -> str:
        return f"{self.kind} at event {self.at}" + (f" after {self.half} bytes" if self.kind == "cut" else "")


def besiege(share: float, seed: int) -> Siege:
    """Get trainings, a comparison and a search for gains into trouble at events in the file system, and go on.

    Args:
        share: Of a whole siege, which has a trouble at every event of each subject, and at some of them two.
        seed: Chooses events, kinds of trouble, and how much of a file a cut write leaves.
    """
    blind = "power cuts, after which a disk may lack what was written last, and more than two troubles of one run"
    siege = Siege("kills", "kills, full disks and clocks that jump", blind)
    chosen = SUBJECTS if share > _SMALL else (SUBJECTS[seed % len(SUBJECTS)],)
    if get_start_method(allow_none=True) == "loky":  # joblib's, which a process that is spawned does not know
        set_start_method("spawn", force=True)
    with ProcessPoolExecutor(_WORKERS, get_context("spawn")) as pool:
        for count, found in pool.map(partial(attack, share=share, seed=seed), chosen):
            siege.count += count
            siege.found += found
    return siege


def attack(subject: Subject, share: float, seed: int) -> tuple[int, list[str]]:
    """Get one subject into trouble at some of its events.

    Args:
        subject: What is attacked.
        share: Of a whole siege.
        seed: See `besiege`.

    Returns:
        The number of troubles, and a line for each that a promise is broken after.
    """
    torch.set_num_threads(1)  # a process that has others cannot be forked
    os.environ["OMP_NUM_THREADS"] = "1"  # which kernels go by
    rng, found, count = np.random.default_rng(seed), list[str](), 0
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "run"
        _prepare(subject, folder)
        subject.begin(folder)  # so that all children have what is compiled
        _prepare(subject, folder)
        whole = _in_child(subject.begin, folder)
        if whole.words:
            return 0, [f"{subject.name} without trouble: {whole.words}"]
        wanted, events = subject.meaning(folder), len(whole.events)
        chosen = max(1, round(share * _TROUBLES * events))
        for at in (int((k + rng.random()) * events / chosen) for k in range(chosen)):
            kind = str(rng.choice(list(_LIKELY), p=list(_LIKELY.values())))
            kind = "killed" if kind == "cut" and whole.events[at] != "open" else kind
            first = _Trouble(at, kind, int(rng.integers(_HALF)))
            again = [_Trouble(int(rng.integers(events)), "killed")] if rng.random() < 0.25 else []
            count += 1 + len(again)
            if words := _after(subject, folder, [first, *again], wanted):
                where = ", then ".join(map(str, (first, *again)))
                line = f"{subject.name}, seed {seed}, {where} ({whole.events[at]}): {words}"
                found.append(" ".join(line.split())[:600])
    return count, found


def _after(subject: Subject, folder: Path, troubles: list[_Trouble], wanted: dict[str, Any]) -> str:
    """Words for what is wrong after a run got into trouble once or more and has gone on; empty if nothing is."""
    _prepare(subject, folder)
    for k, trouble in enumerate(troubles):
        end = _in_child(subject.go_on if k else subject.begin, folder, trouble)
        if end.words:
            return end.words
        for path in folder.rglob(".*"):  # as if an hour had passed, after which half-written files are taken away
            os.utime(path, (0, 0))
    end = _in_child(subject.go_on, folder)
    if end.words:
        return end.words
    if left := [path.name for path in folder.rglob(".*") if path.name != ".lock"]:
        return f"leaves {', '.join(left)}"
    return differences(subject.meaning, folder, wanted)


def _prepare(subject: Subject, folder: Path) -> None:
    """Empty the folder, but for what is given."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for name, text in subject.given.items():
        (folder / name).write_text(text)


# Children


class _End(NamedTuple):
    """How a child ended: as wanted, or with the kinds of its events, and words for what went wrong."""

    events: list[str] = []  # noqa: RUF012
    words: str = ""


def _in_child(run: Callable[[Path], object], folder: Path, trouble: _Trouble | None = None) -> _End:
    """Run something in a forked child, which gets into trouble as it should, and is killed after too long a time."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        _be_child(run, folder, trouble, writing)
    os.close(writing)
    deadline, ended, status = time.monotonic() + _LONGEST, 0, 0
    while not ended:
        ended, status = os.waitpid(child, os.WNOHANG)
        if not ended and time.monotonic() > deadline:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            os.close(reading)
            return _End(words=f"it does not come to an end within {_LONGEST:g} s")
        time.sleep(0.002)
    with open(reading, encoding="utf-8") as file:
        told = file.read()
    if told:
        return _End(*json.loads(told))
    wanted = trouble and trouble.kind in _KILLS and os.WTERMSIG(status) in (signal.SIGKILL, signal.SIGXFSZ)
    return _End() if wanted else _End(words=f"it died with the status {status}")


def _be_child(run: Callable[[Path], object], folder: Path, trouble: _Trouble | None, told: int) -> None:
    """Run something as a child, tell of its end, and end this process."""
    events, words = list[str](), ""
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)
    os.dup2(nothing, 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGXFSZ, signal.SIG_DFL if trouble and trouble.kind == "cut" else signal.SIG_IGN)

    def watch(event: str, arguments: tuple[Any, ...]) -> None:
        if not _changes(event, arguments, str(folder)):
            return
        events.append(event)
        if trouble is None or len(events) <= trouble.at:
            return
        if trouble.kind == "read-only":
            raise OSError(errno.EROFS, os.strerror(errno.EROFS), arguments[0])
        if len(events) == trouble.at + 1:
            _strike(trouble)

    try:
        sys.addaudithook(watch)
        run(folder)
    except BaseException as error:
        refused = (
            trouble is not None and trouble.kind in ("full", "read-only") and isinstance(error, OSError | ValueError)
        )
        words = "" if refused and str(folder) in str(error) else f"{type(error).__name__}: {error}"
    os.write(told, json.dumps([events, words[:1000]]).encode())
    os._exit(0)


def _strike(trouble: _Trouble) -> None:
    """Get this process into trouble."""
    if trouble.kind == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    elif trouble.kind == "clock":
        now, calls = time.time, iter(range(sys.maxsize))
        time.time = lambda: now() + (_DAY if next(calls) % 2 else -_DAY)
    else:  # the system lets a file grow that far, and then kills a run that is to be cut, and lets no other write
        most = trouble.half or 1 if trouble.kind == "cut" else 0
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))


def _changes(event: str, arguments: tuple[Any, ...], folder: str) -> bool:
    """Whether an audit event changes something in a folder."""
    if event == "open":
        if isinstance(arguments[0], int) or not arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
            return False
    elif event not in _CHANGES:
        return False
    relative = event in ("os.remove", "os.rmdir") and arguments[1] != -1  # to a folder that is open, as rmtree does it
    paths = [os.fsdecode(one) for one in arguments[:2] if isinstance(one, str | bytes | os.PathLike)]
    return relative or any(path.startswith(folder) for path in paths)
