"""Learners: actors of their policies, bundles, seeds, rates, options that are refused, and the search for options."""

from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import torch
from commands import stopped
from optuna.trial import TrialState, create_trial
from refusals import refused
from trainings import NAMES, StopAfter, run, tiny

from agents.learners import tuning
from agents.learners.registry import ALGORITHMS, SPACES
from agents.learners.reinforcement import ModelLearner, ReinforcementConfig
from agents.learners.tuning import TuningConfig, begin, counted, open_study, run_trials, training_command, tune
from agents.policy.actor import actor_of
from agents.policy.network import NetworkPolicy
from agents.runs.training import News
from baselines.engines.parallel import Channel, Interrupted, StopRequest
from baselines.tuning.study import ask, own
from beltarm_env.task.cost import MAX_COST
from beltarm_env.task.seeds import MAX_TRAINING_SEED, training_arms
from beltarm_env.task.streams import seeded
from train.tune import main


@pytest.mark.parametrize("name", NAMES)
def test_an_actor_acts_as_the_policy_that_it_is_of(name: str, tmp_path: Path):
    config = tiny(name, tmp_path)
    env = config.make_env()
    env.seed(0)
    model, seen, residuals = config.make_model(env), env.reset(), []
    assert np.abs(model.predict(seen, deterministic=True)[0]).max() < 0.1, "untrained, it is nearly its base"
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter.add_(0.1 * torch.randn(parameter.shape))
    policy = NetworkPolicy(actor_of(model.policy, config.spec().shape()).weights())
    ours, theirs, begins = None, None, np.ones(config.arms, np.bool_)
    for step in range(20):
        residual, ours = policy.predict(seen, ours, begins)
        expected, theirs = model.predict(seen, theirs, begins, deterministic=True)
        np.testing.assert_allclose(residual, expected, atol=1e-6)
        residuals.append(residual)
        seen, _, begins, _ = env.step(residual)
        assert isinstance(seen, np.ndarray)
        begins[0] |= step == 10
    assert np.std(residuals) > 1e-3


def test_what_leaving_costs(tmp_path: Path):
    """Cut: for PPO to the highest cost of three holds, off-policy to the highest cost for ever."""
    for name, holds in (("ppo", 3), ("recurrent_ppo", 3), ("sac", 1 / (1 - 0.9))):
        env = tiny(name, tmp_path, reward_scale=0.1, gamma=0.9, residual_limit=2.0, base="none").make_env()
        env.seed(0)
        env.reset()
        worst = -min(env.step(np.ones((8, 1), np.float32))[1].min() for _ in range(20))
        assert worst == pytest.approx(holds * MAX_COST * 0.1)


def test_arms_are_seeded_as_documented(tmp_path: Path):
    learner = run(tiny("ppo", tmp_path, seed=2, total_steps=64)).learner
    assert isinstance(learner, ModelLearner) and learner.env.env._streams is not None
    expected = seeded([training_arms(2).first + 3])[0]
    assert np.array_equal(learner.env.env._streams[3, 2:], expected[2:])  # what does not change as numbers are drawn


@pytest.mark.parametrize("algorithm", ["ppo", "recurrent_ppo"])
def test_learning_rate_falls_to_zero_and_no_further(algorithm: str, tmp_path: Path):
    """A run ends with a whole rollout, beyond its steps: a negative rate there would climb the loss."""
    config = tiny(algorithm, tmp_path)
    schedule = config.make_learner().model.lr_schedule
    assert [schedule(left) for left in (1.0, 0.5, 0.0, -0.02)] == [config.learning_rate, config.learning_rate / 2, 0, 0]


OUT_OF_RANGE = [
    *(("ppo", "epochs", 0), ("ppo", "teacher_rounds", -1)),
    *(("sac", "buffer_size", 10), ("sac", "exploration", 0.0), ("sac", "tau", 2.0), ("recurrent_ppo", "lstm_width", 0)),
    *(("student", "rounds", 0), ("student", "remembered", 0), ("student", "gru_width", -1)),
]
BAD: list[tuple[str, dict[str, Any], str]] = [
    ("ppo", {"base": "papre"}, "'papre'.*'paper'"),
    ("ppo", {"device": "cuda:99"}, "--device cuda:99.*--device cpu"),
    ("ppo", {"arms": 50_000}, "--arms .* 50000"),
    ("ppo", {"seed": MAX_TRAINING_SEED, "seeds": 2}, "--seed"),
    ("ppo", {"learning_rate": float("nan")}, "--learning-rate .* nan"),
    ("ppo", {"gamma": 1.5}, "--gamma .* 1.5"),
    *(("ppo", {"hidden": (width,)}, f"hidden.*{width}") for width in (0, 1025, True)),
    ("ppo", {"resume": True, "overwrite": True}, "--resume.*--overwrite"),
    ("ppo", {"resume": True}, "nothing to resume"),
    ("ppo", {"learning_rate": 1e30}, r"diverged at .* steps.*--learning-rate"),
    *(("ppo", {"critic_steps": steps}, "--critic-steps must lie within 0 and 255") for steps in (256, -1)),
    ("sac", {"learning_starts": 256}, "--learning-starts must lie within 0 and 255"),
    *((name, {option: value}, f"--{option.replace('_', '-')}") for name, option, value in OUT_OF_RANGE),
    *((name, {"hold": 7, "moves": 2}, "hold must divide 1200.* 7: choose") for name in ALGORITHMS),
    ("student", {"nominal": ("payload",)}, "--nominal.*'payload'; did you mean 'payload_mass'"),
    ("student", {"nominal": ("presliding_deflection",)}, "--nominal"),  # of a single move it is anyway
    ("student", {"learning_rate": 1e30, "rounds": 1}, "diverged at 0 steps.*--learning-rate"),
]


@pytest.mark.parametrize(("name", "options", "words"), BAD, ids=str)
def test_bad_options(name: str, options: dict[str, Any], words: str, tmp_path: Path):
    error = FileNotFoundError if words == "nothing to resume" else ValueError
    with pytest.raises(error, match=words):
        run(tiny(name, tmp_path / "run", **options))
    assert "diverged" in words or not (tmp_path / "run").exists()


def few(out: Path, **options: Any) -> TuningConfig:
    out.mkdir(exist_ok=True)
    common = {"trials": 2, "jobs": 1, "samples": 2560, "arms": 4, "validation_arms": 2}
    return TuningConfig("sac", **{"out": out, **common, **options})


def test_what_is_varied_are_options_of_the_scripts(tmp_path: Path):
    assert set(SPACES) == set(ALGORITHMS) - {"student"}
    for (algorithm, space), base in product(SPACES.items(), ("paper", "adaptive")):
        config = TuningConfig(algorithm, out=tmp_path, base=base, moves=3)
        settings, own = config.defaults(), config.run({}, 3)
        create_trial(value=0.0, params=settings, distributions=space)  # raises where a setting is none of its space's
        assert config.run(settings, 3) == own and (own.moves, own.total_steps * own.hold) == (3, config.samples)


@pytest.mark.slow
def test_a_search_is_kept_and_goes_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    options = "--trials 2 --jobs 1 --samples 2560 --arms 4 --validation-arms 2 --out .".split()
    assert stopped(main, ("sac", *options), tmp_path) == (0, "")
    config = few(tmp_path)
    study = open_study(config)
    first = study.get_trials()[0]
    assert first.params == config.defaults(), "begins with the script's settings"
    assert len(counted(study)) == 2 and len(first.intermediate_values) > 5
    files = {path.name for path in tmp_path.iterdir()}
    assert files == {"sac.csv", "sac.journal", "sac.journal.owner", "sac.json"}, "runs of trials are not kept"
    assert min(pd.read_csv(config.file("csv"))["value"].tolist()) == pytest.approx(study.best_value)
    words = training_command(config, study).split()
    assert words[1] == "train/sac.py" == capsys.readouterr().out.split("\n  ")[1].split()[1]
    assert words[words.index("--gamma") + 1] == f"{study.best_params['gamma']:.6g}"
    refused(ValueError, ("already holds a study", "--resume"), lambda: tune(config))
    refused(ValueError, ("arms 4, not 8",), lambda: tune(few(tmp_path, resume=True, arms=8)))


def test_a_worker_that_begins_again_gives_up_the_trial_that_it_died_in(tmp_path: Path):
    config, stop = few(tmp_path), StopRequest()
    study = open_study(config)
    for worker in range(2):
        study.ask().set_user_attr("worker", worker)
    left = config.run({}, 0).out
    left.mkdir()
    stop.made = True
    run_trials(config, 0, Channel(stop=stop))
    states = [trial.state for trial in open_study(config).get_trials()]
    assert states == [TrialState.FAIL, TrialState.RUNNING, TrialState.WAITING]
    assert not left.exists()


def train_at_once(config: ReinforcementConfig, channel: Channel) -> None:
    """Stand for a training: its costs follow from settings and seed alone."""
    for steps in range(0, 5 * config.validation_every, config.validation_every):
        if channel.stop.made:
            raise Interrupted
        channel.report(News(steps, "", 1e3 * config.learning_rate + config.gamma + config.seed + 1 / (1 + steps)))


def test_a_search_interrupted_again_and_again_is_the_uninterrupted_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(tuning, "train", train_at_once)

    def begun_again(config: TuningConfig, looks: int) -> None:
        begin(config)
        run_trials(config, 0, Channel(stop=StopAfter(looks)))

    whole, parts = (few(tmp_path / name, trials=12) for name in ("whole", "parts"))
    begun_again(whole, 10_000)
    for looks in (15, 1, 8, 30, 2):
        begun_again(parts, looks)
        ask(begin(parts), SPACES["sac"], parts.seed)  # and never told
    tune(replace(parts, resume=True))
    studies = open_study(parts), open_study(whole)
    ours, theirs = ([(one.params, one.value, one.intermediate_values) for one in counted(each)] for each in studies)
    assert ours == theirs
    assert len({str(params) for params, *_ in ours}) == len(ours) == 12 < len(studies[0].get_trials())
    assert not studies[0].get_trials(states=(TrialState.RUNNING,))
    monkeypatch.setattr("baselines.tuning.study.sources_digest", lambda *_: "other code")
    refused(ValueError, ("code", "not other code"), lambda: tune(replace(parts, resume=True)))


def test_bad_options_and_a_damaged_study(tmp_path: Path):
    for name, value in {"trials": 0, "base": "papr", "resume": True}.items():
        with pytest.raises((ValueError, OSError), match=name if value in (0, True) else str(value)):
            tune(few(tmp_path, **{name: value}))
    (tmp_path / "sac.journal").write_text("notes of somebody\n" * 2)
    refused(ValueError, ("sac.journal", "damaged"), lambda: tune(few(tmp_path, resume=True)))
    with own(tmp_path / "sac.journal"):
        refused(ValueError, ("another process",), lambda: tune(few(tmp_path, resume=True)))
