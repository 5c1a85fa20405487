"""The search for hyper-parameters."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from optuna.trial import TrialState
from refusals import refused
from trainings import StopAfter

from agents.learners import tuning
from agents.learners.registry import ALGORITHMS
from agents.learners.reinforcement import ReinforcementConfig
from agents.learners.spaces import SPACES
from agents.learners.tuning import TuningConfig, _search, counted, open_study, training_command, tune
from agents.runs.monitor import News
from baselines.engines.parallel import Channel, Interrupted, StopRequest


def few(out: Path, **options: Any) -> TuningConfig:
    common = {"trials": 2, "jobs": 1, "samples": 2560, "arms": 4, "validation_arms": 2}
    return TuningConfig("sac", **{"out": out, **common, **options})


def test_what_is_varied_are_options_of_the_scripts(tmp_path: Path):
    assert set(SPACES) == set(ALGORITHMS) - {"rma", "student"}
    for algorithm, space in SPACES.items():
        config = TuningConfig(algorithm, out=tmp_path)
        settings, own = config.defaults(), config.run({}, 3)
        for name, distribution in space.items():
            assert distribution._contains(distribution.to_internal_repr(settings[name])), name
        assert config.run(settings, 3) == own and (own.seed, own.overwrite) == (53, True)
        assert config.run(settings, 64).seed == 64
        assert own.total_steps * own.hold == config.samples


@pytest.mark.slow
def test_a_search_is_kept_and_goes_on(tmp_path: Path):
    """With trainings as they are."""
    config = few(tmp_path)
    study = tune(config)
    first = study.get_trials()[0]
    assert first.params == config.defaults(), "begins with the script's settings"
    assert len(counted(study)) == 2 and len(first.intermediate_values) > 5
    files = {path.name for path in tmp_path.iterdir()}
    assert files == {"sac.csv", "sac.db", "sac.json"}, "runs of trials are not kept"
    assert min(pd.read_csv(config.table)["value"].tolist()) == pytest.approx(study.best_value)
    words = training_command(config, study).split()
    assert words[1] == "train/sac.py" and words[words.index("--gamma") + 1] == f"{study.best_params['gamma']:.6g}"
    refused(ValueError, ("already holds a study", "--resume"), lambda: tune(config))
    refused(ValueError, ("was started with", "'arms': 4"), lambda: tune(few(tmp_path, resume=True, arms=8)))
    study.ask()  # left running by an interruption
    again = tune(few(tmp_path, resume=True, trials=3))
    assert len(counted(again)) == 3 and not again.get_trials(states=(TrialState.RUNNING,))


def test_a_worker_that_begins_again_gives_up_the_trial_that_it_died_in(tmp_path: Path):
    """And has it repeated."""
    config, stop = few(tmp_path), StopRequest()
    study = open_study(config)
    for worker in range(2):
        study.ask().set_user_attr("worker", worker)
    left = config.run({}, 0).out
    left.mkdir()
    stop.made = True
    _search(config, 0, Channel(stop=stop))
    states = [trial.state for trial in open_study(config).get_trials()]
    assert states == [TrialState.FAIL, TrialState.RUNNING, TrialState.WAITING]
    assert not left.exists()


def train_at_once(config: ReinforcementConfig, _: object, channel: Channel) -> None:
    """Stand for a training: its costs follow from settings and seed alone."""
    for steps in range(10):
        if channel.stop.made:
            raise Interrupted
        channel.report(News(steps, "", 1e3 * config.learning_rate + config.gamma + config.seed + 1 / (1 + steps)))


def test_a_search_that_is_interrupted_again_and_again_is_the_uninterrupted_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """By a signal, and by the death of its worker; beyond the ten trials that are drawn without a model, too."""
    monkeypatch.setattr(tuning, "train", train_at_once)

    def begun_again(config: TuningConfig, looks: int) -> None:
        tuning._begin(config)
        _search(config, 0, Channel(stop=StopAfter(looks)))

    whole, parts = (few(tmp_path / name, trials=14) for name in ("whole", "parts"))
    for config in (whole, parts):
        config.out.mkdir()
    begun_again(whole, 10_000)
    told: list[str] = []
    tune(replace(whole, resume=True), tell=told.append)
    assert len(told) == 1, "how much there is to do, before the first trial"
    for looks in (30, 1, 15, 60, 2):
        begun_again(parts, looks)
        study = open_study(parts)
        study.sampler = tuning._sampler(parts, study, 0)
        study.ask(SPACES["sac"])  # and never told
    begun_again(parts, 10_000)
    study = open_study(parts)
    ours, theirs = (
        [(trial.params, trial.value, trial.intermediate_values) for trial in counted(each)]
        for each in (study, open_study(whole))
    )
    assert ours == theirs
    assert len({str(params) for params, *_ in ours}) == len(ours) == 14 < len(study.get_trials())


def test_bad_options_and_a_damaged_study(tmp_path: Path):
    for name, value in {"trials": 0, "base": "papr", "resume": True}.items():
        with pytest.raises((ValueError, OSError), match=name if value in (0, True) else str(value)):
            tune(few(tmp_path, **{name: value}))
    (tmp_path / "sac.db").write_text("not a database, but long enough to be one at first sight " * 40)
    with pytest.raises(ValueError, match=r"sac\.db cannot be read"):
        open_study(few(tmp_path, resume=True))
