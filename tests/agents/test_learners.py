"""Learners: actors of their policies, bundles, rewards, seeds, rates, and options that are refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from trainings import MODULES, NAMES, run, tiny

import agents.runs.monitor
from agents.learners.reinforcement import ModelLearner, make_env
from agents.policy.actor import actor_of
from agents.policy.bundle import MAX_BYTES, load_controller, read_spec
from agents.policy.network import NetworkPolicy
from beltarm_env.task.cost import MAX_COST
from beltarm_env.task.seeds import MAX_TRAINING_SEED, training_arms
from beltarm_env.task.streams import seeded


@pytest.mark.parametrize("name", NAMES)
def test_an_actor_acts_as_the_policy_that_it_is_of(name: str, tmp_path: Path):
    config = tiny(name, tmp_path)
    env = make_env(config)
    env.seed(0)
    model = MODULES[name].make_model(config, env)
    seen, residuals = env.reset(), []
    assert np.abs(model.predict(seen, deterministic=True)[0]).max() < 0.1, "untrained, it is nearly its base"
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter.add_(0.1 * torch.randn(parameter.shape))
    policy = NetworkPolicy(actor_of(model.policy, config.spec().shape()).weights())
    ours, theirs = None, None
    begins = np.ones(config.arms, np.bool_)
    with pytest.raises(ValueError, match=f"{seen.shape[1]} entries.*--sensors"):
        policy.predict(seen[:, 1:])
    for step in range(20):
        residual, ours = policy.predict(seen, ours, begins)
        expected, theirs = model.predict(seen, theirs, begins, deterministic=True)
        np.testing.assert_allclose(residual, expected, atol=1e-6)
        residuals.append(residual)
        seen, _, begins, _ = env.step(residual)
        assert isinstance(seen, np.ndarray)
        begins[0] |= step == 10
    assert np.std(residuals) > 1e-3


@pytest.mark.parametrize("name", NAMES)
def test_bundles_of_all_algorithms(name: str, tmp_path: Path):
    monitor = run(tiny(name, tmp_path, total_steps=128))
    controller = load_controller(tmp_path / "last")
    spec, _ = read_spec(tmp_path / "last")
    assert spec.algorithm == name and all(path.stat().st_size < MAX_BYTES for path in (tmp_path / "last").iterdir())
    assert spec.provenance["curve"] == [list(point) for point in monitor.curve]
    validated = agents.runs.monitor.validate(controller, 4)
    assert validated == spec.provenance["reached"]["validation"]
    card = (tmp_path / "last" / "README.md").read_text()
    for word in (name, "`paper`", "layout", "stable-baselines3", "seed | 0", f"{validated['cost']:.4g}"):
        assert word in card
    best, _ = read_spec(tmp_path / "best")
    assert best.provenance["run"]["steps"] == 128


def test_what_leaving_costs(tmp_path: Path):
    """Cut: for PPO to the highest cost of three holds, off-policy to the highest cost for ever."""
    for name, holds in (("ppo", 3), ("sac", 1 / (1 - 0.9))):
        env = make_env(tiny(name, tmp_path, reward_scale=0.1, gamma=0.9, residual_limit=2.0, base="none"))
        env.seed(0)
        env.reset()
        worst = -min(env.step(np.ones((8, 1), np.float32))[1].min() for _ in range(20))
        assert worst == pytest.approx(holds * MAX_COST * 0.1)


def test_arms_are_seeded_as_documented(tmp_path: Path):
    config = tiny("ppo", tmp_path, seed=2, total_steps=64)
    monitor = run(config)
    env = make_env(config)
    env.seed(training_arms(2).first)
    env.reset()
    assert isinstance(monitor.learner, ModelLearner)
    expected = seeded([training_arms(2).first + 3])[0]
    for arms in (env.env, monitor.learner.env.env):
        assert arms._streams is not None
        assert np.array_equal(arms._streams[3, 2:], expected[2:])  # what does not change as numbers are drawn


@pytest.mark.parametrize("algorithm", ["ppo", "recurrent_ppo"])
def test_learning_rate_falls_to_zero_and_no_further(algorithm: str, tmp_path: Path):
    """A run ends with a whole rollout, beyond its steps: a negative rate there would climb the loss."""
    config = tiny(algorithm, tmp_path)
    schedule = MODULES[algorithm].make_learner(config).model.lr_schedule
    assert [schedule(left) for left in (1.0, 0.5, 0.0, -0.02)] == [config.learning_rate, config.learning_rate / 2, 0, 0]


BAD: list[tuple[str, dict[str, Any], str]] = [
    ("ppo", {"base": "papre"}, "'papre'.*'paper'"),
    ("ppo", {"base": "xyzzyx"}, "'xyzzyx'"),
    ("ppo", {"device": "cuda"}, "--device cuda.*--device cpu"),
    ("ppo", {"device": "gpu"}, "--device .* 'gpu'"),
    ("ppo", {"arms": 50_000}, "--arms .* 50000"),
    ("ppo", {"seed": MAX_TRAINING_SEED + 1}, "--seed"),
    ("ppo", {"seed": MAX_TRAINING_SEED, "seeds": 2}, "--seed"),
    ("ppo", {"learning_rate": float("nan")}, "--learning-rate .* nan"),
    ("ppo", {"gamma": 1.5}, "--gamma .* 1.5"),
    ("ppo", {"hidden": (0,)}, "hidden"),
    ("ppo", {"resume": True, "overwrite": True}, "--resume.*--overwrite"),
    ("ppo", {"jobs": 0}, "--jobs .* 0"),
    ("ppo", {"resume": True}, "nothing to resume"),
    ("ppo", {"learning_rate": 1e30}, r"diverged at .* steps.*--learning-rate"),
    ("ppo", {"epochs": 0}, "--epochs"),
    ("sac", {"buffer_size": 10}, "--buffer-size"),
    ("sac", {"exploration": 0.0}, "--exploration"),
    ("sac", {"tau": 2.0}, "--tau"),
    ("recurrent_ppo", {"lstm_width": 0}, "--lstm-width"),
    ("student", {"rounds": 0}, "--rounds"),
    ("student", {"remembered": 0}, "--remembered"),
    ("student", {"gru_width": -1}, "--gru-width"),
    ("student", {"epochs": 0}, "--epochs"),
    ("student", {"huber": 0.0}, "--huber"),
    ("student", {"learning_rate": 1e30, "rounds": 1}, "diverged at 0 steps.*--learning-rate"),
    ("rma", {"told": 0.0}, "--told .* 0.0"),
    ("rma", {"told": 1.0}, "--told .* 1.0"),
    ("rma", {"told": 0.9}, "--rounds .*--told 0.9"),
    ("rma", {"latent": 0}, "--latent"),
    ("rma", {"gru_width": 0}, "--gru-width"),
    ("rma", {"learning_rate": 1e30}, "diverged at 0 steps.*--learning-rate"),
]


@pytest.mark.parametrize(("name", "options", "words"), BAD, ids=str)
def test_bad_options(name: str, options: dict[str, Any], words: str, tmp_path: Path):
    if options.get("device") == "cuda" and torch.cuda.is_available():
        pytest.skip("there is a GPU")
    error = FileNotFoundError if words == "nothing to resume" else ValueError
    with pytest.raises(error, match=words):
        run(tiny(name, tmp_path / "run", **options))
    assert "diverged" in words or not (tmp_path / "run").exists()
