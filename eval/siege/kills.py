"""Kills at every event in the file system: what is begun again has to come to the end that it would have had.

A process that is killed leaves what it has written so far. Trainings, comparisons and searches for gains promise that
this is enough: `--resume`, or the same command again, goes on to the same files. A child process counts the events
that change its folder, as Python's audit hooks tell them, and ends itself at one of them; another child goes on.
"""

from __future__ import annotations

import io
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
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context, get_start_method, set_start_method
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import torch
from rich.console import Console

from agents.learners.ppo import PpoConfig
from agents.learners.registry import ALGORITHMS
from agents.learners.student import StudentConfig
from agents.policy.bundle import read_weights
from agents.runs.settings import RunConfig
from agents.runs.training import train
from baselines.engines.options import WithStorage
from baselines.gains import read_file
from baselines.tuning.race import MIN_BUDGET
from baselines.tuning.run import tune
from eval.comparison.run import choose_methods, compare
from eval.comparison.schema import read_results, write_results
from eval.comparison.sets import development_set
from eval.siege.part import Siege

_LONGEST = 120.0  # that a child may take [s]
_CHANGES = ("os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.chmod", "os.link", "os.symlink", "os.truncate")
_HALF = 400  # largest number of bytes after which a write is cut [bytes]
_MOST = 60  # events of one subject, in a whole siege
_WORKERS = 2
_SMALL = 0.05  # share up to which one subject has to do, which the seed chooses


class Subject(NamedTuple):
    """Something that writes files, and can be begun again."""

    name: str
    begin: Callable[[Path], object]
    go_on: Callable[[Path], object]  # which first checks that what is there can be read
    meaning: Callable[[Path], dict[str, Any]]  # of the finished files, without what may differ
    given: dict[str, str] = {}  # text of files that are there before  # noqa: RUF012


def besiege(share: float, seed: int) -> Siege:
    """Kill trainings, a comparison and a search for gains at events in the file system, and go on.

    Args:
        share: Of a whole siege, which has 60 events of each subject, evenly spread.
        seed: Chooses events, and how much of a file a cut write leaves.
    """
    blind = "power cuts, after which a disk may lack what was written last, and runs that are killed more than twice"
    siege = Siege("kills", "kills", blind)
    chosen = SUBJECTS if share > _SMALL else (SUBJECTS[seed % len(SUBJECTS)],)
    if get_start_method(allow_none=True) == "loky":  # joblib's, which a process that is spawned does not know
        set_start_method("spawn", force=True)
    with ProcessPoolExecutor(_WORKERS, get_context("spawn")) as pool:
        for count, found in pool.map(partial(attack, share=share, seed=seed), chosen):
            siege.count += count
            siege.found += found
    return siege


def attack(subject: Subject, share: float, seed: int) -> tuple[int, list[str]]:
    """Kill one subject at some of its events.

    Args:
        subject: What is killed.
        share: Of a whole siege.
        seed: See `besiege`.

    Returns:
        The number of kills, and a line for each that a promise is broken after.
    """
    torch.set_num_threads(1)  # a process that has others cannot be forked
    rng, found, count = np.random.default_rng(seed), list[str](), 0
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "run"
        _prepare(subject, folder)
        subject.begin(folder)  # so that all children have what is compiled
        _prepare(subject, folder)
        whole = _in_child(subject.begin, folder)
        if whole.words:
            return 0, [f"{subject.name} without a kill: {whole.words}"]
        wanted, events = subject.meaning(folder), len(whole.events)
        chosen = max(1, round(share * min(events, _MOST)))
        for at in (int((k + rng.random()) * events / chosen) for k in range(chosen)):
            half = int(rng.integers(_HALF)) if whole.events[at] == "open" and rng.random() < 0.5 else None
            again = int(rng.integers(events)) if rng.random() < 0.25 else None
            kills = [_Kill(at, half), *([_Kill(again)] if again is not None else [])]
            count += len(kills)
            if words := _after(subject, folder, kills, wanted):
                where = ", then ".join(str(kill) for kill in kills)
                line = f"{subject.name}, seed {seed}, killed {where} ({whole.events[at]}): {words}"
                found.append(" ".join(line.split())[:600])
    return count, found


class _Kill(NamedTuple):
    at: int  # number of the event
    half: int | None = None  # where the event opens a file: how many bytes are still written, of any file

    def __str__(self) -> str:
        return f"at event {self.at}" if self.half is None else f"{self.half} bytes after event {self.at}"


def _after(subject: Subject, folder: Path, kills: list[_Kill], wanted: dict[str, Any]) -> str:
    """Words for what is wrong after a run was killed once or more and has gone on; empty if nothing is."""
    _prepare(subject, folder)
    for k, kill in enumerate(kills):
        end = _in_child(subject.go_on if k else subject.begin, folder, kill)
        if end.words:
            return end.words
        for path in folder.rglob(".*"):  # as if an hour had passed, after which half-written files are taken away
            os.utime(path, (0, 0))
    end = _in_child(subject.go_on, folder)
    if end.words:
        return end.words
    if left := [path.name for path in folder.rglob(".*") if path.name != ".lock"]:
        return f"leaves {', '.join(left)}"
    try:
        reached = subject.meaning(folder)
    except Exception as error:  # whatever it is, the files are not what they should be
        return f"{type(error).__name__}: {error}"
    differ = sorted(name for name in {*wanted, *reached} if wanted.get(name) != reached.get(name))
    return f"other files than without a kill: {', '.join(differ)}" if differ else ""


def _prepare(subject: Subject, folder: Path) -> None:
    """Empty the folder, but for what is given."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for name, text in subject.given.items():
        (folder / name).write_text(text)


# Children


class _End(NamedTuple):
    """How a child ended: killed as wanted, or with the kinds of its events, and words for what went wrong."""

    events: list[str] = []  # noqa: RUF012
    words: str = ""


def _in_child(run: Callable[[Path], object], folder: Path, kill: _Kill | None = None) -> _End:
    """Run something in a forked child, which is killed as it should be, or after too long a time."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        _be_child(run, folder, kill, writing)
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
    wanted = kill is not None and os.WTERMSIG(status) in (signal.SIGKILL, signal.SIGXFSZ)
    return _End() if wanted else _End(words=f"it died with the status {status}")


def _be_child(run: Callable[[Path], object], folder: Path, kill: _Kill | None, told: int) -> None:
    """Run something as a child, tell of its end, and end this process."""
    events, words = list[str](), ""
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)
    os.dup2(nothing, 2)
    signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))

    def watch(event: str, arguments: tuple[Any, ...]) -> None:
        if not _changes(event, arguments, str(folder)):
            return
        events.append(event)
        if kill is not None and len(events) == kill.at + 1:
            if kill.half is None:
                os.kill(os.getpid(), signal.SIGKILL)
            else:  # the system lets the next write go that far, and then kills
                resource.setrlimit(resource.RLIMIT_FSIZE, (kill.half or 1, kill.half or 1))

    try:
        sys.addaudithook(watch)
        run(folder)
    except BaseException as error:
        words = f"{type(error).__name__}: {error}"
    os.write(told, json.dumps([events, words[:1000]]).encode())
    os._exit(0)


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


# Subjects


def _train(config: RunConfig, folder: Path, resume: bool) -> None:
    for kind in ("best", "last"):
        if resume and (folder / kind / "policy.json").exists():
            read_weights(folder / kind)
    train(_options(config, folder, resume), ALGORITHMS[config.algorithm].make_learner)


def _options(config: RunConfig, folder: Path, resume: bool) -> RunConfig:
    """Options of the same training in another folder."""
    return replace(config, out=folder, resume=resume and (folder / "config.json").exists())


def _training(folder: Path) -> dict[str, Any]:
    curve = pd.read_csv(folder / "validation.csv").drop(columns="seconds")
    meaning: dict[str, Any] = {"validation.csv": curve.to_csv()}
    meaning["config.json"] = json.loads((folder / "config.json").read_text())["identity"]
    for kind in ("best", "last"):
        _, _, content = read_weights(folder / kind)
        origin = content.pop("provenance")
        content.pop("content_hash")
        origin.pop("commit")  # of a checkout that is worked in
        for part in (origin["run"], origin["reached"], origin["config"]):
            part.pop("seconds", None)
            part.pop("resume", None)
        origin["curve"] = [[steps, cost] for steps, _, cost in origin["curve"]]
        meaning[f"{kind}/policy.json"] = [content, origin]
    written = (*folder.glob("*"), *folder.glob("*/*"))
    names = {str(path.relative_to(folder)) for path in written if not path.name.startswith((".", "progress", "events"))}
    return meaning | dict.fromkeys(names - {*meaning})


def _compare(folder: Path) -> None:
    if (folder / "results.json").exists():
        read_results(folder / "results.json")
    found = compare(choose_methods(("paper", "rigid")), development_set().only(["nominal"]), 4, folder, 1)
    write_results(found, folder)


def _comparison(folder: Path) -> dict[str, Any]:
    results = read_results(folder / "results.json")
    for name in ("seconds", "pairs_kept_before", "commit"):
        results["provenance"].pop(name)
    for row in results["rows"]:
        row.pop("action_us")
    kept = {path.name: path.read_bytes() for path in (*folder.glob("pairs/*.npz"), folder / "episodes.csv")}
    return {"results.json": results, **kept}


@dataclass(frozen=True)
class _Tuning:
    resume: bool

    def __call__(self, folder: Path) -> None:
        resume = self.resume and (folder / "zv.journal").exists()
        read_file(folder / "gains.json")
        where: dict[str, Any] = {"out": folder / "gains.json", "journals": folder, "options": WithStorage(jobs=1)}
        quiet = Console(file=io.StringIO())
        tune(["zv"], budget=MIN_BUDGET, seed=0, resume=resume, condition=None, console=quiet, **where)


def _tuning(folder: Path) -> dict[str, Any]:
    found = read_file(folder / "gains.json")
    origin = found["zv"]["provenance"]
    for name in ("date", "commit", "seconds", "trials", "pruned", "failed", "refused"):  # a trial that is killed counts
        origin.pop(name)
    origin["steps"] = origin["steps"] <= MIN_BUDGET
    return found


_FEW: dict[str, Any] = {"arms": 4, "validation_arms": 2, "hold": 40, "hidden": (4,)}
_PPO = PpoConfig(total_steps=64, validation_every=32, rollout_steps=8, batch_size=32, **_FEW)
_STUDENT = StudentConfig(rounds=1, gru_width=4, batch_size=4, **_FEW)
SUBJECTS = (
    Subject("a training", partial(_train, _PPO, resume=False), partial(_train, _PPO, resume=True), _training),
    Subject("a search for gains", _Tuning(False), _Tuning(True), _tuning, {"gains.json": '{"zvd": {"gains": {}}}'}),
    Subject("a student", partial(_train, _STUDENT, resume=False), partial(_train, _STUDENT, resume=True), _training),
    Subject("a comparison", _compare, _compare, _comparison),
)
