"""Trouble at any event in the file system: a run that is begun again reaches the end that it would have had.

A process that is killed leaves what it has written so far, and so does one whose disk is full or read-only. Trainings
and comparisons promise that `--resume`, or the same command again, then goes on to the same files.
A forked child counts the events that change its folder, by Python's audit hooks, and gets into trouble at one of them;
another child goes on.
"""

import errno
import json
import os
import resource
import shutil
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context, get_start_method, set_start_method
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import pandas as pd
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from agents.learners.ppo import PpoConfig
from agents.policy.bundle import POLICY_FILE, read_bundle
from agents.runs.training import train
from baselines.engines.parallel import SideBySide
from eval.comparison.run import Run, choose_methods, compare
from eval.comparison.schema import read_results, write_results
from eval.comparison.sets import development_set

Trouble = tuple[str, float]
LONGEST = 120  # that a child may take [s]
CHANGES = ("os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.chmod", "os.link", "os.symlink", "os.truncate")
KINDS = st.sampled_from(["killed", "killed", "full", "read-only"])
TROUBLES = st.lists(st.tuples(KINDS, st.floats(0, 1, exclude_max=True)), min_size=1, max_size=2)
"""What happens to a run, and at which share of its events: from then on, a disk is full or read-only."""


class Subject(NamedTuple):
    begin: Callable[[Path], object]
    go_on: Callable[[Path], object]  # which first checks that what is there can be read
    meaning: Callable[[Path], dict[str, Any]]  # of the finished files, without what may differ


def _train(folder: Path, resume: bool) -> None:
    for kind in ("best", "last"):
        if resume and (folder / kind / POLICY_FILE).exists():
            read_bundle(folder / kind)
    few: dict[str, Any] = {"total_steps": 64, "validation_every": 32, "arms": 4, "validation_arms": 2, "hidden": (4,)}
    few |= {"rollout_steps": 8, "batch_size": 32, "hold": 40, "base": "paper", "moves": 1, "critic_steps": 0}
    train(PpoConfig(out=folder, resume=resume and (folder / "config.json").exists(), **few))


def _training(folder: Path) -> dict[str, Any]:
    meaning: dict[str, Any] = {"config.json": json.loads((folder / "config.json").read_text())["identity"]}
    meaning["validation.csv"] = pd.read_csv(folder / "validation.csv").drop(columns="seconds").to_csv()
    for kind in ("best", "last"):
        weights, spec, *_ = read_bundle(folder / kind)
        curve = [[steps, cost] for steps, _, cost in spec.provenance["curve"]]
        arrays = {name: array.tolist() for name, array in weights.arrays.items()}
        meaning[kind] = [replace(spec, provenance={}), arrays, curve]
    written = (*folder.glob("*"), *folder.glob("*/*"))
    names = {str(path.relative_to(folder)) for path in written if not path.name.startswith((".", "progress", "events"))}
    return meaning | dict.fromkeys(names - {*meaning})


def _compare(folder: Path) -> None:
    if (folder / "results.json").exists():
        read_results(folder / "results.json")
    nominal = development_set().only(["nominal"])
    write_results(compare(choose_methods(("paper", "rigid")), nominal, 4, Run(folder, SideBySide(jobs=1))), folder)


def _comparison(folder: Path) -> dict[str, Any]:
    results = read_results(folder / "results.json")
    for name in ("seconds", "pairs_kept_before", "commit"):
        results["provenance"].pop(name)
    for row in results["rows"]:
        row.pop("action_us")
    kept = {path.name: path.read_bytes() for path in (*folder.glob("parts/*.safetensors"), folder / "episodes.csv")}
    return {"results.json": results, **kept}


SUBJECTS: dict[str, Subject] = {
    "training": Subject(partial(_train, resume=False), partial(_train, resume=True), _training),
    "comparison": Subject(_compare, _compare, _comparison),
}


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
        @given(TROUBLES)
        def run(troubles: list[Trouble]) -> None:
            pool.submit(disturbed, name, folder, troubles, events, wanted).result()

        run()


def undisturbed(name: str, folder: Path) -> tuple[list[str], dict[str, Any]]:
    subject = SUBJECTS[name]
    events: Any = []
    for begin in (subject.begin, partial(in_child, subject.begin)):  # so that all children have what is compiled
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        events = begin(folder)
    return events, subject.meaning(folder)


def disturbed(name: str, folder: Path, troubles: list[Trouble], events: list[str], wanted: dict[str, Any]) -> None:
    subject = SUBJECTS[name]
    shutil.rmtree(folder)
    folder.mkdir()
    for k, trouble in enumerate(troubles):
        in_child(subject.go_on if k else subject.begin, folder, trouble, events)
        for path in folder.rglob(".*"):  # as if an hour had passed, after which half-written files are taken away
            os.utime(path, (0, 0))
    in_child(subject.go_on, folder)
    assert [path.name for path in folder.rglob(".*") if path.name != ".lock"] == []
    reached = subject.meaning(folder)
    assert [name for name in {*wanted, *reached} if wanted.get(name) != reached.get(name)] == []


def in_child(
    run: Callable[[Path], object], folder: Path, trouble: Trouble = ("", 0.0), known: Sequence[str] = ()
) -> list[str]:
    """Run something in a forked child, in trouble at one of the events that are known; return its events, if it can."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        be_child(run, folder, trouble[0], int(trouble[1] * len(known)), writing)
    os.close(writing)
    with open(reading, encoding="utf-8") as file:
        report = file.read()
    _, status = os.waitpid(child, 0)
    if not report:
        assert trouble[0] == "killed" and os.WTERMSIG(status) == signal.SIGKILL, f"it died with the status {status}"
        return []
    events, error = json.loads(report)
    assert not error, error
    return events


def be_child(run: Callable[[Path], object], folder: Path, kind: str, at: int, report: int) -> None:
    """Run something as a child, report its events and its error, and end this process."""
    events, words = list[str](), ""
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)
    os.dup2(nothing, 2)
    signal.alarm(LONGEST)
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)

    def watch(event: str, arguments: tuple[Any, ...]) -> None:
        if not changes(event, arguments, str(folder)):
            return
        events.append(event)
        if kind == "" or len(events) <= at:
            return
        if kind == "read-only":
            raise OSError(errno.EROFS, os.strerror(errno.EROFS), arguments[0])
        if kind == "killed":
            os.kill(os.getpid(), signal.SIGKILL)
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))  # the system refuses all further writes

    try:
        sys.addaudithook(watch)
        run(folder)
    except BaseException as error:
        told = isinstance(error, OSError | ValueError) and str(folder) in str(error)
        words = "" if told and kind in ("full", "read-only") else f"{type(error).__name__}: {error}"
    os.write(report, json.dumps([events, words[:1000]]).encode())
    os._exit(0)


def changes(event: str, arguments: tuple[Any, ...], folder: str) -> bool:
    if event == "open":
        if isinstance(arguments[0], int) or not arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
            return False
    elif event not in CHANGES:
        return False
    relative = event in ("os.remove", "os.rmdir") and arguments[1] != -1  # to a folder that is open, as rmtree does it
    paths = [os.fsdecode(path) for path in arguments[:2] if isinstance(path, str | bytes | os.PathLike)]
    return relative or any(path.startswith(folder) for path in paths)
