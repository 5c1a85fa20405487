"""Comparisons and trainings on Ray are those on this machine, also where a worker is killed."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from clusters import local_cluster
from trainings import weights

from agents.learners.ppo import PpoConfig
from agents.learners.registry import ALGORITHMS
from agents.policy.bundle import read_spec
from agents.runs.command_line import main
from agents.runs.monitor import News
from baselines.engines.parallel import Engine
from eval.comparison.cache import Part, run_parts
from eval.comparison.methods import added_method, learned_methods, shipped_policies
from eval.comparison.sets import development_set

RAY = Engine("ray")


@pytest.fixture(scope="module", autouse=True)
def cluster() -> Iterator[None]:
    with local_cluster():
        yield


OWN = """
import numpy as np
from near_the_policy import GAIN
class Own:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.full((len(observation), 1), GAIN, np.float32), None
"""


def test_a_comparison_is_the_same_on_ray(tmp_path: Path):
    """With a policy and a user's own controller."""
    (tmp_path / "own").mkdir()
    (tmp_path / "own/near_the_policy.py").write_text("GAIN = 0.1\n")
    (tmp_path / "own/own.py").write_text(OWN)
    (policy,) = learned_methods(shipped_policies()[:1])
    methods = [policy, added_method(f"{tmp_path}/own/own.py:Own")]
    split = development_set().splits["randomized"]
    parts = [Part(method, split, 4) for method in methods]
    here = run_parts(parts, tmp_path / "here", 1)
    there = run_parts(parts, tmp_path / "there", None, engine=RAY)
    for one, other in zip(here, there, strict=True):
        assert isinstance(one, dict) and isinstance(other, dict)
        assert all(np.array_equal(one[name], other[name]) for name in one)
    assert len(list((tmp_path / "there/parts").iterdir())) == 2, "kept by this process"
    carried = methods[1].belongings()
    (tmp_path / "own").rename(tmp_path / "gone")
    (moved,) = methods[1].at(carried).sources
    assert not moved.startswith(str(tmp_path / "own")) and moved.endswith("own.py:Own"), "where its files are not"


FEW = "--total-steps 256 --validation-every 128 --arms 8 --rollout-steps 16 --batch-size 64 --validation-arms 4".split()


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
