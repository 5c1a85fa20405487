"""The learned observer: what it estimates, that it knows how far it is off, and its files."""

import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import torch
from refusals import refused

from agents.observer import network
from agents.observer import run as running
from agents.observer.network import MAX_WIDTH, Observer, load_observer, save_observer
from agents.observer.quantities import BELIEVED, NAMES, SCALES, truth
from agents.observer.run import Episodes, ObserverConfig, fit
from agents.residual.knowledge import InformedBase, offered
from baselines import CONTROLLERS
from baselines.optimal.adaptive import AdaptiveController
from beltarm_env import BeltArmVectorEnv, design_model
from beltarm_env.arm import params_columns, params_table
from beltarm_env.observation import decode
from beltarm_env.rollout import rollout
from beltarm_env.task.seeds import VALIDATION


class TestTruth:
    def test_is_what_is_true_at_the_sample_that_is_seen(self):
        class Noted(AdaptiveController):
            def predict(self, observation: Any, *rest: Any, **named: Any) -> Any:
                seen.append(decode(observation, "full"))
                return super().predict(observation, *rest, **named)

        seen: list[dict[str, Any]] = []
        run = rollout(Noted(), 2, seed=VALIDATION.first, randomization="train", sensors="full")
        true = truth(run, 1)
        for name in ("torsion", "torsion_speed"):
            measured = np.stack([now[name] for now in seen])
            assert np.allclose(true[1:, :, NAMES.index(name)], measured[1:], rtol=1e-5, atol=1e-6)
        assert truth(run, 4).shape == (300, 2, len(NAMES)) and np.array_equal(truth(run, 4)[1:], true[4::4])
        assert np.array_equal(true[1:, :, 2:4], run.tip_error[:-1])
        assert np.array_equal(true[1:, :, 4:6], run.tip_velocity_error[:-1])

    def test_constants_are_relative_to_the_model_of_controllers(self):
        """As they are to a filter, which sees no torque but the commanded one."""
        arms = [replace(design_model(), torque_constant_error=0.1), replace(design_model(), belt_stiffness=40.0)]
        run = rollout(CONTROLLERS["paper"](), 2, seed=0, options={"params": params_columns(params_table(arms))})
        weaker, stiffer = (dict(zip(NAMES, row, strict=True)) for row in truth(run, 4)[0])
        assert [weaker[name] for name in NAMES[6:]] == pytest.approx([-math.log(1.1)] * len(NAMES[6:]), abs=1e-12)
        assert stiffer["belt_stiffness"] == pytest.approx(math.log(40.0 / design_model().belt_stiffness), abs=1e-12)


class TestEstimates:
    def test_an_untrained_observer_is_the_filter(self):
        informed, observer = InformedBase(AdaptiveController()), Observer()
        for parameter in observer.heads.parameters():
            parameter.data.zero_()
        observation, _ = BeltArmVectorEnv(2, randomization="train").reset(seed=VALIDATION.first)
        memory = informed.advance(observation, None, None)
        estimate, _ = observer.observe(informed.seen(observation, memory))
        belief = AdaptiveController().belief(memory.base)
        assert np.allclose(estimate.mean[:, :2], belief.state[:, 2:], rtol=1e-4, atol=1e-6)
        assert np.allclose(estimate.mean[:, 6:], belief.tracks.mean[:, 4:10], rtol=1e-4, atol=1e-6)
        assert np.array_equal(estimate.deviation, np.ones((2, len(NAMES))))

    def test_sample_by_sample_is_what_was_fitted(self):
        observer = Observer(width=8)
        seen = np.random.default_rng(0).standard_normal((6, 3, len(offered("belief")))).astype(np.float32)
        inputs = torch.from_numpy(seen[:, :, observer.columns])
        with torch.no_grad():
            mean, deviation = observer.estimated(inputs, *observer(inputs)[:2])
        memory = None
        for k in range(6):
            estimate, memory = observer.observe(seen[k], memory)
            assert np.allclose(estimate.mean, mean[k], rtol=1e-5, atol=1e-6)
            assert np.allclose(estimate.deviation, deviation[k], rtol=1e-5, atol=1e-6)

    @pytest.mark.parametrize("knowledge", ["belief", "none"])
    def test_an_arm_that_begins_anew_is_forgotten_and_others_are_not(self, knowledge: Any):
        observer = Observer(knowledge)
        seen = np.random.default_rng(0).standard_normal((2, 2, len(offered(knowledge)))).astype(np.float32)
        _, memory = observer.observe(seen[0])
        on, fresh = observer.observe(seen[1], memory), observer.observe(seen[1])
        through = observer.observe(seen[1], memory, np.array([False, True]))
        for ours, theirs, other in zip(*((e.mean, e.deviation, m) for e, m in (through, fresh, on)), strict=True):
            assert np.allclose(ours[0], other[0], rtol=1e-5, atol=1e-7)
            assert np.allclose(ours[1], theirs[1], rtol=1e-5, atol=1e-7)
            assert not np.allclose(other[1], theirs[1], rtol=1e-3)


def made_up(count: int, seed: int = 0) -> Episodes:
    """Episodes in which the truth is the belief, half an input, and noise that another input tells the size of."""
    random = np.random.default_rng(seed)
    inputs = random.standard_normal((20, count, len(Observer().columns))).astype(np.float16)
    names = [entry.name for entry in offered("belief") if entry.name != "base_torque"]
    belief = inputs[:, :, [names.index(name) for name in BELIEVED]] * SCALES
    size = 0.3 * np.exp(inputs[:, :, [0]].clip(-1.5, 1.5))
    off = 0.5 * inputs[:, :, [1]] + size * random.standard_normal((20, count, len(NAMES)))
    return Episodes(torch.from_numpy(inputs), torch.from_numpy((belief + off * SCALES).astype(np.float32)))


def test_a_fit_finds_what_can_be_known_and_says_how_well():
    torch.manual_seed(0)
    observer, episodes = Observer(width=8), made_up(256)
    losses = [loss for _, loss in fit(observer, episodes, ObserverConfig(epochs=20, learning_rate=1e-2))]
    assert losses[-1] < losses[0] - 0.5
    fresh = made_up(64, seed=1)
    inputs = fresh.inputs.float()
    with torch.no_grad():
        mean, deviation = observer.estimated(inputs, *observer(inputs)[:2])
    z = ((fresh.truth - mean) / deviation).numpy()
    assert 0.64 < (np.abs(z) <= 1).mean() < 0.72
    certain = (inputs[:, :, 0] < -1).numpy()
    stated = (deviation / torch.from_numpy(SCALES)).numpy()
    assert np.median(stated[certain]) < 0.15 < 0.25 < np.median(stated[~certain]) < 0.4


class TestFiles:
    def test_what_is_read_is_what_was_written(self, tmp_path: Path):
        path = tmp_path / "a.safetensors"
        for observer in (Observer("none", 8, 1), Observer("none", width=MAX_WIDTH)):
            save_observer(path, observer, {"command": "mine"})
            read, content = load_observer(path)
            assert (read.knowledge, read.width, read.hold) == (observer.knowledge, observer.width, observer.hold)
            assert content["provenance"] == {"command": "mine"}
            seen = np.random.default_rng(0).standard_normal((3, len(offered("none")))).astype(np.float32)
            assert np.array_equal(read.observe(seen)[0].mean, observer.observe(seen)[0].mean)

    def test_missing_foreign_and_damaged_files_are_refused(self, tmp_path: Path):
        path = tmp_path / "a.safetensors"
        refused(ValueError, (path.name, "train/observer.py"), lambda: load_observer(path))
        save_observer(path, Observer(width=4), {})
        path.write_bytes(path.read_bytes()[:-1] + b"\xff")
        refused(ValueError, (path.name, "damaged"), lambda: load_observer(path))
        path.write_bytes(b"something else")
        refused(ValueError, (path.name, "no observer of this release"), lambda: load_observer(path))

    def test_unsound_weights_and_those_for_another_arm_observation_or_filter_are_refused(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ):
        path, observer, now = tmp_path / "a.safetensors", Observer(width=4), network._belongs_to
        for name in ("edition", "entries", "filter"):
            with monkeypatch.context() as patch:
                patch.setattr(network, "_belongs_to", lambda observer, name=name: {**now(observer), name: 0})
                save_observer(path, observer, {})
            refused(ValueError, (name, "fit it again"), lambda: load_observer(path))
        observer.deviation[0] = 0
        save_observer(path, observer, {})
        refused(ValueError, ("without a scale",), lambda: load_observer(path))


class TestRun:
    def config(self, tmp_path: Path, **options: Any) -> ObserverConfig:
        return ObserverConfig(tmp_path / "o", **{"episodes": 6, "epochs": 1, "width": 4, "jobs": 1, **options})

    def test_goes_on_with_the_episodes_that_it_has(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        config = self.config(tmp_path)
        with monkeypatch.context() as patch:
            patch.setattr(running, "fit", Mock(side_effect=KeyboardInterrupt))
            refused(KeyboardInterrupt, ("the same command continues",), lambda: running.run(config))
        assert len(list(tmp_path.glob(".o-episodes/*.safetensors"))) == 1 and not config.file.exists()
        monkeypatch.setattr(running, "simulate", None)
        running.run(config)
        assert [path.name for path in tmp_path.iterdir()] == ["o"]
        assert load_observer(config.file)[1]["provenance"]["run"]["episodes"] == 6

    def test_what_is_out_of_range_is_refused(self, tmp_path: Path):
        for name, value in (("width", 0), ("width", 129), ("hold", 0), ("hold", 1.5), ("width", True)):
            refused((ValueError, TypeError), (name, str(value)), partial(Observer, **{name: value}))
        refused(ValueError, ("(2, 5)",), lambda: Observer().observe(np.zeros((2, 5), np.float32)))
        for name, value in (("learning_rate", 0.0), ("epochs", 0), ("batch_size", 0), ("seed", -1)):
            config = self.config(tmp_path, **{name: value})
            refused(ValueError, ("--" + name.replace("_", "-"),), partial(running.run, config))

    @pytest.mark.slow
    def test_processes_and_blocks_change_nothing(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setattr(running, "_BLOCK", 6)
        for jobs in (1, 2):
            running.run(self.config(tmp_path / str(jobs), episodes=9, jobs=jobs))
        (ours, content), (theirs, _) = (load_observer(tmp_path / str(jobs) / "o") for jobs in (1, 2))
        assert content["provenance"]["run"]["episodes"] == 9
        assert all(torch.equal(value, theirs.state_dict()[name]) for name, value in ours.state_dict().items())
