"""Tasks, comparisons and trainings on Ray are those on this machine, also where a machine is lost."""

import os
import signal
import socket
import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from side_by_side import InWorkers, Place, square
from trainings import weights

from agents.learners.ppo import PpoConfig
from agents.policy.bundle import read_spec
from agents.runs.command_line import main
from agents.runs.training import News
from baselines.engines import cluster
from baselines.engines.parallel import SideBySide
from eval.comparison.cache import Part, run_parts
from eval.comparison.methods import added_method, learned_methods, shipped_policies
from eval.comparison.sets import development_set

pytest.importorskip("ray", reason="Ray is not installed: pip install 'beltarm-env[ray]'")
ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module", autouse=True)
def settings() -> Iterator[None]:
    """Let Ray's processes find the tests' own tasks, and as much time as any other on a machine that is busy."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("PYTHONPATH", f"{ROOT}:{ROOT / 'tests' / 'helpers'}")
        patched.setenv("RAY_worker_niceness", "0")
        patched.setenv("RAY_AUTH_MODE", "disabled")
        yield


@pytest.fixture(scope="module")
def address(settings: None) -> Iterator[str]:
    """A cluster of a head, which runs no tasks, and two machines of two cores each."""
    from ray.cluster_utils import Cluster

    machines = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    for _ in range(2):
        machines.add_node(num_cpus=2)
    yield str(machines.address)
    machines.shutdown()


class TestOnACluster(InWorkers):
    @pytest.fixture
    def place(self, address: str) -> Place:
        return Place(engine="ray", address=address, jobs=2)

    def test_workers_that_cannot_take_tasks_are_refused(self, place: Place, monkeypatch: pytest.MonkeyPatch):
        with pytest.raises(ValueError, match="--threads 3"):
            place.outcomes({"a": partial(square, 2)}, threads=3)
        monkeypatch.setattr(cluster, "code_and_packages", lambda: "another commit")
        with pytest.raises(ValueError, match=f"{socket.gethostname()} has other code"):
            place.outcomes({"a": partial(square, 2)})


OWN = """
import numpy as np
from near_the_policy import GAIN
class Own:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.full((len(observation), 1), GAIN, np.float32), None
"""


def test_a_comparison_is_the_same_on_ray_on_one_machine(tmp_path: Path):
    (tmp_path / "own").mkdir()
    (tmp_path / "own/near_the_policy.py").write_text("GAIN = 0.1\n")
    (tmp_path / "own/own.py").write_text(OWN)
    (policy,) = learned_methods(shipped_policies()[:1])
    methods = [policy, added_method(f"{tmp_path}/own/own.py:Own")]
    split = development_set().splits["randomized"]
    parts = [Part(method, split, 4) for method in methods]
    here = run_parts(parts, tmp_path / "here", SideBySide(jobs=1))
    there = run_parts(parts, tmp_path / "there", SideBySide(engine="ray"))
    for one, other in zip(here, there, strict=True):
        assert isinstance(one, dict) and isinstance(other, dict)
        assert all(np.array_equal(one[name], other[name]) for name in one)
    assert len(list((tmp_path / "there/parts").iterdir())) == 2, "kept by this process"
    carried = methods[1].belongings()
    (tmp_path / "own").rename(tmp_path / "gone")
    (moved,) = methods[1].at(carried).sources
    assert not moved.startswith(str(tmp_path / "own")) and moved.endswith("own.py:Own"), "where its files are not"


FEW = "--total-steps 256 --validation-every 128 --arms 8 --rollout-steps 16 --batch-size 64 --validation-arms 4".split()


def train(monkeypatch: pytest.MonkeyPatch, config: type[PpoConfig], *options: object) -> None:
    monkeypatch.setattr(sys, "argv", ["train/ppo.py", *map(str, ["--base", "paper", *options, *FEW])])
    main(config, None)


class LosesAMachine(PpoConfig):
    """Its learner kills its machine, as Ray has it, after the checkpoint of seed 1 at 128 steps; not twice."""

    def make_learner(self) -> Any:
        learner: Any = super().make_learner()
        whole = learner.learn

        def learn(monitor: Any) -> None:
            channel = monitor.channel

            def report(news: News) -> None:
                channel.report(news)
                if news.steps == 128 and news.cost is not None:
                    os.kill(os.getppid(), signal.SIGKILL)
                    os.kill(os.getpid(), signal.SIGKILL)

            if self.seed == 1 and not monitor.folder.checkpoint.exists():
                monitor.channel = replace(channel, report=report)
            whole(monitor)

        learner.learn = learn
        return learner


def test_a_training_whose_machine_is_lost_goes_on_and_is_the_local_one(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    """This takes a machine from the cluster, and so is the last test that has it."""
    storage, options = tmp_path / "store", ("--engine", "ray", "--address", address, "--storage", tmp_path / "store")
    train(monkeypatch, LosesAMachine, "--out", tmp_path / "far", "--seeds", 2, *options)
    train(monkeypatch, PpoConfig, "--out", tmp_path / "here", "--seeds", 2)
    for policy in ("seed0/last", "seed0/best", "seed1/last", "seed1/best"):
        assert weights(tmp_path / "far" / policy) == weights(tmp_path / "here" / policy)
    assert {path.name for path in storage.iterdir()} == {"seed0.zip", "seed1.zip"}
    config = read_spec(tmp_path / "far/seed1/last")[0].provenance["config"]
    assert config["out"] == str(tmp_path / "far/seed1") and config["engine"] == "local"
    capsys.readouterr()
    with pytest.raises(SystemExit, match="2"):
        train(monkeypatch, LosesAMachine, "--out", tmp_path / "other", "--seeds", 2, *options)
    assert "store already holds seed0: continue it with --resume" in capsys.readouterr().err
    train(monkeypatch, LosesAMachine, "--out", tmp_path / "other", "--seeds", 2, *options, "--resume")
    assert weights(tmp_path / "other/seed1/last") == weights(tmp_path / "here/seed1/last"), "from another machine"
