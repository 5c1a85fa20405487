"""Tasks side by side: results, news, failures, deaths and requests to stop, as those who begin them see it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from tasks import (
    UnpicklableError,
    die_at_first,
    fail,
    give_unpicklable,
    last,
    raise_unpicklable,
    slow_square,
    square,
    sys_exit,
    until_begun,
    where,
)

from baselines.engines.parallel import (
    BrokenOff,
    Channel,
    Failure,
    Interrupted,
    StopRequest,
    Task,
    run_side_by_side,
    stop_on_signals,
)

ROOT = Path(__file__).resolve().parents[2]


def outcomes(tasks: Mapping[str, Task[Any]], jobs: int = 2, **options: Any) -> dict[str, Any]:
    found = list(run_side_by_side(tasks, jobs, **options))
    assert len(found) == len(dict(found)), "one outcome for each task"
    return dict(found)


@pytest.mark.parametrize("jobs", [1, 2])
def test_results_and_news_are_those_of_the_tasks(jobs: int):
    told: list[tuple[str, Any]] = []
    tasks = {str(number): partial(square, number) for number in range(5)}
    ends = []
    for name, result in run_side_by_side(tasks, jobs, tell=lambda *news: told.append(news)):
        ends.append((name, result))
        assert [part for whose, (_, part) in told if whose == name] == [0, 1, 2], "in order, and before the result"
    assert sorted(ends) == [(str(number), number**2) for number in range(5)]


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_failure_leaves_the_others_alone(jobs: int):
    errors = {"a": ValueError("no\nsuch option"), "b": TypeError("a bug"), "c": UnpicklableError(1, 2)}
    tasks = {name: partial(fail, error) for name, error in errors.items() if jobs == 1 or name != "c"}
    found = outcomes({**tasks, "good": partial(square, 3)}, jobs)
    assert found.pop("good") == 9
    assert found["a"].message == "no such option" and isinstance(found["a"].error, ValueError)
    assert found["b"].message.startswith("TypeError: a bug (tasks.py, line ")


def test_what_cannot_be_sent_is_said():
    found = outcomes({"error": raise_unpicklable, "result": give_unpicklable, "good": partial(square, 2)})
    assert "UnpicklableError: 1 and 2" in found["error"].message
    assert "its result is lost" in found["result"].message
    assert found["good"] == 4


def test_an_exit_is_a_failure():
    assert "exit status 3" in outcomes({"exit": partial(sys_exit, 3)}, 1)["exit"].message


def test_a_request_to_stop_reaches_what_runs_and_the_rest_does_not_begin(tmp_path: Path):
    stop, folders = StopRequest(), [tmp_path / name for name in "abcd"]
    for folder in folders:
        folder.mkdir()
    tasks = {"seen": partial(until_begun, folders[:1]), **{folder.name: partial(last, folder) for folder in folders}}
    found: dict[str, Any] = {}
    for name, outcome in run_side_by_side(tasks, 2, stop=stop):
        stop.made = True
        found[name] = outcome
    assert found.pop("seen") is None
    assert {"a"} <= set(found) <= {"a", "b"}, "the second may have begun meanwhile"
    assert all(isinstance(outcome.error, Interrupted) for outcome in found.values())
    assert {folder.name for folder in folders if (folder / "ended").exists()} == set(found)


def test_a_request_to_stop_in_this_process():
    stop = StopRequest()
    assert outcomes({"first": partial(ask_to_stop, stop), "second": partial(square, 2)}, 1, stop=stop) == {
        "first": None
    }


def ask_to_stop(stop: StopRequest, _: Channel) -> None:
    stop.made = True


def test_workers_have_the_folder_and_the_threads_that_they_are_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Also those that have run tasks elsewhere before."""
    outcomes({"a": where, "b": where})
    monkeypatch.chdir(tmp_path)
    assert outcomes({"a": where, "b": where}) == dict.fromkeys("ab", (str(tmp_path), "1"))
    assert outcomes({"a": where, "b": where}, threads=2) == dict.fromkeys("ab", (str(tmp_path), "2"))


def test_closing_ends_what_runs(tmp_path: Path):
    (tmp_path / "a").mkdir()
    running = run_side_by_side({"a": partial(last, tmp_path / "a"), "b": partial(slow_square, 1)}, 2)
    with closing(running) as found:
        assert next(found) == ("b", 1)
    process = int((tmp_path / "a/began").read_text())
    with pytest.raises(ProcessLookupError):
        os.kill(process, 0)
    assert not (tmp_path / "a/ended").exists()


def test_a_killed_worker_loses_nothing(tmp_path: Path):
    """Its task is begun again once, and so is what ran beside it; no outcome is told twice."""
    squares = {str(number): partial(slow_square, number) for number in range(3)}
    found = outcomes({"killed": partial(die_at_first, tmp_path, 1), **squares})
    assert found == {"killed": "after 1", **{str(number): number**2 for number in range(3)}}


def test_a_task_that_always_dies_is_reported_and_the_others_finish(tmp_path: Path):
    squares = {str(number): partial(slow_square, number) for number in range(2)}
    found = outcomes({"killed": partial(die_at_first, tmp_path, 99), **squares})
    broken = found.pop("killed")
    assert isinstance(broken, Failure) and isinstance(broken.error, BrokenOff)
    assert len(list(tmp_path.glob("try*"))) == 2
    assert found == {str(number): number**2 for number in range(2)}


# From outside

SCRIPT = """
import sys, time
sys.path[:0] = [{root!r}, {tests!r}]
from functools import partial
from pathlib import Path
from baselines.engines.parallel import StopRequest, run_side_by_side, stop_on_signals
from tasks import last
stop = StopRequest()
with stop_on_signals(stop, lambda: print("asked", flush=True)):
    tasks = {{name: partial(last, Path(name)) for name in "ab"}}
    for name, outcome in run_side_by_side(tasks, 2, stop=stop):
        print(name, outcome.message, flush=True)
"""


@pytest.fixture
def process(tmp_path: Path):
    """A process with two tasks under way."""
    for name in "ab":
        (tmp_path / name).mkdir()
    code = SCRIPT.format(root=str(ROOT), tests=str(ROOT / "tests" / "helpers"))
    started = subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    wait_for(tmp_path / "a/began")
    wait_for(tmp_path / "b/began")
    yield started
    started.kill()
    started.communicate()


def wait_for(path: Path) -> None:
    deadline = time.monotonic() + 60
    while not path.exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    assert path.exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_to_the_whole_group_is_a_request_to_stop(number: int, process: subprocess.Popen[str]):
    """As Ctrl-C in a terminal is: the workers get it, too, and leave it to the one that began them."""
    os.killpg(process.pid, number)
    output, errors = process.communicate(timeout=60)
    assert errors == "" and process.returncode == 0
    assert sorted(output.splitlines()) == ["a saved", "asked", "b saved"]


def test_tasks_stop_when_nobody_waits_for_them(process: subprocess.Popen[str], tmp_path: Path):
    process.kill()
    for name in "ab":
        wait_for(tmp_path / name / "ended")


def test_a_second_signal_ends_at_once(tmp_path: Path):
    stop = StopRequest()
    with stop_on_signals(stop):
        signal.raise_signal(signal.SIGTERM)
        assert stop.made
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
