"""Learning from a teacher's advice: it is what would have cost less, and a run can be trusted as any other."""

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
from trainings import StopAfter, weights

import agents.learners.student
import agents.runs.monitor
from agents.learners import teaching
from agents.learners.student import Student, StudentConfig
from agents.learners.teaching import Advice, ask, best_changes
from agents.policy.bundle import load_controller, read_spec
from agents.policy.network import NetworkPolicy
from agents.residual.controller import ResidualController, ResidualSettings
from agents.runs.monitor import News, TrainingMonitor
from agents.runs.training import train
from baselines import CONTROLLERS
from baselines.engines.parallel import Channel, Interrupted, StopRequest
from baselines.planning.norm_optimal import Linearisation, norm_weights, optimal_change
from beltarm_env import EPISODE_STEPS, design_model
from beltarm_env.arm import COLUMN, plant_of
from beltarm_env.physics.drive import built_drive
from beltarm_env.physics.kinematics import tip_errors
from beltarm_env.rollout import Controller, Recording, rollout
from beltarm_env.task.cost import POSITION_SCALE, TORQUE_RATE_WEIGHT, VELOCITY_SCALE
from beltarm_env.task.reference import sampled_moves
from beltarm_env.task.seeds import MAX_TRAINING_SEED, SEED_SPACING, training_arms
from eval.report.curves import find_curves

ROOT = Path(__file__).resolve().parents[2]
SEED = 5_700_000
ARMS = 6
OPTIONS: dict[str, Any] = {
    **{"arms": 4, "rounds": 2, "remembered": 2, "epochs": 2, "batch_size": 2, "gru_width": 6},
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
    return rollout(controller, ARMS, seed=SEED, randomization="train")


def student(residual: float, **settings: Any) -> ResidualController:
    return ResidualController(CONTROLLERS["preview"](), Constant(residual), ResidualSettings(**settings))


@pytest.fixture(scope="module")
def recording() -> Recording:
    return trial(CONTROLLERS["preview"]())


class Law:
    """Torques of a recording, changed, with the feedback that the teacher reckons with."""

    def __init__(self, recording: Recording, arm: int) -> None:
        self.row, self.torque = recording.params[arm], np.ascontiguousarray(recording.torque[:, arm])
        self.limit = float(self.row[COLUMN.torque_limit])
        self.states = np.ascontiguousarray(teaching._motion(recording)[:, arm])
        self.task = np.ascontiguousarray(sampled_moves(recording.moves[[arm]])[0, 1:, :2])
        linearisation = Linearisation(design_model(), EPISODE_STEPS)
        about = linearisation.about(self.states, self.torque, self.task, self.row)
        step = np.diff(self.torque, prepend=0.0)
        weights = norm_weights(about.errors, step, self.limit, teaching._EFFORT, teaching._SOFT)
        _, self.gain = optimal_change(about, weights, self.torque)

    def cost(self, changes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Cost of the task under changes of the torque [N m], shape (candidates, 1200), simulated."""
        count = len(changes)
        arms = teaching.ArmSimulation(design_model(), count)
        table = np.repeat(self.row[None], count, axis=0)
        now, last = np.repeat(self.states[:1], count, axis=0), np.zeros((count, 1))
        states, torques = np.empty((EPISODE_STEPS, count, now.shape[1])), np.empty((EPISODE_STEPS, count))
        for k in range(EPISODE_STEPS):
            away = np.concatenate([now - self.states[k], last], axis=1)
            torques[k] = self.torque[k] + changes[:, k] - away @ self.gain[k]
            last = (torques[k] - self.torque[k])[:, None]
            arms.set_table(table, np.full(count, float(k)))
            now = arms.advance(now, torques[k])
            states[k] = now
        return self._charged(states, torques)

    def _charged(self, states: NDArray[np.float64], torques: NDArray[np.float64]) -> NDArray[np.float64]:
        plant, drive = plant_of(self.row), built_drive(self.row)
        costs = np.empty(states.shape[1])
        for i in range(len(costs)):
            errors = tip_errors(np.ascontiguousarray(states[:, i, :4]), self.task, plant, drive)
            position, velocity = np.hypot(*errors.T[:2]) / POSITION_SCALE, np.hypot(*errors.T[2:]) / VELOCITY_SCALE
            change = TORQUE_RATE_WEIGHT * np.abs(np.diff(torques[:, i], prepend=0.0)) / self.limit
            costs[i] = (position + velocity + change).sum()
        return costs


# What a student is told


def test_advice_is_the_slope_of_the_cost_that_the_student_pays(recording: Recording, monkeypatch: pytest.MonkeyPatch):
    """One torque is changed, everything after it reacts by feedback alone, and the simulated cost changes by -2 h c."""
    monkeypatch.setattr(teaching, "_SOFT", (1e-9, 1e-9))
    changes, curvatures = best_changes(recording)
    for arm in range(3):
        law = Law(recording, arm)
        samples = np.arange(20, 1000, 70)
        small = np.zeros((2 * len(samples), EPISODE_STEPS))
        small[np.arange(len(samples)), samples] = step = 2e-6
        small[len(samples) + np.arange(len(samples)), samples] = -step
        up, down = law.cost(small).reshape(2, -1)
        told = -2 * (curvatures * changes)[samples, arm] / law.limit
        found = (up - down) / (2 * step)
        moving = np.abs(recording.state[samples - 1, arm, 1]) > 3.0
        assert moving.sum() >= 4
        scale = np.abs(found[moving]).max()
        np.testing.assert_allclose(told[moving], found[moving], atol=0.03 * scale)


def test_who_follows_the_advice_pays_less(recording: Recording):
    changes, _ = best_changes(recording)
    for arm in range(3):
        law = Law(recording, arm)
        shares = np.array([0.0, 0.3, 1.0])
        costs = law.cost(shares[:, None] * changes[:, arm] * law.limit)
        assert costs[0] == pytest.approx(recording.cost[arm], rel=1e-6)
        assert costs[1] < 0.95 * costs[0] and costs[2] < 0.85 * costs[0]


def test_the_advice_is_to_stay_where_the_motor_sticks(recording: Recording):
    changes, _ = best_changes(recording)
    rests = (recording.state[:-1, :, 1] == 0) & (recording.state[1:, :, 1] == 0)
    assert rests.mean() > 0.1
    assert np.median(np.abs(changes[1:][rests])) < 0.1 * np.median(np.abs(changes[1:][~rests]))


@pytest.mark.parametrize(("residual", "hold"), [(0.0, 1), (0.2, 7)])
def test_labels_are_what_would_have_been_best_of_a_held_residual(residual: float, hold: int):
    advice, own = ask(trial, student(residual, limit=0.2, hold=hold))
    changes, curvatures = best_changes(own)
    assert advice.inputs.shape == (-(-EPISODE_STEPS // hold), ARMS, StudentConfig().spec().shape().inputs)
    for k, start in enumerate(range(0, EPISODE_STEPS, hold)):
        c, h = (part[start : start + hold] for part in (changes, curvatures))
        speeds = np.concatenate([np.zeros((1, ARMS)), own.state[:, :, 1]])[start : start + len(h) + 1]
        rests, torque = (speeds[:-1] == 0) & (speeds[1:] == 0), own.torque[start : start + len(h)] / 0.3
        prices = np.where(rests, teaching._PRICE_AT_REST, teaching._PRICE)
        pulled = h * c - prices * np.where(rests, torque, 0.2 * residual)
        best = residual + pulled.sum(axis=0) / (h + prices).sum(axis=0) / 0.2
        np.testing.assert_allclose(advice.labels[k], best.clip(-1, 1), atol=2e-5)
    assert float(advice.weights.mean()) == pytest.approx(1.0, rel=1e-5)


def test_a_student_is_simulated_as_it_was(recording: Recording):
    np.testing.assert_array_equal(teaching._motion(recording)[1:, :, :4], recording.state[:-1])


def test_arms_that_have_left_are_not_asked_about():
    advice, own = ask(trial, student(1.0, limit=2.0, hold=10))
    assert not own.finished.any()
    assert advice.inputs.shape[1] == advice.labels.shape[1] == advice.weights.shape[1] == 0


class TestFit:
    """What a student learns is the weighted mean of the advice about what it cannot tell apart."""

    @staticmethod
    def fitted(advice: Advice, **options: Any) -> Student:
        config = tiny(Path("unused"), **{"rounds": 1, "epochs": 300, "learning_rate": 0.02, **options})
        learner = Student(config)
        learner.advice = [advice]
        learner._fit(lambda _: None)
        return learner

    def test_equal_inputs_get_the_weighted_mean(self):
        inputs = torch.zeros(30, 2, 26).half()
        labels, weights = torch.zeros(30, 2), torch.ones(30, 2)
        labels[:, 0], weights[:, 0] = 0.3, 3.0
        actor = self.fitted(Advice(inputs, labels, weights), huber=10.0)._regression.network
        assert float(actor(inputs.float()).detach().mean()) == pytest.approx(0.225, abs=0.01)

    @pytest.mark.parametrize(("width", "remembers"), [(6, True), (0, False)])
    def test_a_memory_tells_apart_what_looks_the_same(self, width: int, remembers: bool):
        """Two episodes that differ in their first hold alone."""
        inputs = torch.zeros(10, 2, 26)
        inputs[0, 0, 3] = 1.0
        labels = torch.tensor([[0.4, -0.4]]).repeat(10, 1)
        actor = self.fitted(Advice(inputs.half(), labels, torch.ones(10, 2)), gru_width=width)._regression.network
        late = actor(inputs)[-1, :, 0].detach().numpy()
        assert (late[0] - late[1] > 0.6) == remembers and (abs(late[0] - late[1]) < 0.01) != remembers


# Runs


def tiny(out: Path, **options: Any) -> StudentConfig:
    return StudentConfig(**{"out": out, **OPTIONS, **options})


def run(config: StudentConfig, stop: StopRequest | None = None) -> TrainingMonitor:
    return train(config, Student, Channel(stop=stop or StopRequest()))


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


def test_interrupted_and_resumed_is_uninterrupted(whole: Path, tmp_path: Path):
    """Bit for bit: in acting, while the teacher is asked and in a fit, whatever happened to the generators since."""
    config = tiny(tmp_path)
    first_round = EPISODE_STEPS + config.arms + config.epochs * config.arms // config.batch_size
    for number, looks in enumerate((700, EPISODE_STEPS + 2, first_round - 1, first_round + 400)):
        with pytest.raises(Interrupted, match=r"interrupted at \d+ steps, saved in"):
            run(replace(config, resume=number > 0), StopAfter(looks))
        torch.manual_seed(9)
    run(replace(config, resume=True))
    for kind in ("best", "last"):
        assert weights(tmp_path / kind) == weights(whole / kind)
    ours, theirs = (np.genfromtxt(folder / "validation.csv", delimiter=",")[:, [0, 2]] for folder in (tmp_path, whole))
    np.testing.assert_array_equal(ours, theirs)


def test_more_rounds_go_on_from_the_last(whole: Path, tmp_path: Path):
    """With a learning rate that falls to another end; and progress is told."""
    told: list[News] = []
    config = tiny(tmp_path, rounds=1)
    train(config, Student, Channel(told.append))
    steps = [news.steps for news in told]
    assert steps == sorted(steps) and steps[0] == 0 and steps[-1] == config.length
    assert len([news for news in told if news.cost is not None]) == 2
    monitor = run(replace(config, rounds=2, resume=True))
    assert [point[0] for point in monitor.curve] == [0, config.length, 2 * config.length]
    assert weights(tmp_path / "last") != weights(whole / "last")


@pytest.mark.slow
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
    base = rollout(CONTROLLERS["adaptive"](), 3, seed=SEED, randomization="train")
    config = StudentConfig(out=tmp_path)
    untrained = ResidualController(
        CONTROLLERS["adaptive"](), NetworkPolicy(Student(config).actor().weights()), config.residual
    )
    np.testing.assert_array_equal(rollout(untrained, 3, seed=SEED, randomization="train").state, base.state)


def test_what_is_left_is_a_policy(whole: Path):
    trained = load_controller(whole / "last")
    spec, _ = read_spec(whole / "last")
    assert (spec.algorithm, spec.base) == ("student", "paper")
    scores = agents.runs.monitor.validate(trained, 2)
    assert scores == spec.provenance["reached"]["validation"] != spec.provenance["validation_of_base"]


def test_the_curve_counts_samples(whole: Path):
    (curve,) = find_curves([whole])
    samples_per_round = 4 * EPISODE_STEPS
    assert curve.method == "student on paper"
    assert curve.steps.tolist() == [0, samples_per_round, 2 * samples_per_round]


def test_every_round_has_arms_of_its_own(whole: Path):
    assert whole.exists()
    assert SEEDS == [0, 4], "trials of four arms"


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
    "no memory of advice": ({"remembered": 0}, "--remembered must be at least 1, got 0"),
    "GRU of negative width": ({"gru_width": -1}, "--gru-width must be at least 0, got -1"),
    "no passes": ({"epochs": 0}, "--epochs must be at least 1, got 0"),
    "Huber": ({"huber": 0.0}, "--huber must be finite and above 0, got 0.0"),
    "diverging": ({"learning_rate": 1e30, "rounds": 1}, "diverged at 0 steps: start again with a smaller --learning"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_options(case: str, tmp_path: Path):
    options, message = BAD[case]
    with pytest.raises(ValueError, match=message):
        run(tiny(tmp_path, **options))


def test_a_run_is_not_mixed_with_another(whole: Path):
    with pytest.raises(ValueError, match="has --remembered 2, not 3"):
        run(tiny(whole, resume=True, remembered=3))
