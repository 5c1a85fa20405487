"""Practice: the norm-optimal change against independent solutions, the textbook's learning, and memory of the arm."""

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples
from refusals import refused
from scipy.optimize import lsq_linear

from baselines import PaperController, tuned_controller
from baselines.estimation.believed_arm import DISTURBANCE, GIVING, SIZE
from baselines.planning.norm_optimal import Linearisation, Trial, Weights, followed, optimal_change
from baselines.yardsticks.iterative import IterativeController
from baselines.yardsticks.remembering import RememberingController
from beltarm_env import EPISODE_STEPS, ArmParams, BeltArmEnv, BeltArmVectorEnv, design_model
from beltarm_env.arm import params_table
from beltarm_env.physics.friction import SLIPS
from beltarm_env.rollout import rollout
from beltarm_env.simulation import ArmSimulation
from beltarm_env.task.cost import VELOCITY_SCALE

SEED = 4_200_000
NOMINAL = params_table([ArmParams()])[0]


def random_trial(rng: np.random.Generator, steps: int) -> Trial:
    transition = rng.normal(0, 0.4, (steps, 4, 4))
    by_torque = rng.normal(0, 1, (steps, 4)) * (rng.random(steps) > 0.2)[:, None]  # in some the motor is stuck
    return Trial(transition, by_torque, rng.normal(0, 1, (steps, 4)), rng.normal(0, 1, (steps, 4, 4)))


def changes_of_state(trial: Trial, push: np.ndarray) -> np.ndarray:
    """Changes of the states that the linear problem predicts for changes of the torque, shape (T, states)."""
    dx, changes = np.zeros(trial.transition.shape[-1]), []
    for transition, by_torque, change in zip(trial.transition, trial.by_torque, push, strict=True):
        dx = transition @ dx + by_torque * change
        changes.append(dx)
    return np.array(changes)


def lifted(trial: Trial) -> np.ndarray:
    """Errors of the whole trial over all changes of the torque, shape (4 T, T)."""
    changes = [changes_of_state(trial, unit)[:, :, None] for unit in np.eye(len(trial.by_torque))]
    return np.stack([(trial.of_state @ dx).ravel() for dx in changes], axis=1)


def stacked(trial: Trial, weights: Weights, torque_change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same problem as one least squares: its matrix and what is wanted; the last rows are the effort."""
    steps = len(torque_change)
    roots, smooth = np.sqrt(weights.errors).ravel(), np.sqrt(weights.smoothness)
    difference = np.eye(steps) - np.eye(steps, k=-1)
    rows = roots[:, None] * lifted(trial), smooth[:, None] * difference, np.sqrt(weights.effort) * np.eye(steps)
    wanted = np.concatenate([-roots * trial.errors.ravel(), -smooth * torque_change, np.zeros(steps)])
    return np.vstack(rows), wanted


@examples(40)
@given(st.integers(0, 2**32 - 1), st.integers(1, 25))
def test_change_is_that_of_the_lifted_least_squares(seed: int, steps: int):
    rng = np.random.default_rng(seed)
    trial, before = random_trial(rng, steps), rng.normal(0, 1, steps)
    weights = Weights(rng.uniform(0.1, 3, (steps, 4)), rng.uniform(0, 2, steps), float(rng.uniform(0.01, 2)))
    change, gain, _ = optimal_change(trial, weights, np.cumsum(before))
    expected = np.linalg.lstsq(*stacked(trial, weights, before), rcond=None)[0]
    np.testing.assert_allclose(followed(trial, change, gain), expected, rtol=1e-7, atol=1e-9)
    k, dx, last = steps // 2, rng.normal(0, 1, 4), rng.normal()
    rest, free = Trial(*(part[k:].copy() for part in trial)), dx
    for j in range(steps - k):
        free = trial.transition[k + j] @ free
        rest.errors[j] += trial.of_state[k + j] @ free
    of_rest = Weights(weights.errors[k:], weights.smoothness[k:], weights.effort)
    first = np.linalg.lstsq(*stacked(rest, of_rest, np.append(before[k] - last, before[k + 1 :])), rcond=None)[0][0]
    assert change[k] - gain[k] @ np.append(dx, last) == pytest.approx(first, rel=1e-7, abs=1e-9), "disturbed at k"


def test_limited_changes_end_at_the_bounded_least_squares():
    rng, limit = np.random.default_rng(6), 0.3
    trial, torque = random_trial(rng, 20), np.zeros(20)
    weights = Weights(rng.uniform(0.1, 3, (20, 4)), rng.uniform(0.1, 2, 20), 1e-2)
    matrix, errors = lifted(trial), trial.errors.ravel()
    for _ in range(50):
        now = trial._replace(errors=(errors + matrix @ torque).reshape(20, 4))
        torque = np.clip(torque + followed(now, *optimal_change(now, weights, torque, limit)[:2]), -limit, limit)
    rows, wanted = stacked(trial, weights, np.zeros(20))
    expected = lsq_linear(rows[:-20], wanted[:-20], (-limit, limit), method="bvls").x
    assert 3 < (np.abs(expected) == limit).sum() < 17
    np.testing.assert_allclose(torque, expected, atol=1e-6)


def simulated(params: ArmParams, torques: np.ndarray, start: float) -> np.ndarray:
    """States of an arm and its drive before each sample and after the last, friction drifting."""
    simulation, row = ArmSimulation(params), params.row()[None]
    states = [simulation.at_rest(np.array([start]))]
    for step, torque in enumerate(torques):
        simulation.set_table(row, np.array([float(step)]))
        states.append(simulation.advance(states[-1], torque[None]))
    return np.concatenate(states)


def test_linearisation_predicts_what_the_drive_does():
    """Lag, 1.4 samples of latency, ripple, kinematic error, drift of friction: simulated as the environment does."""
    env = BeltArmEnv(randomization="train")
    env.reset(seed=SEED, options={"params": {"command_latency": 0.0021, "friction_drift": 0.15}})
    torques = 0.3 * np.full(40, 0.4, np.float32).astype(np.float64)
    states, info = simulated(env.params, torques, env.state[0]), {}
    for _ in range(40):
        _, _, _, _, info = env.step(np.array([0.4], np.float32))
    np.testing.assert_allclose(states[-1, :4], env.state, rtol=1e-12)
    task = np.tile(env.reference(40 * 0.0015)[:2], (40, 1))
    trial = Linearisation(env.params, 40).about(states[:-1], torques, task, env.params.row())
    assert np.hypot(*trial.errors[-1, :2]) == pytest.approx(info["tip_error"], rel=1e-9)
    assert np.hypot(*trial.errors[-1, 2:]) / VELOCITY_SCALE == pytest.approx(info["cost_velocity"], rel=1e-9)
    push = np.where(np.arange(40) >= 20, 1e-4, 0.0)
    moved = simulated(env.params, torques + push, states[0, 0])[-1] - states[-1]
    np.testing.assert_allclose(moved, changes_of_state(trial, push)[-1], rtol=0.02)


def test_linearisation_of_a_motor_that_gives():
    arm = replace(design_model(), presliding_deflection=0.002, friction_drift=0.0)
    torques = np.concatenate([np.full(30, 0.08), np.full(30, -0.06), np.full(60, 0.01)])
    states, count = simulated(arm, torques, 62.0), len(torques)
    slides = np.abs(states[:-1, -1]) >= SLIPS
    assert slides[20] and not slides[-1]
    trial = Linearisation(arm, count).about(states[:-1], torques, np.tile([0.7, 0.0], (count, 1)), arm.row())
    assert (trial.transition[slides][:, :, -1] == 0).all() and np.abs(np.linalg.eigvals(trial.transition)).max() < 1.1
    push = np.where(np.arange(count) >= count - 20, 1e-4, 0.0)
    moved = simulated(arm, torques + push, 62.0)[-1] - states[-1]
    assert abs(moved[0]) > 3e-6
    np.testing.assert_allclose(moved, changes_of_state(trial, push)[-1], rtol=0.02, atol=1e-9)
    rests = np.array([[88 * 0.7, 0.0, 0.0, 0.0]]), np.array([0.01]), np.array([[0.7, 0.0]])
    assert (Linearisation(ArmParams(), 1).about(*rests, NOMINAL).by_torque == 0).all(), "it sticks without giving"


def test_the_first_repetition_is_the_papers_and_learning_alone_and_side_by_side_the_same():
    learnt = []
    for arms, seed in ((3, SEED), (1, SEED + 2)):
        controller = IterativeController()
        run, paper = (rollout(one, arms, seed=seed, randomization="ideal") for one in (controller, PaperController()))
        assert (run.torque == paper.torque).all()
        learnt.append(controller.following().feed_forward)
    assert (learnt[0][2] == learnt[1][0]).all() and (learnt[0] != 0).any()


def test_arms_that_leave_the_workspace_keep_what_they_knew():
    before = np.full((3, EPISODE_STEPS), [[1e-3], [10.0], [1e-3]])
    controller = IterativeController(before)
    assert rollout(controller, 3, seed=SEED, randomization="ideal").finished.tolist() == [True, False, True]
    learnt = cast(Any, controller.following().feed_forward)
    assert (learnt[1] == before[1]).all() and (learnt[0] != before[0]).any() and np.isfinite(learnt).all()
    refused(ValueError, ("2 arms", "3"), lambda: rollout(IterativeController(before[:2]), 3, seed=SEED))
    refused(ValueError, ("1200", "0"), IterativeController().following)


def test_constants_are_remembered_and_the_rest_begins_anew():
    """The first trial is that of `adaptive`, the second costs less. Of an arm that leaves nothing more is known."""
    first, settings = cast(Any, RememberingController()), {"seed": SEED, "randomization": "ideal"}
    refused(ValueError, ("trial",), first.following)
    run, adaptive = (rollout(one, 6, **settings) for one in (first, tuned_controller("adaptive")))
    assert (run.torque == adaptive.torque).all()
    second = first.following()
    assert rollout(second, 6, **settings).cost.mean() < 0.95 * run.cost.mean()
    refused(ValueError, ("6 arms", "3"), lambda: rollout(first.following(), 3, **settings))
    new, old, began = (belief.tracks for belief in (first._first, first._last, second._first))
    forgotten = [0, 1, 2, 3, GIVING, DISTURBANCE]
    lasting = np.setdiff1d(np.arange(SIZE), forgotten)
    assert all((a[:, forgotten] == b[:, forgotten]).all() for a, b in zip(began[:2], new[:2], strict=True))
    assert (began.mean[:, lasting] == old.mean[:, lasting]).all()
    assert (began.covariance[:, lasting][:, :, lasting] == old.covariance[:, lasting][:, :, lasting]).all()
    third, (observation, _) = second.following(), BeltArmVectorEnv(6, randomization="ideal").reset(seed=SEED)
    memory = third.predict(observation, third.predict(observation)[1])[1]
    third.predict(observation, memory, np.arange(6) == 1)
    kept, known = third.following().remembered.tracks.mean[:, lasting], third.remembered.tracks.mean[:, lasting]
    assert ((kept == known).all(axis=1) == (np.arange(6) == 1)).all()
