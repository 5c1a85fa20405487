"""The simulated arm behind its drive against the event-located solution, and through the environment."""

import math
from typing import Any

import numpy as np
import pytest
from driven_arms import (
    GEAR,
    MODELS,
    UPPER_ENDS,
    apply,
    arm_env,
    at_rest,
    drawn_arms,
    largest_distance,
    pushed,
    stops,
    swing,
)

from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS, TRAIN_RANGES, ArmParams, BeltArmEnv, design_model
from beltarm_env.arm import DRIVE_EFFECTS
from beltarm_env.observation import decode
from eval.reference.event_located import EventLocatedArm, tip
from eval.studies.physics import measure_convergence

ARMS = drawn_arms(8, seed=5)
AT_45 = at_rest(math.pi / 4, 0.02)
TWO_PERIODS = 800  # samples of the slower wave of `push`: 1.2 s, in which every arm stops four times
EACH_MODEL = pytest.mark.parametrize("model", MODELS)


def jolted(sample: int, _: EventLocatedArm) -> float:
    """Give a command [N m] that jumps in every sample, within a third of the torque limit."""
    return 0.1 * math.sin(7.0 * sample * sample)


@pytest.mark.parametrize("effect", [*DRIVE_EFFECTS])
def test_each_effect_alone(effect: str):
    params = {effect: UPPER_ENDS[effect]}
    for phase in ("friction_variation_phase", "torque_ripple_phase", "kinematic_error_phase"):
        params[phase] = 0.7
    worst, arm = largest_distance(params, AT_45, pushed, "lumped", 500)
    assert stops(arm) >= 2
    assert worst < 1e-6


@EACH_MODEL
@pytest.mark.parametrize("number", [0, 1, *(pytest.param(k, marks=pytest.mark.slow) for k in range(2, len(ARMS)))])
def test_stick_slip_with_all_effects(number: int, model: str):
    worst, arm = largest_distance(ARMS[number], AT_45, pushed, model, TWO_PERIODS)
    assert stops(arm) >= 4
    assert worst < 1e-6


@EACH_MODEL
@pytest.mark.parametrize("params", [{}, {"torque_ripple": 0.006, "torque_ripple_order": 12}, UPPER_ENDS], ids=len)
def test_a_coasting_motor_stops_in_its_sample_at_its_angle(params: dict[str, Any], model: str):
    start = np.array([0.5 * GEAR, 60.0, 0.0, 60.0 / GEAR])
    env = arm_env(params, start, model)
    arm = EventLocatedArm(env.params, start, model)
    while arm.mode != "stuck":
        assert env.state[1] > 0 or arm.samples == 0
        apply(env, 0.0)
        arm.sample(0.0)
        assert env.state[0] == pytest.approx(arm.state[0], abs=5e-7)
    assert env.state[1] == 0 and arm.samples > 40


@pytest.mark.slow
@pytest.mark.parametrize(("number", "model"), [(4, "lagrangian"), (9, "lumped")])
def test_what_fast_arms_are_off_by_is_the_error_of_the_step(number: int, model: str):
    """Of 60 arms, these are off by most but for a sensitive one: docs/science/physics.md has the numbers."""
    params = drawn_arms(60, seed=78)[number]
    once, twice = (largest_distance(params, at_rest(0.2), swing, model, 1000, steps)[0] for steps in (1, 2))
    assert twice < 0.1 * once < 0.3e-6


@pytest.mark.parametrize(("number", "model"), [(0, "lumped"), (1, "lumped"), (1, "lagrangian")])
def test_breaking_away_while_the_torque_still_rises(number: int, model: str):
    worst, arm = largest_distance(ARMS[number], AT_45, jolted, model, 300)
    assert stops(arm) >= 20
    assert worst < 1e-6


@pytest.mark.parametrize(("order", "model"), [(4, "lumped"), (12, "lumped"), (12, "lagrangian")])
def test_fast_move_with_all_effects(order: int, model: str):
    # Nearly 400 rad/s of the motor, as in the benchmark's moves. At 350 rad/s a ripple of 12 per turn has one period
    # per sample, which one step per sample would take for a constant torque.
    worst, arm = largest_distance({**ARMS[0], "torque_ripple_order": order}, at_rest(0.2), swing, model)
    assert arm.mode == "stuck"
    assert worst < 1e-6


@pytest.mark.parametrize(
    ("lag", "latency", "model"),
    [
        *((0.0, 0.3, "lumped"), (0.0, 2.7, "lagrangian"), (0.0002, 0.0, "lumped"), (0.0002, 2.7, "lumped")),
        *((0.0002, 2.7, "lagrangian"), (0.01, 1.0, "lagrangian"), (0.01, 3.0, "lumped"), (0.01, 0.3, "lumped")),
    ],
)
def test_latency_and_lag(lag: float, latency: float, model: str):
    params = {**ARMS[1], "command_latency": latency * 0.0015, "current_loop_time_constant": lag}
    assert largest_distance(params, AT_45, pushed, model, 300)[0] < 1e-6


@pytest.mark.parametrize("lag", [5e-324, 1e-21, 1e-15, 1e-9, 9e-8, 1e-7, 1e-6])
def test_the_fastest_current_loops_are_as_good_as_none(lag: float):
    """The event-located solution with lags that it can resolve, and without one for those that it cannot."""
    params = {**ARMS[1], "command_latency": 0.00045, "current_loop_time_constant": lag}
    env, resolved = arm_env(params, AT_45), {**params, "current_loop_time_constant": lag if lag > 5e-8 else 0.0}
    arm = EventLocatedArm(ArmParams(**resolved), AT_45)
    for k in range(150):
        torque = pushed(k, arm)
        env.step(np.array([torque / arm.params.torque_limit]))
        arm.sample(torque)
        assert np.linalg.norm(tip(arm.params, env.state) - tip(arm.params, arm.state)) < 5e-7


def driven_path(params: dict[str, Any], samples: int = 200) -> np.ndarray:
    """Tips under a wave of torque, shape (samples, 2)."""
    env, tips = arm_env(params, AT_45), []
    for k in range(samples):
        env.step(np.array([0.3 * math.sin(0.02 * k)]))
        tips.append(tip(env.params, env.state))
    return np.array(tips)


@pytest.mark.parametrize("name", [name for name in DRIVE_EFFECTS if name != "current_loop_time_constant"])
def test_the_smallest_effects_are_as_good_as_none_and_the_largest_are_not(name: str):
    without = driven_path({**ARMS[1], name: 0.0})
    for size in (5e-324, 1e-100, 1e-20, 1e-15):
        assert np.abs(driven_path({**ARMS[1], name: size}) - without).max() < 1e-8
    assert np.abs(driven_path(ARMS[1]) - without).max() > 1e-6


@EACH_MODEL
def test_fourth_order(model: str):
    result = measure_convergence(model, "drive", 800)
    assert result.stops >= 2
    assert math.log2(result.errors[1] / result.errors[3]) / 2 == pytest.approx(4.0, abs=0.4)


@pytest.mark.parametrize(("number", "model"), [(0, "lumped"), (1, "lagrangian"), (3, "lumped")])
def test_energy_is_never_created(number: int, model: str):
    energies = energies_of_free_motion(ArmParams(**ARMS[number]), 60.0, model, EPISODE_STEPS)
    created = energies - np.minimum.accumulate(energies)
    assert created.max() < 1e-5 * np.ptp(energies)
    assert np.ptp(energies) > 0.05


def energies_of_free_motion(params: ArmParams, speed: float, model: str, samples: int) -> np.ndarray:
    """Energy [J] at the samples of an arm without commands, shape (samples + 1,)."""
    start = np.array([GEAR * 0.5, speed, 0.06, -1.0])
    env = arm_env({name: getattr(params, name) for name in params.__slots__}, start, model)
    energies = [EventLocatedArm(params, start, model).energy]
    for _ in range(samples):
        assert not env.step(np.zeros(1, np.float32))[2]
        energies.append(EventLocatedArm(params, env.state, model).energy)
    return np.array(energies)


# Through the environment


def test_an_episode_is_the_same_whatever_drives_the_arms_before_had():
    used = BeltArmEnv()
    for params in ({}, UPPER_ENDS, {}, UPPER_ENDS):
        new = BeltArmEnv()
        for env in (used, new):
            env.reset(seed=1, options={"params": params})
            for k in range(40):
                env.step(np.array([0.35 * math.sin(0.1 * k)]))
        assert used.state.tolist() == new.state.tolist() and used.motor_torque == new.motor_torque


def test_torque_follows_the_command_late_and_lagging():
    lag, latency, constant = 0.0008, 1.3 * CONTROL_PERIOD, 0.06
    drive = {"current_loop_time_constant": lag, "command_latency": latency, "torque_constant_error": constant}
    env = BeltArmEnv()
    env.reset(seed=0, options={"params": drive})
    for k in range(1, 8):
        observation = env.step(np.array([0.5], np.float32))[0]
        since = max(k * CONTROL_PERIOD - latency, 0.0)
        expected = 0.5 * 0.3 * (1 + constant) * (1 - math.exp(-since / lag))
        assert env.motor_torque == pytest.approx(expected, rel=1e-9, abs=1e-15)
        assert decode(observation)["last_command"] == 0.5, "the command and not the torque"


def test_design_model_is_the_middle_of_the_training_ranges():
    design = design_model()
    for name, (low, high) in TRAIN_RANGES.items():
        unknown_phase = name in ("friction_variation", "torque_ripple", "kinematic_error") or name.endswith("_phase")
        assert getattr(design, name) == (0.0 if unknown_phase else pytest.approx(0.5 * (low + high)))
