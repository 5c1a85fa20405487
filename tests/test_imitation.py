"""Learning by imitation: what a student is told is the teacher's own torque, and a run can be trusted as any other."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

import agents.learners.student
import agents.runs.monitor
from agents.learners.student import Student, StudentConfig
from agents.learners.teaching import Advised, ask, practise
from agents.policy.bundle import load_controller
from agents.residual.controller import ResidualController, ResidualSettings
from agents.runs.monitor import News, TrainingMonitor
from agents.runs.training import train
from baselines import CONTROLLERS
from baselines.iterative.controller import IterativeController
from baselines.iterative.lesson import Lesson, Notes
from baselines.tools.parallel import Channel, Interrupted, StopRequest
from beltarm_env import EPISODE_STEPS
from beltarm_env.rollout import Controller, Recording, rollout
from beltarm_env.task.seeds import MAX_TRAINING_SEED, SEED_SPACING, training_arms
from eval.learning.curves import find_curves

ROOT = Path(__file__).resolve().parent.parent
SEED = 5_700_000
ARMS = 6
OPTIONS: dict[str, Any] = {
    **{"arms": 4, "rounds": 2, "repetitions": 1, "epochs": 2, "batch_size": 32},
    **{"hold": 40, "hidden": (8,), "validation_arms": 2, "base": "paper", "knowledge": "none"},
}
TINY = [
    word
    for name, value in OPTIONS.items()
    for word in (f"--{name.replace('_', '-')}", str(value[0] if isinstance(value, tuple) else value))
]


class Constant:
    """A policy whose residual never changes."""

    def __init__(self, residual: float) -> None:
        self.residual = residual

    def predict(self, observation: NDArray[np.float32], *_: Any, **__: Any) -> tuple[NDArray[np.float32], None]:
        return np.full((len(observation), 1), self.residual, np.float32), None


def trial(controller: Controller) -> Recording:
    return rollout(controller, ARMS, seed=SEED, randomization="ideal")


def student(residual: float, **settings: Any) -> ResidualController:
    return ResidualController(CONTROLLERS["adaptive"](), Constant(residual), ResidualSettings(**settings))


@pytest.fixture(scope="module")
def lesson() -> Lesson:
    return practise(trial, 2)[0]


# What a student is told


def test_practice_pays(lesson: Lesson):
    taught = trial(IterativeController(lesson)).cost
    assert np.mean(taught) < 0.97 * np.mean(trial(CONTROLLERS["adaptive"]()).cost)


@pytest.mark.parametrize("hold", [1, 7])
def test_labels_are_what_the_teacher_would_add(hold: int, lesson: Lesson):
    """Recomputed from what the base saw and did, under a student that adds nothing."""
    pairs, own = ask(trial, student(0.0, limit=0.2, hold=hold), lesson)
    base = Notes(CONTROLLERS["adaptive"]())
    np.testing.assert_array_equal(trial(base).state, own.state)
    teacher, memory, advice = IterativeController(lesson), None, []
    assert lesson.law is not None
    for k, (seen, done) in enumerate(zip(base._observations, base._actions, strict=True)):
        wanted, memory = teacher.predict(seen, memory)
        advice.append(np.where(lesson.law.holds[:, k], (wanted - done)[:, 0], 0.0) / 0.2)
    held = [np.mean(advice[k : k + hold], axis=0).clip(-1, 1) for k in range(0, EPISODE_STEPS, hold)]
    np.testing.assert_allclose(pairs.labels.numpy()[:, 0], np.concatenate(held), atol=2e-5)
    assert pairs.inputs.shape == (len(held) * ARMS, 41)
    assert 0.05 < np.mean(pairs.labels.numpy() == 0) < 0.9, "where the motor sticks, and only there"


def test_a_student_that_does_as_it_is_told_does_as_well_as_its_teacher(lesson: Lesson):
    """Told at every sample, and with room for all that the teacher adds."""

    class Obedient(Advised):
        def predict(self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True):
            action, memory = super().predict(observation, state, episode_start, deterministic)
            return (action + self._advice[-1]).clip(-1, 1), memory

    taught, base = (np.mean(trial(c).cost) for c in (IterativeController(lesson), CONTROLLERS["adaptive"]()))
    own = np.mean(trial(Obedient(student(0.0, limit=2.0, hold=1), lesson)).cost)
    assert own - taught < 0.5 * (base - taught)


def test_arms_that_have_left_are_not_asked_about(lesson: Lesson):
    pairs, own = ask(trial, student(1.0, limit=2.0, hold=10), lesson)
    assert not own.finished.any()
    assert 0 < len(pairs.labels) < ARMS * EPISODE_STEPS / 10 / 2
    assert len(pairs.inputs) == len(pairs.labels)


# Runs


def tiny(out: Path, **options: Any) -> StudentConfig:
    return StudentConfig(**{"out": out, **OPTIONS, **options})


def run(config: StudentConfig, stop: StopRequest | None = None) -> TrainingMonitor:
    return train(config, Student, Channel(stop=stop or StopRequest()))


def weights(folder: Path) -> bytes:
    (path,) = folder.glob("*.safetensors")
    return path.read_bytes()


SEEDS: list[int] = []


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that nothing has interrupted; `SEEDS` are those of its trials."""

    def noted(controller: Controller, arms: int, *, seed: int, **settings: Any) -> Recording:
        SEEDS.append(seed)
        return rollout(controller, arms, seed=seed, **settings)

    folder = tmp_path_factory.mktemp("whole") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(agents.learners.student, "rollout", noted)
        run(tiny(folder))
    return folder


class StopAfter(StopRequest):
    """Made once it has been looked at so often."""

    def __init__(self, looks: int) -> None:
        self.looks = looks

    @property
    def made(self) -> bool:
        self.looks -= 1
        return self.looks < 0

    @made.setter
    def made(self, value: bool) -> None:
        pass


def test_interrupted_and_resumed_is_uninterrupted(whole: Path, tmp_path: Path):
    """Bit for bit: in practice, while the teacher is asked and in a fit, whatever happened to the generators since."""
    config = tiny(tmp_path)
    first_round = 2 * EPISODE_STEPS + config.epochs
    for number, looks in enumerate((1900, first_round - 1, first_round + 400)):
        with pytest.raises(Interrupted, match=r"interrupted at \d+ steps, saved in"):
            run(replace(config, resume=number > 0), StopAfter(looks))
        torch.manual_seed(9)
    run(replace(config, resume=True))
    for kind in ("best", "last"):
        assert weights(tmp_path / kind) == weights(whole / kind)
    ours, theirs = (np.genfromtxt(folder / "validation.csv", delimiter=",")[:, [0, 2]] for folder in (tmp_path, whole))
    np.testing.assert_array_equal(ours, theirs)


def test_more_rounds_go_on_from_the_last(whole: Path, tmp_path: Path):
    """And progress is told."""
    told: list[News] = []
    config = tiny(tmp_path, rounds=1)
    train(config, Student, Channel(told.append))
    steps = [news.steps for news in told]
    assert steps == sorted(steps) and steps[0] == 0 and steps[-1] == config.length
    assert len([news for news in told if news.cost is not None]) == 2
    run(replace(config, rounds=2, resume=True))
    assert weights(tmp_path / "last") == weights(whole / "last")


def test_the_script_is_stopped_and_goes_on(whole: Path, tmp_path: Path):
    """As a user does it: SIGTERM within a round, and the line that is printed."""
    command = [sys.executable, str(ROOT / "train/student.py"), "--out", "run", *TINY]
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 300
    while not (tmp_path / "run/checkpoint.pkl").exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(signal.SIGTERM)
    output, errors = process.communicate(timeout=300)
    assert process.returncode == 130, errors
    assert "python train/student.py --out run" in output and output.rstrip().endswith("--resume")
    run(tiny(tmp_path / "run", resume=True))
    assert weights(tmp_path / "run/last") == weights(whole / "last")


def test_the_untrained_student_is_its_base(tmp_path: Path):
    base = rollout(CONTROLLERS["adaptive"](), 3, seed=SEED, randomization="ideal")
    config = StudentConfig(out=tmp_path)
    untrained = ResidualController(CONTROLLERS["adaptive"](), Student(config).actor(), config.residual)
    np.testing.assert_array_equal(rollout(untrained, 3, seed=SEED, randomization="ideal").state, base.state)


def test_what_is_left_is_a_policy(whole: Path):
    trained, spec = load_controller(whole / "last")
    assert (spec.algorithm, spec.base) == ("student", "paper")
    scores = agents.runs.monitor.validate(trained, 2)
    assert scores == spec.provenance["reached"]["validation"] != spec.provenance["validation_of_base"]


def test_the_curve_counts_what_the_teacher_practises(whole: Path):
    (curve,) = find_curves([whole])
    samples_per_round = 4 * (1 + 1) * EPISODE_STEPS
    assert curve.method == "student on paper"
    assert curve.steps.tolist() == [0, samples_per_round, 2 * samples_per_round]


def test_every_round_has_arms_of_its_own(whole: Path):
    assert whole.exists()
    assert SEEDS == [0, 0, 4, 4], "one repetition and one trial of the student, of four arms"


@given(st.integers(0, MAX_TRAINING_SEED), st.integers(1, 50), st.integers(1, SEED_SPACING))
def test_no_round_meets_the_arms_of_another_training_seed(seed: int, rounds: int, arms: int):
    config = StudentConfig(seed=seed, rounds=rounds, arms=arms)
    if rounds * arms > SEED_SPACING:
        with pytest.raises(
            ValueError, match=f"--rounds times --arms must be at most {SEED_SPACING}, got {rounds} times"
        ):
            config.check()
    else:
        config.check()
        assert training_arms(seed).first + rounds * arms <= training_arms(seed + 1).first


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "no rounds": ({"rounds": 0}, "--rounds must be at least 1, got 0"),
    "no practice": ({"repetitions": 0}, "--repetitions must be at least 1, got 0"),
    "no passes": ({"epochs": 0}, "--epochs must be at least 1, got 0"),
    "Huber": ({"huber": 0.0}, "--huber must be finite and above 0, got 0.0"),
    "diverging": ({"learning_rate": 1e30, "rounds": 1}, "diverged at 0 steps: begin anew with a smaller --learning"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_options(case: str, tmp_path: Path):
    options, message = BAD[case]
    with pytest.raises(ValueError, match=message):
        run(tiny(tmp_path, **options))


def test_a_run_is_not_mixed_with_another(whole: Path):
    with pytest.raises(ValueError, match="has --repetitions 1, not 2"):
        run(tiny(whole, resume=True, repetitions=2))
