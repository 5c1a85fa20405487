"""Tasks side by side, in processes here or on a cluster of Ray: results, news, failures, deaths, stops, folders."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from clusters import local_cluster
from gymnasium.error import DependencyNotInstalled
from refusals import refused
from tasks import (
    die_at_first,
    fail,
    give_unpicklable,
    last,
    raise_unpicklable,
    slow_square,
    square,
    until_begun,
    where,
    where_it_works,
)

from baselines.engines import ray_cluster, ray_pool
from baselines.engines.carrying import carry
from baselines.engines.options import WithStorage
from baselines.engines.parallel import (
    BrokenOff,
    Engine,
    Failure,
    Interrupted,
    StopRequest,
    Task,
    run_side_by_side,
    stop_on_signals,
)
from baselines.engines.storage import Storage
from baselines.engines.workplace import Workplace

ROOT = Path(__file__).resolve().parents[2]


class Place(NamedTuple):
    """Where tasks run."""

    engine: Engine
    jobs: int

    def outcomes(self, tasks: Mapping[str, Task[Any]], **options: Any) -> dict[str, Any]:
        ends = list(run_side_by_side(tasks, self.jobs, engine=self.engine, **options))
        assert len(ends) == len(dict(ends)), "one outcome for each task"
        return dict(ends)


HERE, PROCESSES, RAY = Place(Engine(), 1), Place(Engine(), 2), Place(Engine("ray"), 2)


@pytest.fixture(scope="module")
def cluster() -> Iterator[None]:
    with local_cluster():
        yield


@pytest.fixture(params=[HERE, PROCESSES, RAY], ids=["here", "processes", "ray"])
def place(request: pytest.FixtureRequest) -> Place:
    if request.param is RAY:
        request.getfixturevalue("cluster")
    return request.param


apart = pytest.mark.parametrize("place", [PROCESSES, RAY], ids=["processes", "ray"], indirect=True)
apart_for_long = pytest.mark.parametrize(
    "place", [PROCESSES, pytest.param(RAY, marks=pytest.mark.slow)], ids=["processes", "ray"], indirect=True
)


def test_results_and_news_are_those_of_the_tasks(place: Place):
    reported: list[tuple[str, Any]] = []
    tasks = {str(number): partial(square, number) for number in range(5)}
    ends = []
    run = run_side_by_side(tasks, place.jobs, engine=place.engine, tell=lambda *news: reported.append(news))
    for name, result in run:
        ends.append((name, result))
        assert [part for task, (_, part) in reported if task == name] == [0, 1, 2], "in order, and before the result"
    assert sorted(ends) == [(str(number), number**2) for number in range(5)]


def test_a_failure_leaves_the_others_alone(place: Place):
    errors = {"value": ValueError("no\nsuch option"), "bug": TypeError("a bug"), "file": OSError(28, "No space left")}
    tasks = {name: partial(fail, error) for name, error in errors.items()}
    outcomes = place.outcomes({**tasks, "good": partial(square, 3)})
    assert outcomes["good"] == 9
    assert outcomes["value"].message == "no such option" and isinstance(outcomes["value"].error, ValueError)
    assert outcomes["bug"].message.startswith("TypeError: a bug (tasks.py, line ")
    assert "No space left" in outcomes["file"].message
    assert place is not RAY or socket.gethostname() in outcomes["file"].message, "names the machine"


@apart
def test_a_result_that_cannot_be_sent_is_a_failure(place: Place):
    outcomes = place.outcomes({"error": raise_unpicklable, "result": give_unpicklable, "good": partial(square, 2)})
    assert "1 and 2" in outcomes["error"].message and "result" in outcomes["result"].message
    assert outcomes["good"] == 4


@apart
def test_a_request_to_stop_reaches_what_runs_and_the_rest_does_not_begin(place: Place, tmp_path: Path):
    stop, folders = StopRequest(), [tmp_path / name for name in "abcd"]
    for folder in folders:
        folder.mkdir()
    tasks = {"seen": partial(until_begun, folders[:1]), **{folder.name: partial(last, folder) for folder in folders}}
    outcomes: dict[str, Any] = {}
    for name, outcome in run_side_by_side(tasks, 2, engine=place.engine, stop=stop):
        stop.made = True
        outcomes[name] = outcome
    assert outcomes.pop("seen") is None
    assert "a" in outcomes and len(outcomes) <= 2, "another one may have begun meanwhile"
    assert all(outcome.message == "saved" and isinstance(outcome.error, Interrupted) for outcome in outcomes.values())
    assert {folder.name for folder in folders if (folder / "ended").exists()} == set(outcomes)


@apart
def test_workers_have_the_folder_and_the_threads_that_they_are_given(
    place: Place, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Also those that have run tasks elsewhere before."""
    tasks = {"a": where, "b": where}  # a single one would run in this process
    place.outcomes(tasks)
    monkeypatch.chdir(tmp_path)
    for threads in (1, 2):
        assert place.outcomes(tasks, threads=threads) == dict.fromkeys(tasks, (str(tmp_path), str(threads)))
    if place is RAY:
        with pytest.raises(ValueError, match="--threads 3"):
            place.outcomes({"a": where}, threads=3)


@apart_for_long
def test_closing_ends_what_runs(place: Place, tmp_path: Path):
    (tmp_path / "a").mkdir()
    tasks = {"a": partial(last, tmp_path / "a"), "b": partial(until_begun, [tmp_path / "a"])}
    with closing(run_side_by_side(tasks, 2, engine=place.engine)) as ends:
        assert next(ends) == ("b", None)
    assert place.outcomes({"c": partial(square, 2), "d": partial(square, 3)}) == {"c": 4, "d": 9}, "the cores are free"
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "a/began").read_text()), 0)
    assert not (tmp_path / "a/ended").exists()


@apart
def test_a_killed_worker_loses_nothing(place: Place, tmp_path: Path):
    """Its task is begun again once, and so is what ran beside it; no outcome comes twice."""
    squares = {str(number): partial(slow_square, number) for number in range(3)}
    outcomes = place.outcomes({"killed": partial(die_at_first, tmp_path, 1), **squares})
    assert outcomes == {"killed": "after 1", "0": 0, "1": 1, "2": 4}


@apart_for_long
def test_a_task_that_always_dies_is_reported_and_the_others_finish(place: Place, tmp_path: Path):
    outcomes = place.outcomes({"killed": partial(die_at_first, tmp_path, 99), "good": partial(slow_square, 2)})
    broken = outcomes.pop("killed")
    assert isinstance(broken, Failure) and isinstance(broken.error, BrokenOff)
    assert len(list(tmp_path.glob("try*"))) == (ray_pool.ATTEMPTS if place is RAY else 2)
    assert outcomes == {"good": 4}


class TestSignals:
    SCRIPT = """
import sys
sys.path[:0] = [{root!r}, {helpers!r}]
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
    def process(self, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
        """A process with two tasks under way."""
        for name in "ab":
            (tmp_path / name).mkdir()
        code = self.SCRIPT.format(root=str(ROOT), helpers=str(ROOT / "tests" / "helpers"))
        piped: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        started = subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path, start_new_session=True, **piped)
        for name in "ab":
            wait_for(tmp_path / name / "began")
        yield started
        started.kill()
        started.communicate()

    def test_a_signal_to_the_whole_group_is_a_request_to_stop(self, process: subprocess.Popen[str]):
        """As Ctrl-C in a terminal is: the workers get it, too, and leave it to the one that began them."""
        os.killpg(process.pid, signal.SIGINT)
        output, errors = process.communicate(timeout=60)
        assert errors == "" and process.returncode == 0
        assert sorted(output.splitlines()) == ["a saved", "asked", "b saved"]

    def test_tasks_stop_when_nobody_waits_for_them(self, process: subprocess.Popen[str], tmp_path: Path):
        process.kill()
        for name in "ab":
            wait_for(tmp_path / name / "ended")

    def test_a_second_signal_ends_at_once(self):
        stop = StopRequest()
        with stop_on_signals(stop):
            signal.raise_signal(signal.SIGTERM)
            assert stop.made
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)


def wait_for(path: Path) -> None:
    deadline = time.monotonic() + 60
    while not path.exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    assert path.exists()


class TestRay:
    def test_workers_with_other_code_are_refused(self, cluster: None, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setattr(ray_pool, "code_and_packages", lambda: "another commit")
        with pytest.raises(ValueError, match=f"worker on {socket.gethostname()}"):
            RAY.outcomes({"a": partial(square, 2)})

    def test_without_ray_its_extra_is_named(self, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setitem(sys.modules, "ray", None)
        with pytest.raises(DependencyNotInstalled, match=r"\[ray\]"):
            RAY.outcomes({"a": partial(square, 2)})

    def test_an_address_that_does_not_answer_is_refused(self):
        pytest.importorskip("ray")
        for address in ("127.0.0.1:1", "nonsense", "ray://127.0.0.1:10001"):
            with pytest.raises(OSError, match=address.removesuffix("127.0.0.1:10001")):
                ray_cluster.require_answer(address)

    def test_a_folder_that_workers_do_not_see_needs_a_storage(self, cluster: None, tmp_path: Path):
        with Workplace(WithStorage(engine="ray"), tmp_path / "out") as workplace:
            task = workplace.task("a", tmp_path / "out", where_it_works, Path("checkpoint"))
            assert RAY.outcomes({"a": task})["a"] == str(tmp_path / "out")
        assert list((tmp_path / "out").iterdir()) == []
        message = RAY.outcomes({"a": task})["a"].message  # without the file that proves it
        assert all(word in message for word in (socket.gethostname(), str(tmp_path / "out"), "--storage"))

    def test_options_that_do_not_fit_are_refused(self):
        for name, value in {"address": "auto", "storage": "s3://bucket", "jobs": 0}.items():
            refused(ValueError, (f"--{name}",), WithStorage(**{name: value}).check_engine)


class TestFolders:
    def test_a_storage_keeps_folders(self, tmp_path: Path):
        storage, folder = Storage(str(tmp_path / "store")), tmp_path / "run"
        storage.check()
        assert not storage.holds("run") and not storage.fetch("run", tmp_path / "none")
        (folder / "best").mkdir(parents=True)
        for content in (b"first", b"second"):
            (folder / "best/weights").write_bytes(content)
            storage.keep("run", folder)
        assert storage.fetch("run", tmp_path / "copy") and (tmp_path / "copy/best/weights").read_bytes() == b"second"
        assert [path.name for path in (tmp_path / "store").iterdir()] == ["run.zip"], "nothing half-written"
        (tmp_path / "store/run.zip").write_bytes(b"damaged")
        with pytest.raises(ValueError, match=r"run.zip in .* is damaged"):
            storage.fetch("run", tmp_path / "copy")
        storage.forget("run")
        assert not storage.holds("run")

    def test_a_storage_that_cannot_be_used_is_named(self, tmp_path: Path):
        (tmp_path / "file").write_text("")
        with pytest.raises(OSError, match=f"--storage {tmp_path}/file/store from {socket.gethostname()}"):
            Storage(f"{tmp_path}/file/store").check()
        with pytest.raises(ValueError, match="--storage nowhere://bucket"):
            Storage("nowhere://bucket").check()

    def test_a_folder_is_carried_to_machines_that_lack_it(self, tmp_path: Path):
        (tmp_path / "own").mkdir()
        (tmp_path / "own/file").write_bytes(b"content")
        carried = carry(tmp_path / "own", [tmp_path / "own/file"])
        assert carried.here() == tmp_path / "own"
        (tmp_path / "own/file").write_bytes(b"another")
        assert (carried.here() / "file").read_bytes() == b"content" and carried.here() == carried.here()
        assert carried.here() != tmp_path / "own"
