"""Learning from a teacher, as `student` does, and PPO that goes on from there: the advice, the fits, and the runs."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from properties import examples
from refusals import refused
from trainings import StopAfter, run, same_policies, tiny

import agents.learners.student
from agents.learners import teaching
from agents.learners.ppo import ALONE, PpoConfig, TaughtLearner
from agents.learners.student import Student, StudentConfig
from agents.learners.teaching import Advice, Recorder, advise, best_changes
from agents.observer.quantities import NAMES
from agents.policy.actor import Actor
from agents.policy.bundle import load_controller, read_spec
from agents.policy.network import NetworkPolicy
from agents.residual.controller import ResidualController, ResidualSettings
from agents.residual.knowledge import offered
from agents.runs.command_line import begun_options
from agents.runs.training import News, TrainingMonitor, validate
from baselines import CONTROLLERS
from baselines.engines.parallel import Interrupted
from baselines.planning.norm_optimal import Linearisation, norm_weights, optimal_change
from baselines.tools.options import parse
from beltarm_env import EPISODE_STEPS, design_model
from beltarm_env.arm import COLUMN, plant_of
from beltarm_env.physics.drive import real_drive_of
from beltarm_env.physics.kinematics import tip_errors
from beltarm_env.rollout import Recording, rollout
from beltarm_env.task.cost import POSITION_SCALE, TORQUE_RATE_WEIGHT, VELOCITY_SCALE
from beltarm_env.task.reference import sampled_moves
from beltarm_env.task.seeds import MAX_TRAINING_SEED, SEED_SPACING, training_arms

SEED = 5_700_000
ARMS = 6


class Constant:
    def __init__(self, residual: float | NDArray[np.float64]) -> None:
        self.residual = residual

    def predict(self, observation: NDArray[np.float32], *_: Any, **__: Any) -> tuple[NDArray[np.float32], None]:
        return np.full((len(observation), 1), self.residual, np.float32), None


@pytest.fixture(scope="module")
def recording() -> Recording:
    return rollout(CONTROLLERS["preview"](), ARMS, seed=SEED, randomization="train")


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
        _, self.gain, _ = optimal_change(about, weights, self.torque)

    def cost(self, changes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Cost of the task under changes of the torque [N m], shape (candidates, 1200), simulated."""
        count = len(changes)
        arms = teaching.ArmSimulation(design_model(), count)
        table = np.repeat(self.row[None], count, axis=0)
        now, last = np.repeat(self.states[:1], count, axis=0), np.zeros((count, 1))
        states, torques, costs = np.empty((1200, count, now.shape[1])), np.empty((1200, count)), np.empty(count)
        for k in range(EPISODE_STEPS):
            away = np.concatenate([now - self.states[k], last], axis=1)
            torques[k] = self.torque[k] + changes[:, k] - away @ self.gain[k]
            last = (torques[k] - self.torque[k])[:, None]
            arms.set_table(table, np.full(count, float(k)))
            now = arms.advance(now, torques[k])
            states[k] = now
        plant, drive = plant_of(self.row), real_drive_of(self.row)
        for i in range(count):
            errors = tip_errors(np.ascontiguousarray(states[:, i, :4]), self.task, plant, drive)
            position, velocity = np.hypot(*errors.T[:2]) / POSITION_SCALE, np.hypot(*errors.T[2:]) / VELOCITY_SCALE
            change = TORQUE_RATE_WEIGHT * np.abs(np.diff(torques[:, i], prepend=0.0)) / self.limit
            costs[i] = (position + velocity + change).sum()
        return costs


def test_advice_is_the_slope_of_the_cost_that_the_student_pays(recording: Recording, monkeypatch: pytest.MonkeyPatch):
    """One torque is changed, everything after it reacts by feedback alone, and the simulated cost changes by -2 h c."""
    monkeypatch.setattr(teaching, "_SOFT", (1e-9, 1e-9))
    changes, curvatures = best_changes(recording, torque_price=1.0)
    for arm in range(3):
        law = Law(recording, arm)
        samples, step = np.arange(20, 1000, 70), 2e-6
        single = step * np.eye(EPISODE_STEPS)[samples]
        up, down = law.cost(np.concatenate([single, -single])).reshape(2, -1)
        reported = -2 * (curvatures * changes)[samples, arm] / law.limit
        actual = (up - down) / (2 * step)
        moving = np.abs(recording.state[samples - 1, arm, 1]) > 3.0
        assert moving.sum() >= 4
        np.testing.assert_allclose(reported[moving], actual[moving], atol=0.03 * np.abs(actual[moving]).max())


@pytest.mark.parametrize(("residual", "hold"), [(0.0, 1), (0.2, 7)])
def test_labels_are_what_would_have_been_best_of_a_held_residual(residual: float, hold: int):
    settings = ResidualSettings(limit=0.2, hold=hold)
    recorder = Recorder(Constant(residual))
    controller = ResidualController(CONTROLLERS["preview"](), recorder, settings)
    own = rollout(controller, ARMS, seed=SEED, randomization="train")
    advice = advise(own, recorder, settings, 1.5)
    changes, curvatures = best_changes(own)
    assert advice.inputs.shape == (-(-EPISODE_STEPS // hold), ARMS, StudentConfig().spec().shape().inputs)
    for k, start in enumerate(range(0, EPISODE_STEPS, hold)):
        c, h = (part[start : start + hold] for part in (changes, curvatures))
        pulled, weight = h * c - 1.5 * 0.2 * residual, h + 1.5
        best = residual + pulled.sum(axis=0) / weight.sum(axis=0) / 0.2
        np.testing.assert_allclose(advice.labels[k], best.clip(-1, 1), atol=2e-5)
    assert float(advice.weights.mean()) == pytest.approx(1.0, rel=1e-5)


def test_advice_on_a_shift():
    """Every move is advised on in the state that it begins in, bit for bit; memory lasts in training as in acting."""
    settings, task = ResidualSettings(limit=0.2, hold=4), {"randomization": "train", "moves": 3}
    torch.manual_seed(0)
    recorder = Recorder(NetworkPolicy((actor := Actor(StudentConfig(gru_width=4).spec().shape())).weights()))
    recording = rollout(ResidualController(CONTROLLERS["preview"](), recorder, settings), 2, seed=SEED, **task)
    states = teaching._motion(recording)
    np.testing.assert_array_equal(states[1:, :, :4], recording.state[:-1])
    np.testing.assert_array_equal(states[0, 2:, :4], recording.state[-1, :-2])
    inputs, residuals = recorder.held(0, settings.hold)
    fitted = actor(torch.from_numpy(inputs)).detach()[..., 0].clamp(-1, 1)
    np.testing.assert_allclose(residuals, fitted, atol=1e-5)
    advice, (changes, curvatures) = advise(recording, recorder, settings, 1.0), best_changes(recording)
    assert advice.labels.shape == (3 * 300, 2) and 0 < curvatures.min() <= curvatures.max() < 100
    steady = best_changes(recording, torque_price=1e9)[0][0] * recording.params[:, COLUMN.torque_limit]
    np.testing.assert_allclose(steady, recording.torque_before - recording.torque[0], atol=0.02)
    c, h = changes[40:44, 3], curvatures[40:44, 3]
    best = residuals[310, 1] + (h * c - 0.2 * residuals[310, 1]).sum() / (h + 1).sum() / 0.2
    assert float(advice.labels[310, 1]) == pytest.approx(best, abs=1e-5)
    at = [entry.name for entry in offered("belief")].index("believed_tip_error_y")
    error = recording.tip_error[39, 3, 1] - 0.003 * recorder.inputs[310][1, at]
    assert float(advice.missed[310, 1, NAMES.index("tip_error_y")]) == pytest.approx(error, rel=1e-3) != 0


def test_an_arm_that_leaves_changes_no_advice_to_others():
    """It begins anew in the middle of the others' holds. Where all leave there is no advice, and nothing is learned."""
    settings, advice, task = ResidualSettings(limit=2.0, hold=4), [], {"randomization": "train", "moves": 2}
    for residuals in ([[0.0], [0.0]], [[1.0], [0.0]], [[1.0], [1.0]]):
        recorder = Recorder(Constant(np.array(residuals)))
        controller = ResidualController(CONTROLLERS["paper"](), recorder, settings)
        advice.append(advise(rollout(controller, 2, seed=SEED, **task), recorder, settings, 1.0))
    both, one, none = advice
    assert torch.equal(both.labels[:, 1:], one.labels) and torch.equal(both.missed[:, 1:], one.missed)
    assert [part.shape for part in none] == [(600, 0, *part.shape[2:]) for part in both]
    learner = Student(tiny("student", Path("unused")))
    learner.advice = [none]
    assert learner.fit() == 0.0 and torch.isfinite(learner.actor().mean).all()


@pytest.mark.parametrize(("width", "segment", "remembers"), [(6, 10, True), (6, 4, True), (0, 10, False)])
def test_a_memory_tells_apart_what_looks_the_same(width: int, segment: int, remembers: bool):
    """Two episodes that differ in their first hold alone; what is the same in all training does not count."""
    inputs = torch.zeros(10, 2, 27)
    inputs[0, 0, 3] = inputs[..., 25] = 1.0
    labels = torch.tensor([[0.4, -0.4]]).repeat(10, 1)
    fit = {"rounds": 1, "epochs": 300, "learning_rate": 0.02}
    learner = Student(tiny("student", Path("unused"), **fit, gru_width=width, segment=segment))
    learner.advice = [Advice(inputs.half(), labels, torch.ones(10, 2), torch.zeros(10, 2, len(NAMES)))]
    learner.fit()
    actor = learner._regression.network
    outputs = actor(inputs)
    torch.testing.assert_close(actor(inputs * (torch.arange(27) != 25)), outputs, rtol=0, atol=1e-5)
    first, memory = actor.features(inputs[:4])
    torch.testing.assert_close(actor.layers(torch.cat([first, actor.features(inputs[4:], memory)[0]])), outputs)
    apart = float((outputs[-1, 0, 0] - outputs[-1, 1, 0]).detach())
    assert (apart > 0.6) == remembers and (abs(apart) < 0.01) != remembers


@pytest.mark.parametrize("nominal", [(), ("presliding_deflection", "payload_mass")])
def test_what_varies_in_training(nominal: tuple[str, ...]):
    """Motors give in every other round; never what is to be nominal."""
    learner = Student(tiny("student", Path("unused"), moves=2, hold=12, nominal=nominal))
    for learner.rounds in (0, 1):
        gives, parts = learner.move()[0].params[:, [COLUMN.presliding_deflection, COLUMN.payload_mass]].T
        assert (gives.any(), parts.any()) == (not nominal and not learner.rounds, not nominal)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[int]]:
    folder = tmp_path_factory.mktemp("whole") / "run"
    with patch.object(agents.learners.student, "rollout", wraps=rollout) as called:
        run(tiny("student", folder))
    return folder, [call.kwargs["seed"] for call in called.call_args_list]


def test_interrupted_and_resumed_is_uninterrupted(whole: tuple[Path, list[int]], tmp_path: Path):
    """Bit for bit: in acting, while the teacher is asked and in a fit, whatever happened to the generators since."""
    folder, _ = whole
    config = tiny("student", tmp_path)
    holds = EPISODE_STEPS // config.hold
    first_round = holds + config.arms + config.epochs * config.arms // config.batch_size
    for number, looks in enumerate((17, holds + 2, first_round - 1, first_round + 10)):
        refused(Interrupted, ("steps",), partial(run, replace(config, resume=number > 0), StopAfter(looks)))
        torch.manual_seed(9)
    run(replace(config, resume=True))
    assert same_policies(tmp_path, folder)
    ours, theirs = (np.genfromtxt(path / "validation.csv", delimiter=",")[:, [0, 2]] for path in (tmp_path, folder))
    np.testing.assert_array_equal(ours, theirs)


def test_what_is_left_is_a_policy_with_its_score(whole: tuple[Path, list[int]]):
    (folder, seeds), (spec, _) = whole, read_spec(whole[0] / "last")
    assert (spec.algorithm, spec.base, spec.gru) == ("student", "paper", 6)
    scores = validate(load_controller(folder / "last"), 2)
    assert scores == spec.provenance["reached"]["validation"] != spec.provenance["validation_of_base"]
    assert seeds == [4 * k for k in range(len(seeds))] != [], "every round has arms of its own, trials of four"


def test_more_rounds_go_on_from_the_last(tmp_path: Path):
    reports, config = list[News](), tiny("student", tmp_path, rounds=1)
    run(config, report=reports.append)
    assert (steps := [news.steps for news in reports]) == sorted(steps) and (steps[0], steps[-1]) == (0, config.length)
    assert len([news for news in reports if news.cost is not None]) == 2
    run(replace(config, out=tmp_path / "dear", residual_price=9.0))
    assert not same_policies(tmp_path / "dear", tmp_path)
    monitor = run(replace(config, rounds=2, resume=True))
    assert [point[0] for point in monitor.curve] == [0, config.length, 2 * config.length]
    refused(ValueError, ("--remembered 2, not 3",), lambda: run(replace(config, resume=True, remembered=3)))


def test_the_untrained_policy_is_its_base(tmp_path: Path):
    base = rollout(CONTROLLERS["adaptive"](), 3, seed=SEED, randomization="train")
    config = StudentConfig(out=tmp_path)
    policy = NetworkPolicy(config.make_learner().actor().weights())
    untrained = ResidualController(CONTROLLERS["adaptive"](), policy, config.residual)
    np.testing.assert_array_equal(rollout(untrained, 3, seed=SEED, randomization="train").state, base.state)


@examples(20)
@given(st.integers(0, MAX_TRAINING_SEED), st.integers(1, 50), st.integers(1, SEED_SPACING))
def test_no_round_meets_the_arms_of_another_training_seed(seed: int, rounds: int, arms: int):
    config = StudentConfig(seed=seed, rounds=rounds, arms=arms)
    if rounds * arms > SEED_SPACING:
        refused(ValueError, ("--rounds", "--arms", str(rounds)), config.check)
    else:
        config.check()
        assert rounds * arms <= training_arms(seed).size


def taught(out: Path, **options: Any) -> PpoConfig:
    """Two rounds of a teacher for four arms, and four rollouts of PPO, in the first of which the actor waits."""
    own = {"teacher_rounds": 2, "teacher_arms": 4, "critic_steps": 64, "knowledge": "none", "moves": 1}
    return tiny("ppo", out, **{**own, **options})


@pytest.fixture(scope="module")
def whole_taught(tmp_path_factory: pytest.TempPathFactory) -> TrainingMonitor:
    return run(taught(tmp_path_factory.mktemp("taught") / "run"))


def test_ppo_begins_with_what_the_teacher_taught(whole_taught: TrainingMonitor, tmp_path: Path):
    """Its policy is the student's, its critic learns first, and then the actor does."""
    with patch.object(PpoConfig, "check"):  # which refuses a run that ends before its actor learns
        learner = run(taught(tmp_path, total_steps=64)).learner
    assert isinstance(learner, TaughtLearner)
    student, actor = learner.student.actor(), learner.actor()
    ours, theirs = (each.weights().arrays for each in (actor, student))
    assert np.abs(theirs["layers.2.weight"]).max() > 0 and np.abs(theirs["mean"]).max() > 0
    assert ours.keys() == theirs.keys() and all(np.array_equal(ours[name], theirs[name]) for name in ours)
    seen = learner.env.reset()
    expected, _ = learner.model.predict(seen, deterministic=True)
    np.testing.assert_allclose(NetworkPolicy(actor.weights()).predict(seen)[0], expected, atol=1e-6)
    learned = whole_taught.learner.actor().weights().arrays
    assert np.array_equal(learned["mean"], theirs["mean"])
    assert not np.array_equal(learned["layers.0.weight"], theirs["layers.0.weight"])


def test_a_run_stopped_in_either_part_goes_on_as_if_it_had_not_been(whole_taught: TrainingMonitor, tmp_path: Path):
    folder = whole_taught.config.out
    spec, _ = read_spec(folder / "last")
    assert (spec.algorithm, spec.standardised, spec.gru) == ("ppo", True, 0)
    rounds = [0, 4 * 30, 2 * 4 * 30]  # of 4 arms with 30 holds
    assert [steps for steps, _, _ in whole_taught.curve] == [*rounds, rounds[-1] + 128, rounds[-1] + 256]
    assert spec.provenance["run"]["steps"] == whole_taught.learner.steps == whole_taught.config.length
    assert validate(load_controller(folder / "last"), 4) == spec.provenance["reached"]["validation"]
    config, stops = taught(tmp_path), 0
    for looks in (5, 30, 70, 72):
        try:
            run(replace(config, resume=stops > 0), StopAfter(looks))
        except Interrupted:
            stops += 1
        np.random.seed(5)  # noqa: NPY002
        torch.manual_seed(9)
    assert stops > 1
    run(replace(config, resume=True))
    assert same_policies(folder, tmp_path)


def test_options_that_are_not_given_are_those_for_the_base():
    def read(*told: str) -> PpoConfig:
        return parse(PpoConfig, arguments=told, begun=begun_options)

    assert read() == read("--base", "adaptive", "--teacher-rounds", "10") == PpoConfig(teacher_rounds=10)
    config = read("--base", "paper", "--teacher-rounds", "3", "--gamma", "0.9")
    assert config == PpoConfig(base="paper", teacher_rounds=3, gamma=0.9)
    student = config.student()
    assert (student.rounds, student.arms, student.gru_width) == (3, config.teacher_arms, 0)
    assert (student.hidden, student.residual_limit, student.residual_price) == ((128, 128), 0.5, 1.0)
    alone = {**ALONE, "hidden": tuple(ALONE["hidden"])}
    assert read("--base", "paper") == PpoConfig(**alone, base="paper")
    assert read("--teacher-rounds", "0", "--arms", "64") == PpoConfig(**{**alone, "teacher_rounds": 0, "arms": 64})
    there = ("--base", "paper", "--out", "nowhere", "--resume")  # in a storage, with no options noted here
    assert read(*there) == PpoConfig(**alone, base="paper", out=Path("nowhere"), resume=True)
