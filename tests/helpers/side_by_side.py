"""Tasks to run side by side, which workers import from here; and what holds of them whatever runs them.

A class of tests inherits what holds, and has a fixture `place`.
"""

import os
import signal
import time
from collections.abc import Mapping
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from baselines.engines import parallel
from baselines.engines.parallel import Channel, Failure, SideBySide, StopRequest, Task, run_side_by_side


def square(number: int, channel: Channel, wait: float = 0.0) -> int:
    time.sleep(wait)
    for part in range(3):
        channel.report((number, part))
    return number**2


def fail(error: Exception, _: Channel) -> None:
    raise error


def last(folder: Path, channel: Channel) -> str:
    folder.mkdir(exist_ok=True)
    (folder / "began").write_text(str(os.getpid()))
    while not channel.stop.made:
        time.sleep(0.01)
    (folder / "ended").write_text("")
    raise parallel.Interrupted("saved")


def die_at_first(folder: Path, times: int, channel: Channel) -> str:
    """Be killed so many times, and succeed after that."""
    folder.mkdir(exist_ok=True)
    tries = len(list(folder.glob("try*")))
    (folder / f"try{tries}").write_text("")
    if tries < times:
        time.sleep(0.2)
        os.kill(os.getpid(), signal.SIGKILL)
    return f"after {tries}"


def where(_: Channel) -> tuple[str, str | None]:
    return os.getcwd(), os.environ.get("OMP_NUM_THREADS")


def where_it_works(folder: Path, _: Channel) -> str:
    return str(folder)


def go_on(folder: Path, channel: Channel) -> list[int]:
    """Do what is left of four steps, saving each in a checkpoint, and return those that were done."""
    checkpoint = folder / "checkpoint"
    steps = list(range(int(checkpoint.read_text()) if checkpoint.exists() else 0, 4))
    for step in steps:
        checkpoint.write_text(str(step + 1))
        channel.report(step)
    return steps


class UnpicklableError(Exception):
    def __init__(self, first: int, second: int) -> None:
        super().__init__(f"{first} and {second}")


def raise_unpicklable(_: Channel) -> None:
    raise UnpicklableError(1, 2)


def give_unpicklable(_: Channel) -> Any:
    return lambda: None


def until_begun(folders: list[Path], _: Channel) -> None:
    while not all((folder / "began").exists() for folder in folders):
        time.sleep(0.01)


class Place(SideBySide):
    def outcomes(self, tasks: Mapping[str, Task[Any]], **options: Any) -> dict[str, Any]:
        ends = list(run_side_by_side(tasks, self, **options))
        assert len(ends) == len(dict(ends)), "one outcome for each task"
        return dict(ends)


class Anywhere:
    def test_results_and_news_are_those_of_the_tasks(self, place: Place):
        reported: list[tuple[str, Any]] = []
        tasks = {str(number): partial(square, number) for number in range(5)}
        ends = []
        for name, result in run_side_by_side(tasks, place, tell=lambda *news: reported.append(news)):
            ends.append((name, result))
            assert [part for task, (_, part) in reported if task == name] == [0, 1, 2], "in order, before the result"
        assert sorted(ends) == [(str(number), number**2) for number in range(5)]

    def test_a_failure_leaves_the_others_alone(self, place: Place):
        errors = {"value": ValueError("no\nsuch option"), "bug": TypeError("a bug"), "file": OSError(28, "No space")}
        tasks = {name: partial(fail, error) for name, error in errors.items()}
        outcomes = place.outcomes({**tasks, "good": partial(square, 3)})
        assert outcomes["good"] == 9
        assert outcomes["value"].message == "no such option" and isinstance(outcomes["value"].error, ValueError)
        assert outcomes["bug"].message.startswith("TypeError: a bug (side_by_side.py, line ")
        assert "No space" in outcomes["file"].message


class InWorkers(Anywhere):
    def test_a_result_that_cannot_be_sent_is_a_failure(self, place: Place):
        outcomes = place.outcomes({"error": raise_unpicklable, "result": give_unpicklable, "good": partial(square, 2)})
        assert "1 and 2" in outcomes["error"].message and "result" in outcomes["result"].message
        assert outcomes["good"] == 4

    def test_a_request_to_stop_reaches_what_runs_and_the_rest_does_not_begin(self, place: Place, tmp_path: Path):
        stop, folders = StopRequest(), [tmp_path / name for name in "abcd"]
        seen = {"seen": partial(until_begun, folders[:1])}
        tasks = {**seen, **{folder.name: partial(last, folder) for folder in folders}}
        outcomes: dict[str, Any] = {}
        for name, outcome in run_side_by_side(tasks, place, stop=stop):
            stop.made = True
            outcomes[name] = outcome
        assert outcomes.pop("seen") is None
        assert "a" in outcomes and len(outcomes) <= 2, "another one may have begun meanwhile"
        assert all(end.message == "saved" and isinstance(end.error, parallel.Interrupted) for end in outcomes.values())
        assert {folder.name for folder in folders if (folder / "ended").exists()} == set(outcomes)

    def test_workers_have_folder_and_threads(self, place: Place, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        """Also those that have run tasks elsewhere before."""
        tasks = {"a": where, "b": where}  # a single one would run in this process
        place.outcomes(tasks)
        monkeypatch.chdir(tmp_path)
        for threads in (1, 2):
            assert place.outcomes(tasks, threads=threads) == dict.fromkeys(tasks, (str(tmp_path), str(threads)))

    def test_closing_ends_what_runs(self, place: Place, tmp_path: Path):
        tasks = {"a": partial(last, tmp_path / "a"), "b": partial(until_begun, [tmp_path / "a"])}
        with closing(run_side_by_side(tasks, place)) as ends:
            assert next(ends) == ("b", None)
        assert place.outcomes({"c": partial(square, 2), "d": partial(square, 3)}) == {"c": 4, "d": 9}, "cores are free"
        with pytest.raises(ProcessLookupError):
            os.kill(int((tmp_path / "a/began").read_text()), 0)
        assert not (tmp_path / "a/ended").exists()

    def test_a_killed_worker_loses_nothing(self, place: Place, tmp_path: Path):
        """Its task is begun again, and so is what ran beside it; one that always dies is reported."""
        squares = {str(number): partial(square, number, wait=0.5) for number in range(3)}
        killed = {"once": partial(die_at_first, tmp_path / "once", 1)}
        assert place.outcomes({**killed, **squares}) == {"once": "after 1", "0": 0, "1": 1, "2": 4}
        outcomes = place.outcomes({"always": partial(die_at_first, tmp_path / "always", 99), **squares})
        broken = outcomes.pop("always")
        assert isinstance(broken, Failure) and isinstance(broken.error, parallel.BrokenOff)
        assert len(list((tmp_path / "always").glob("try*"))) == 2
        assert outcomes == {"0": 0, "1": 1, "2": 4}
