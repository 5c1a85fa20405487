"""Tasks on Ray: as on this machine, with deaths, refusals, and folders that other machines do not see."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Mapping
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled
from tasks import die_at_first, fail, give_unpicklable, last, slow_square, square, until_begun, where
from trainings import weights

from agents.learners.ppo import PpoConfig
from agents.learners.registry import ALGORITHMS
from agents.learners.tuning import TuningConfig, counted, tune
from agents.policy.bundle import read_spec
from agents.runs.command_line import main
from agents.runs.monitor import News
from baselines.engines import ray_cluster, ray_pool
from baselines.engines.carrying import carry
from baselines.engines.options import WithStorage
from baselines.engines.parallel import BrokenOff, Channel, Engine, Failure, StopRequest, Task, run_side_by_side
from baselines.engines.storage import Storage
from baselines.engines.workplace import Workplace
from eval.comparison.cache import Part, run_parts
from eval.comparison.methods import added_method, learned_methods, shipped_policies
from eval.comparison.sets import development_set

ray = pytest.importorskip("ray", reason="Ray is not installed: pip install 'beltarm-env[ray]'")
ROOT = Path(__file__).resolve().parents[2]
RAY = Engine("ray")


@pytest.fixture(scope="module", autouse=True)
def cluster():
    """A cluster on this machine, for all tests of this module; its processes find the tests' own tasks."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("PYTHONPATH", f"{ROOT}:{ROOT / 'tests'}")
        with ray_cluster.connected(None, 2):
            yield
    for number, handler in before.items():
        signal.signal(number, handler)


def outcomes(tasks: Mapping[str, Task[Any]], jobs: int | None = 2, **options: Any) -> dict[str, Any]:
    return dict(run_side_by_side(tasks, jobs, engine=RAY, **options))


def test_results_and_news_are_those_of_the_tasks():
    told: list[tuple[str, Any]] = []
    tasks = {str(number): partial(square, number) for number in range(5)}
    ends = []
    for name, result in run_side_by_side(tasks, None, engine=RAY, tell=lambda *news: told.append(news)):
        ends.append((name, result))
        assert [part for whose, (_, part) in told if whose == name] == [0, 1, 2], "in order, and before the result"
    assert sorted(ends) == [(str(number), number**2) for number in range(5)]


def test_failures_leave_the_others_alone(tmp_path: Path):
    errors = {"value": ValueError("no\nsuch option"), "bug": TypeError("a bug"), "file": OSError(28, "No space left")}
    found = outcomes({**{name: partial(fail, error) for name, error in errors.items()}, "good": partial(square, 3)})
    assert found["good"] == 9
    assert found["value"].message == "no such option"
    assert found["bug"].message.startswith("TypeError: a bug (tasks.py, line ")
    assert found["file"].message == f"on {socket.gethostname()}: [Errno 28] No space left", "names the machine"
    assert "its result is lost" in outcomes({"result": give_unpicklable})["result"].message


def test_workers_have_the_folder_and_the_threads_that_they_are_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    assert outcomes({"a": where}) == {"a": (str(tmp_path), "1")}
    assert outcomes({"a": where}, threads=2) == {"a": (str(tmp_path), "2")}
    with pytest.raises(ValueError, match="--threads 3 are more than the 2 cores of the cluster's largest machine"):
        outcomes({"a": where}, threads=3)


def test_a_killed_worker_loses_nothing(tmp_path: Path):
    squares = {str(number): partial(slow_square, number) for number in range(2)}
    found = outcomes({"killed": partial(die_at_first, tmp_path, 1), **squares})
    assert found == {"killed": "after 1", "0": 0, "1": 1}


def test_a_task_that_always_dies_is_reported(tmp_path: Path):
    broken = outcomes({"killed": partial(die_at_first, tmp_path, 99), "good": partial(square, 2)})
    assert broken["good"] == 4
    assert isinstance(broken["killed"], Failure) and isinstance(broken["killed"].error, BrokenOff)
    assert len(list(tmp_path.glob("try*"))) == ray_pool.ATTEMPTS


def test_a_request_to_stop_reaches_what_runs_and_the_rest_does_not_begin(tmp_path: Path):
    stop, folders = StopRequest(), [tmp_path / name for name in "abcd"]
    for folder in folders:
        folder.mkdir()
    tasks = {"seen": partial(until_begun, folders[:1]), **{folder.name: partial(last, folder) for folder in folders}}
    found: dict[str, Any] = {}
    for name, outcome in run_side_by_side(tasks, None, engine=RAY, stop=stop):
        stop.made = True
        found[name] = outcome
    assert found.pop("seen") is None
    assert "a" in found and len(found) <= 2, "a core was free for one more, whichever Ray had ready"
    assert all(end.message == "saved" for end in found.values())
    assert {folder.name for folder in folders if (folder / "ended").exists()} == set(found)


def test_closing_ends_what_runs(tmp_path: Path):
    (tmp_path / "a").mkdir()
    tasks = {"a": partial(last, tmp_path / "a"), "b": partial(until_begun, [tmp_path / "a"])}
    with closing(run_side_by_side(tasks, 2, engine=RAY)) as found:
        assert next(found) == ("b", None)
    assert outcomes({"c": partial(square, 2), "d": partial(square, 3)}) == {"c": 4, "d": 9}, "the cores are free"
    assert not (tmp_path / "a/ended").exists()


def test_workers_with_other_code_are_refused(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(ray_pool, "code_and_packages", lambda: "another commit")
    host = socket.gethostname()
    with pytest.raises(
        ValueError, match=f"the worker on {host} has other code .*: every machine needs the same commit"
    ):
        outcomes({"a": partial(square, 2)})


def test_without_ray_its_extra_is_named(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(DependencyNotInstalled, match=r"pip install 'beltarm-env\[ray\]'"):
        outcomes({"a": partial(square, 2)})


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("127.0.0.1:1", r"no cluster of Ray answers at --address 127.0.0.1:1 \(.*refused\): begin one with `ray start"),
        ("nonsense", r"no cluster of Ray answers at --address nonsense .*: begin one with"),
        ("ray://127.0.0.1:10001", "is of Ray's client: run the command on a machine of the cluster instead"),
    ],
)
def test_an_address_that_does_not_answer_is_refused(address: str, message: str):
    with pytest.raises(OSError, match=message):
        ray_cluster.require_answer(address)


# Folders


def test_a_storage_keeps_folders(tmp_path: Path):
    storage, folder = Storage(str(tmp_path / "store")), tmp_path / "run"
    storage.check()
    assert not storage.holds("run") and not storage.fetch("run", tmp_path / "none")
    (folder / "best").mkdir(parents=True)
    (folder / "best/weights").write_bytes(b"one")
    storage.keep("run", folder)
    (folder / "best/weights").write_bytes(b"two")
    storage.keep("run", folder)
    assert storage.fetch("run", tmp_path / "copy") and (tmp_path / "copy/best/weights").read_bytes() == b"two"
    assert [path.name for path in (tmp_path / "store").iterdir()] == ["run.zip"], "nothing half-written, no trial file"
    (tmp_path / "store/run.zip").write_bytes(b"damaged")
    with pytest.raises(ValueError, match=r"run.zip in .* is damaged .*: delete it, and begin anew"):
        storage.fetch("run", tmp_path / "copy")
    storage.forget("run")
    assert not storage.holds("run")


def test_a_storage_that_cannot_be_used_is_named(tmp_path: Path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match=f"cannot write to --storage {tmp_path}/file/store from {socket.gethostname()}: "):
        Storage(f"{tmp_path}/file/store").check()
    with pytest.raises(ValueError, match="--storage nowhere://bucket cannot be used: Protocol not known"):
        Storage("nowhere://bucket").check()


def test_a_folder_is_carried_to_machines_that_lack_it(tmp_path: Path):
    (tmp_path / "own").mkdir()
    (tmp_path / "own/file").write_bytes(b"content")
    carried = carry(tmp_path / "own", [tmp_path / "own/file"])
    assert carried.here() == tmp_path / "own"
    (tmp_path / "own/file").write_bytes(b"another")
    assert (carried.here() / "file").read_bytes() == b"content" and carried.here() == carried.here() != tmp_path / "own"


OWN = """
import numpy as np
from near_the_policy import GAIN
class Own:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.full((len(observation), 1), GAIN, np.float32), None
"""


def test_a_comparison_is_the_same_on_ray(tmp_path: Path):
    """With a policy and a user's own controller, whose files the workers do not have when they run."""
    (tmp_path / "own").mkdir()
    (tmp_path / "own/near_the_policy.py").write_text("GAIN = 0.1\n")
    (tmp_path / "own/own.py").write_text(OWN)
    (policy,) = learned_methods(shipped_policies()[:1])
    methods = [policy, added_method(f"{tmp_path}/own/own.py:Own")]
    split = development_set().splits["randomized"]
    parts = [Part(method, split, 4) for method in methods]
    here = run_parts(parts, tmp_path / "here", 1)
    gone = tmp_path / "own"
    carried = parts[1].method.belongings()
    gone.rename(tmp_path / "gone")
    moved = parts[1].method.at(carried)
    assert not moved.sources[0].startswith(str(gone)) and moved.sources[0].endswith("own.py:Own")
    (tmp_path / "gone").rename(gone)
    there = run_parts(parts, tmp_path / "there", None, engine=RAY)
    for one, other in zip(here, there, strict=True):
        assert isinstance(one, dict) and isinstance(other, dict)
        assert all(np.array_equal(one[name], other[name]) for name in one)
    assert len(list((tmp_path / "there/parts").iterdir())) == 2, "kept by this process"


@pytest.mark.slow
def test_the_command_runs_on_a_cluster_that_is_there(tmp_path: Path):
    """Whose workers know the command's folder, where a file has the name of a package."""
    address = ray.get_runtime_context().gcs_address
    words = (
        "--methods",
        "paper",
        "rigid",
        "--splits",
        "nominal",
        "--episodes",
        "4",
        "--engine",
        "ray",
        "--address",
        address,
    )
    command = [sys.executable, str(ROOT / "eval/compare.py"), *words, "--out", "out"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert len(list((tmp_path / "out/parts").iterdir())) == 2


# Trainings

FEW = (
    "--total-steps",
    256,
    "--validation-every",
    128,
    "--arms",
    8,
    "--rollout-steps",
    16,
    "--batch-size",
    64,
    "--validation-arms",
    4,
)


def train(monkeypatch: pytest.MonkeyPatch, make_learner: Any, *options: object) -> None:
    monkeypatch.setattr(sys, "argv", ["train/ppo.py", *map(str, [*options, *FEW])])
    main(PpoConfig, make_learner, None)


def die_once(config: Any) -> Any:
    """Make a learner whose process is killed after the checkpoint at 128 steps, unless it goes on from one."""
    learner = ALGORITHMS["ppo"].make_learner(config)
    whole = learner.learn

    def learn(monitor: Any) -> None:
        channel = monitor.channel

        def report(news: News) -> None:
            channel.report(news)
            if news.steps == 128 and news.cost is not None:
                os.kill(os.getpid(), signal.SIGKILL)

        if not monitor.folder.checkpoint.exists():
            monitor.channel = replace(channel, report=report)
        whole(monitor)

    learner.learn = learn
    return learner


@pytest.mark.slow
def test_a_training_whose_worker_is_killed_goes_on_and_is_the_local_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    storage, options = tmp_path / "store", ("--engine", "ray", "--storage", tmp_path / "store")
    train(monkeypatch, die_once, "--out", tmp_path / "far", "--seeds", 2, *options)
    train(monkeypatch, ALGORITHMS["ppo"].make_learner, "--out", tmp_path / "here", "--seed", 1)
    assert weights(tmp_path / "far/seed1/last") == weights(tmp_path / "here/last")
    assert weights(tmp_path / "far/seed1/best") == weights(tmp_path / "here/best")
    assert {path.name for path in storage.iterdir()} == {"seed0.zip", "seed1.zip"}
    config = read_spec(tmp_path / "far/seed1/last")[0].provenance["config"]
    assert config["out"] == str(tmp_path / "far/seed1") and config["engine"] == "local"
    capsys.readouterr()
    with pytest.raises(SystemExit, match="2"):
        train(monkeypatch, die_once, "--out", tmp_path / "other", "--seeds", 2, *options)
    assert "store already holds seed0: continue it with --resume" in capsys.readouterr().err
    train(monkeypatch, die_once, "--out", tmp_path / "other", "--seeds", 2, *options, "--resume")
    assert weights(tmp_path / "other/seed1/last") == weights(tmp_path / "here/last"), "from another machine"


def test_a_folder_that_workers_do_not_see_needs_a_storage(tmp_path: Path):
    options = WithStorage(engine="ray")
    with Workplace(options, tmp_path / "out") as workplace:
        task = workplace.task("a", tmp_path / "out", where_it_works, Path("checkpoint"))
        assert outcomes({"a": task})["a"] == str(tmp_path / "out")
    assert list((tmp_path / "out").iterdir()) == []
    message = f"{socket.gethostname()} does not see {tmp_path / 'out'}: give --storage"
    assert message in outcomes({"a": task})["a"].message, "without the file that proves it"


def where_it_works(folder: Path, _: Channel) -> str:
    return str(folder)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"address": "auto"}, "--address auto is of a cluster: add --engine ray"),
        ({"storage": "s3://bucket"}, "--storage s3://bucket is for --engine ray"),
        ({"jobs": 0}, "--jobs must lie within 1 and 256, got 0"),
    ],
)
def test_options_that_do_not_fit_are_refused(options: dict[str, Any], message: str):
    with pytest.raises(ValueError, match=message):
        WithStorage(**options).check_engine()


@pytest.mark.slow
def test_a_search_for_hyper_parameters_runs_on_ray(tmp_path: Path):
    few: dict[str, Any] = {"trials": 2, "jobs": 2, "samples": 7680, "arms": 4, "validation_arms": 2}
    study = tune(TuningConfig("ppo", out=tmp_path, engine="ray", **few))
    assert len(counted(study)) >= 2 and study.best_value > 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ppo.db"], "trials work elsewhere"
