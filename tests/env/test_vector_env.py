import math
import os
import subprocess
import sys
from collections.abc import Iterator
from functools import cache, partial
from itertools import combinations
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.vector.utils import batch_space
from gymnasium.wrappers.vector import RecordEpisodeStatistics
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from properties import examples

from baselines import CONTROLLERS
from beltarm_env import EPISODE_STEPS, TRAIN_RANGES, ArmParams, BeltArmEnv, BeltArmVectorEnv
from beltarm_env.batch import TOTALS
from beltarm_env.observation import bounds, index
from beltarm_env.rollout import rollout
from beltarm_env.task.cost import MAX_COST

ROOT = Path(__file__).parents[2]
MODES = (AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP, AutoresetMode.DISABLED)
MOVE = {"start": 0.3, "goal": 1.2, "duration": 1.0, "ramp_time": 0.3}


def make(num_envs: int, **settings: Any) -> BeltArmVectorEnv:
    envs = gym.make_vec("BeltArm-v0", num_envs=num_envs, **settings).unwrapped
    assert isinstance(envs, BeltArmVectorEnv)
    return envs


def random_actions(steps: int, count: int, seed: int = 0) -> NDArray[np.float32]:
    """Torques held for 60 samples, none in the first arm, the strongest in the last, shape (steps, count, 1)."""
    levels = np.random.default_rng(seed).uniform(-1, 1, (-(-steps // 60), count, 1))
    levels *= np.linspace(0, 1, count)[:, None]
    return np.repeat(levels, 60, axis=0)[:steps].astype(np.float32)


# One arm of a batch is a single environment


CASES: dict[int, tuple[int, dict[str, Any]]] = {
    1: (1300, {"sensors": "full", "profile": "quintic", "randomization": "off"}),
    5: (2 * EPISODE_STEPS + 50, {"sensors": "tip", "profile": "scurve", "randomization": "train", "delay": 1}),
    6: (2000, {"randomization": "train", "max_episode_steps": 400}),
    70: (EPISODE_STEPS + 30, {"randomization": {"payload_mass": (0.1, 0.5)}, "encoder_counts": 1000}),
}
ASPECTS = ("observations", "rewards", "terminated", "truncated", "infos")


def pruned(info: dict[str, Any]) -> dict[str, Any]:
    """Without what holds for no environment: Gymnasium leaves such keys out."""
    return {name: value for name, value in info.items() if info[name if name[0] == "_" else f"_{name}"].any()}


def identical(one: Any, other: Any) -> bool:
    """Same types, keys, shapes and bits, all the way down."""
    if type(one) is not type(other):
        return False
    if isinstance(one, dict):
        one, other = pruned(one), pruned(other)
        return set(one) == set(other) and all(identical(one[name], other[name]) for name in one)
    if isinstance(one, np.ndarray) and one.dtype == object:
        return one.shape == other.shape and all(map(identical, one, other))
    if isinstance(one, np.ndarray):
        return (one.dtype, one.shape, one.tobytes()) == (other.dtype, other.shape, other.tobytes())
    return one is None


def play(envs: Any, actions: NDArray[np.float32], mode: AutoresetMode) -> Iterator[tuple[Any, ...]]:
    """What a vector environment returns, step by step; without autoreset, arms that ended are reset by mask."""
    observations, info = envs.reset(seed=11)
    yield observations, np.empty(0), np.empty(0), np.empty(0), info
    for action in actions:
        observations, rewards, terminated, truncated, info = envs.step(action)
        over = terminated | truncated
        if mode is AutoresetMode.DISABLED and over.any():
            observations, _ = envs.reset(options={"reset_mask": over})
        yield observations, rewards, terminated, truncated, info


def totals_at_ends(info: dict[str, Any], over: NDArray[np.bool_], mode: AutoresetMode) -> dict[str, Any]:
    """Leave of the totals, which single arms tell in every step, what a batch tells: those of episodes that end."""
    left = {name: values for name, values in info.items() if name.removeprefix("_") not in TOTALS}
    if not over.any() or mode is AutoresetMode.SAME_STEP:  # which has them in `final_info`
        return left
    totals = {name: np.where(over, info[name], 0.0) for name in TOTALS}
    return {**left, **totals, **{f"_{name}": over & info[f"_{name}"] for name in TOTALS}}


@cache
def comparison(count: int, mode: AutoresetMode) -> tuple[dict[str, list[int]], int, int]:
    """Steps at which a batch and Gymnasium's `SyncVectorEnv` of single arms differ, by aspect; ends of both kinds."""
    steps, case = CASES[count]
    actions = random_actions(steps, count)
    singles = SyncVectorEnv(
        [partial(gym.make, "BeltArm-v0", disable_env_checker=True, **case)] * count, autoreset_mode=mode
    )
    differing: dict[str, list[int]] = {aspect: [] for aspect in ASPECTS}
    left = finished = 0
    both = zip(play(make(count, autoreset_mode=mode, **case), actions, mode), play(singles, actions, mode), strict=True)
    for step, (ours, (*theirs, told)) in enumerate(both):
        over = theirs[2] | theirs[3] if step else np.zeros(count, np.bool_)
        theirs += [totals_at_ends(told, over, mode)]
        for aspect, one, other in zip(ASPECTS, ours, theirs, strict=True):
            if not identical(one, other):
                differing[aspect].append(step)
        left, finished = left + int(theirs[2].sum()), finished + int(theirs[3].sum())
    return differing, left, finished


@pytest.mark.parametrize("aspect", ASPECTS)
@pytest.mark.parametrize("mode", MODES, ids=lambda mode: mode.value)
@pytest.mark.parametrize("count", CASES)
def test_batch_is_bit_for_bit_as_many_single_environments(count: int, mode: AutoresetMode, aspect: str):
    differing, left, finished = comparison(count, mode)
    assert finished > 0 and (left > 0 or count == 1), "the actions should end episodes in both ways"
    assert differing[aspect] == []


@pytest.mark.parametrize("sensors", ["encoder", "tip", "accelerometer"])
def test_every_arm_has_its_own_delay(sensors: str):
    delays = [0, 0.25, 1, 1.5, 2]
    case: dict[str, Any] = {"sensors": sensors, "randomization": "train"}
    envs, singles = make(5, delay=delays, **case), [BeltArmEnv(delay=delay, **case) for delay in delays]
    start, _ = envs.reset(seed=20)
    assert np.array_equal(start, [single.reset(seed=20 + i)[0] for i, single in enumerate(singles)])
    for action in random_actions(120, 5):
        observations = [single.step(action[i])[0] for i, single in enumerate(singles)]
        assert envs.step(action)[0].tobytes() == np.array(observations).tobytes()


def test_delays_are_copied_and_outlast_the_episode():
    delays = np.array([0.0, 1.5])
    envs, single = make(2, delay=delays, autoreset_mode="SameStep"), BeltArmEnv(delay=1.5)
    delays[:] = 0.0
    envs.reset(seed=3)
    single.reset(seed=4)
    for k in range(EPISODE_STEPS + 100):
        action = np.array([0.3 * np.sin(0.05 * k)], np.float32)
        observation, _, _, over, _ = single.step(action)
        if over:
            observation, _ = single.reset()
        assert envs.step(np.stack([action, action]))[0][1].tobytes() == observation.tobytes()


@pytest.mark.parametrize("num_envs", [3, 64, 65])
def test_how_many_arms_there_are_makes_no_difference(num_envs: int):
    few, many = make(2, randomization="train"), make(num_envs, randomization="train")
    assert np.array_equal(few.reset(seed=4)[0], many.reset(seed=4)[0][:2])
    for action in random_actions(150, 2):
        everywhere = np.concatenate([action, np.full((num_envs - 2, 1), 0.7, np.float32)])
        assert np.array_equal(few.step(action)[0], many.step(everywhere)[0][:2])


@pytest.mark.parametrize("sensors", ["encoder", "tip", "full", "accelerometer"])
@pytest.mark.parametrize("profile", ["trapezoid", "scurve", "quintic"])
def test_every_tier_and_profile_agrees_with_single_arms(sensors: str, profile: str):
    case: dict[str, Any] = {"sensors": sensors, "profile": profile, "randomization": "train", "delay": 2}
    envs, singles = make(3, **case), [BeltArmEnv(**case) for _ in range(3)]
    start, _ = envs.reset(seed=20)
    assert np.array_equal(start, [single.reset(seed=20 + i)[0] for i, single in enumerate(singles)])
    for action in random_actions(120, 3):
        observations = [single.step(action[i])[0] for i, single in enumerate(singles)]
        assert np.array_equal(envs.step(action)[0], observations)


def test_accessors_agree_with_single_arms():
    envs, singles = make(3, randomization="train"), [BeltArmEnv(randomization="train") for _ in range(3)]
    envs.reset(seed=5)
    for i, single in enumerate(singles):
        single.reset(seed=5 + i)
    for action in random_actions(30, 3):
        envs.step(action)
        for i, single in enumerate(singles):
            single.step(action[i])
    assert envs.state.dtype == np.float64
    assert np.array_equal(envs.state, [single.state for single in singles])
    assert envs.params == [single.params for single in singles]
    assert np.array_equal(envs.moves, [list(single.move.values()) for single in singles])
    assert np.array_equal(envs.params_table, [[getattr(p, name) for name in p.__slots__] for p in envs.params])
    assert np.array_equal(np.transpose(envs.reference(0.2)), np.array([single.reference(0.2) for single in singles]))


def test_tip_errors_are_what_the_info_says():
    envs = make(4, randomization="train")
    envs.reset(seed=5)
    for action in random_actions(100, 4):
        info = envs.step(action)[4]
        errors = envs.tip_errors()
        assert np.hypot(errors[:, 0], errors[:, 1]) == pytest.approx(info["tip_error"], rel=1e-12, abs=1e-15)
        speed = np.hypot(errors[:, 2], errors[:, 3])
        assert np.minimum(speed / 0.2, 10) == pytest.approx(info["cost_velocity"], rel=1e-12, abs=1e-12)


# Reset: options, masks, seeds


def test_options_one_per_arm():
    envs = make(3, randomization="train")
    masses, goals = [0.0, 0.1, 0.4], [0.5, 0.9, 1.5]
    states = np.array([[10.0, 1.0, 0.01, 0.0], [50.0, 0.0, 0.0, 0.1], [80.0, 0.0, -0.01, 0.0]])
    options = {"params": {"payload_mass": masses, "hand_length": 0.2}, "move": {"goal": goals}, "state": states}
    observations, _ = envs.reset(seed=3, options=options)
    single = BeltArmEnv(randomization="train")
    for arm in range(3):
        own = {
            "params": {"payload_mass": masses[arm], "hand_length": 0.2},
            "move": {"goal": goals[arm]},
            "state": states[arm],
        }
        assert np.array_equal(observations[arm], single.reset(seed=3 + arm, options=own)[0])
        assert envs.params[arm] == single.params
        assert np.array_equal(envs.state[arm], single.state)
    assert set(options) == {"params", "move", "state"}


def test_one_option_for_all_arms():
    envs = make(3)
    envs.reset(seed=3, options={"params": {"payload_mass": 0.3}, "move": MOVE, "state": [30.0, 0.0, 0.01, 0.0]})
    assert envs.params == [ArmParams(payload_mass=0.3)] * 3
    assert np.array_equal(envs.moves, [list(MOVE.values())] * 3)
    assert np.array_equal(envs.state, [[30.0, 0.0, 0.01, 0.0]] * 3)


def test_options_do_not_disturb_the_random_streams():
    free, fixed = make(3, randomization="train"), make(3, randomization="train")
    free.reset(seed=6)
    fixed.reset(seed=6, options={"params": {"payload_mass": 0.1, "hand_length": 0.2}, "move": MOVE})
    assert np.array_equal(free.reset()[0], fixed.reset()[0])
    assert np.array_equal(free.params_table, fixed.params_table)


def test_reset_mask_resets_those_arms_alone():
    envs = make(4, autoreset_mode="Disabled")
    observations, _ = envs.reset(seed=0)
    for action in random_actions(50, 4):
        observations, *_ = envs.step(action)
    states, moves = envs.state, envs.moves
    mask = np.array([True, False, True, False])
    options = {"reset_mask": mask, "params": {"payload_mass": [0.1, 0.2]}}
    again, _ = envs.reset(options=options)
    assert np.array_equal(again[~mask], observations[~mask])
    assert np.array_equal(envs.state[~mask], states[~mask]) and np.array_equal(envs.moves[~mask], moves[~mask])
    assert (envs.moves[mask] != moves[mask]).any(axis=1).all()
    assert [arm.payload_mass for arm in envs.params] == [0.1, 0.0, 0.2, 0.0]
    assert options["reset_mask"] is mask and mask.tolist() == [True, False, True, False]


def test_reset_mask_with_a_seed_reseeds_those_arms_alone():
    masked, plain = make(3, autoreset_mode="Disabled"), make(3, autoreset_mode="Disabled")
    plain.reset(seed=0)
    masked.reset(seed=0)
    mask = np.array([False, True, False])
    observations, _ = masked.reset(seed=40, options={"reset_mask": mask})
    assert np.array_equal(observations[1], BeltArmEnv().reset(seed=41)[0])
    after, expected = masked.reset()[0], plain.reset()[0]
    assert np.array_equal(after[~mask], expected[~mask])
    assert not np.array_equal(after[1], expected[1])


def test_without_autoreset_an_ended_arm_must_be_reset():
    envs = make(3, autoreset_mode="Disabled")
    envs.reset(seed=0)
    over = np.zeros(3, np.bool_)
    while not over.any():
        _, _, terminated, truncated, _ = envs.step(np.array([[0], [1], [0]], np.float32))
        over = terminated | truncated
    assert over.tolist() == [False, True, False]
    with pytest.raises(ResetNeeded, match="arm 1"):
        envs.step(np.zeros((3, 1), np.float32))
    envs.reset(options={"reset_mask": over})
    assert not envs.step(np.zeros((3, 1), np.float32))[2].any()


def test_without_autoreset_every_ended_arm_must_be_reset():
    envs = make(3, autoreset_mode="Disabled")
    envs.reset(seed=0, options={"move": MOVE})
    over = np.zeros(3, np.bool_)
    while not over.any():
        over = envs.step(np.array([[0], [1], [1]], np.float32))[2]
    assert over.tolist() == [False, True, True]
    envs.reset(options={"reset_mask": np.array([False, True, False])})
    with pytest.raises(ResetNeeded, match="arm 2"):
        envs.step(np.zeros((3, 1), np.float32))


def test_seeds_one_per_arm():
    envs, single = make(3), BeltArmEnv()
    observations, _ = envs.reset(seed=[7, 3, 100])
    assert np.array_equal(observations, [single.reset(seed=seed)[0] for seed in (7, 3, 100)])


def test_arms_whose_seed_is_none_go_on_with_their_own_generators():
    envs, single = make(2), BeltArmEnv()
    envs.reset(seed=0)
    observations, _ = envs.reset(seed=[None, 9])
    single.reset(seed=0)
    assert np.array_equal(observations, [single.reset()[0], single.reset(seed=9)[0]])


def test_unseeded_arms_differ():
    starts = np.concatenate([make(4).reset()[0], make(4).reset()[0]])
    assert len(np.unique(starts, axis=0)) == 8


def test_training_ranges_are_drawn_for_each_arm():
    envs = make(200, randomization="train")
    envs.reset(seed=0)
    for column, name in enumerate(ArmParams.__slots__):
        drawn = envs.params_table[:, column]
        low, high = TRAIN_RANGES.get(name, (getattr(ArmParams(), name),) * 2)
        assert low <= drawn.min() <= low + 0.1 * (high - low)
        assert high - 0.1 * (high - low) <= drawn.max() <= high


# Gymnasium's rules


def test_spaces():
    envs, single = make(3, sensors="tip"), BeltArmEnv(sensors="tip")
    assert envs.single_observation_space == single.observation_space
    assert envs.single_action_space == single.action_space
    assert envs.observation_space == batch_space(single.observation_space, 3)
    assert envs.action_space == batch_space(single.action_space, 3)
    observations, info = envs.reset(seed=0)
    assert observations in envs.observation_space and info == {}
    for _ in range(50):
        observations, rewards, terminated, truncated, _ = envs.step(envs.action_space.sample())
        assert observations in envs.observation_space
        assert (rewards.dtype, terminated.dtype, truncated.dtype) == (np.float64, np.bool_, np.bool_)
        assert rewards.shape == terminated.shape == truncated.shape == (3,)


@pytest.mark.parametrize("mode", MODES, ids=lambda mode: mode.value)
def test_autoreset_mode_in_the_metadata(mode: AutoresetMode, monkeypatch: pytest.MonkeyPatch):
    # Gymnasium 1.2's own batches leave their mode in the class for later tests.
    monkeypatch.delitem(BeltArmEnv.metadata, "autoreset_mode", raising=False)
    envs, other = make(2, autoreset_mode=mode.value), make(2)
    assert envs.metadata["autoreset_mode"] is mode
    assert other.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert "autoreset_mode" not in BeltArmEnv.metadata
    assert (envs.num_envs, envs.render_mode) == (2, None)


def arrays(value: Any) -> Iterator[NDArray[Any]]:
    """All arrays in what a step returned."""
    if isinstance(value, np.ndarray):
        yield value
    children = value.values() if isinstance(value, dict) else value
    if not isinstance(value, np.ndarray) or value.dtype == object:
        for child in () if children is None else children:
            yield from arrays(child)


@pytest.mark.parametrize("mode", MODES[:2], ids=lambda mode: mode.value)
def test_nothing_returned_shares_memory(mode: AutoresetMode):
    envs = make(3, autoreset_mode=mode)
    returned: list[Any] = [envs.reset(seed=0)]
    actions = np.array([[0], [1], [-1]], np.float32)
    over = np.zeros(3, np.bool_)
    while not over.any():
        result = envs.step(actions)
        over = result[2] | result[3]
        returned = [*returned[-2:], result]
    returned += [envs.step(actions), envs.reset()]
    found = list(arrays(returned))
    assert len(found) > 30
    assert not [True for one, other in combinations(found, 2) if np.shares_memory(one, other)]
    assert len({id(item[-1]) for item in returned}) == len(returned)


def test_spoiling_what_was_returned_changes_nothing():
    spoiled, plain = make(3), make(3)
    spoiled.reset(seed=0)[0][:] = 7
    plain.reset(seed=0)
    for action in random_actions(20, 3):
        result, expected = spoiled.step(action), plain.step(action)
        assert all(identical(one, other) for one, other in zip(result, expected, strict=True))
        for array in (*arrays(result), spoiled.state, spoiled.moves, spoiled.params_table):
            array[:] = 1


def test_actions_are_left_as_they_were():
    envs, actions = make(2), np.array([[2.0], [-3.0]])
    envs.reset(seed=0)
    envs.step(actions)
    assert actions.tolist() == [[2.0], [-3.0]]


@pytest.mark.parametrize("limit", [0, -1, 1201, 2.5, True, "100"])
def test_episodes_are_no_longer_than_the_arm_s(limit: Any):
    with pytest.raises(ValueError, match=rf"max_episode_steps .*1200, got {limit!r}"):
        BeltArmVectorEnv(2, max_episode_steps=limit)


def test_a_rollout_wants_whole_episodes():
    with pytest.raises(ValueError, match="max_episode_steps=100"):
        rollout(CONTROLLERS["paper"](), 2, max_episode_steps=100)


def test_spec_makes_the_batch_again():
    settings: dict[str, Any] = {"sensors": "tip", "autoreset_mode": "SameStep", "max_episode_steps": 90}
    envs = gym.make_vec("beltarm_env:BeltArm-v0", num_envs=3, **settings)
    assert envs.spec is not None and envs.spec.max_episode_steps == 90
    again = gym.make_vec(envs.spec)
    assert again.num_envs == 3
    assert again.spec == envs.spec
    assert again.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert np.array_equal(again.reset(seed=1)[0], envs.reset(seed=1)[0])


@pytest.mark.parametrize("mode", MODES[:2], ids=lambda mode: mode.value)
def test_gymnasium_wrapper_counts_the_same_returns(mode: AutoresetMode):
    if mode is AutoresetMode.SAME_STEP and tuple(map(int, gym.__version__.split(".")[:2])) < (1, 4):
        pytest.skip("before 1.4, Gymnasium's wrapper takes each first step of an episode for a reset")
    envs = RecordEpisodeStatistics(make(3, autoreset_mode=mode))
    envs.reset(seed=0)
    episodes = 0
    for _ in range(EPISODE_STEPS + 10):
        *_, info = envs.step(np.array([[0], [1], [-1]], np.float32))
        if "episode" in info:
            told = info["final_info"] if mode is AutoresetMode.SAME_STEP else info
            ended = info["_episode"]
            assert -info["episode"]["r"][ended] == pytest.approx(told["total_cost"][ended], rel=1e-6)
            assert np.array_equal(info["episode"]["l"][ended], told["episode_steps"][ended])
            episodes += int(ended.sum())
    assert episodes > 3


def test_same_step_gives_the_last_and_the_first_observation():
    envs = make(3, autoreset_mode="SameStep", sensors="full")
    observations, info = envs.reset(seed=0)
    terminated = np.zeros(3, np.bool_)
    while not terminated.any():
        observations, _, terminated, _, info = envs.step(np.array([[0], [1], [0]], np.float32))
    elapsed = index("elapsed_time")
    final = info["final_obs"]
    assert (final[0], final[2]) == (None, None)
    assert final[1] in envs.single_observation_space and final[1][elapsed] > 0
    assert observations[1, elapsed] == 0
    assert observations[0, elapsed] == final[1][elapsed]


def test_closing_twice_does_no_harm():
    envs = make(2)
    envs.reset(seed=0)
    envs.close()
    envs.close()


# Whatever the arm, the move and the torque


def spread(low: float, high: float) -> st.SearchStrategy[float]:
    """Evenly spread over the orders of magnitude."""
    return st.floats(math.log(low), math.log(high)).map(math.exp)


ARMS = st.fixed_dictionaries(
    {
        "gear_ratio": spread(1, 1000),
        "link_length": spread(0.01, 2),
        "hand_length": st.just(0.0) | spread(0.01, 2),
        "motor_inertia": spread(1e-7, 1e-2),
        "motor_viscous_friction": st.just(0.0) | spread(1e-6, 1e-1),
        "coulomb_friction": st.just(0.0) | spread(1e-5, 1),
        "arm_inertia": spread(1e-4, 10),
        "arm_inertia_swing": st.just(0.0) | spread(1e-4, 10),
        "payload_mass": st.just(0.0) | spread(1e-3, 20),
        "belt_stiffness": spread(0.1, 1e6),
        "belt_damping_ratio": st.just(0.0) | spread(1e-4, 2),
        "torque_limit": spread(1e-3, 10),
        "current_loop_time_constant": st.just(0.0) | st.floats(0, 0.01),
        "command_latency": st.just(0.0) | st.floats(0, 0.0045),
        "torque_constant_error": st.floats(-0.5, 0.5),
        "static_friction_excess": st.just(0.0) | st.floats(0, 5),
        "stribeck_speed": spread(0.11, 900),
        "friction_variation": st.just(0.0) | st.floats(0, 0.9),
        "friction_variation_phase": st.floats(0, 6.28),
        "torque_ripple": st.just(0.0) | spread(1e-4, 1),
        "torque_ripple_order": st.integers(1, 100).map(float),
        "torque_ripple_phase": st.floats(0, 6.28),
        "kinematic_error": st.just(0.0) | spread(1e-6, 9e-3),
        "kinematic_error_phase": st.floats(0, 6.28),
        "belt_stiffening": st.just(0.0) | st.floats(0, 0.9),
        "belt_stiffening_torsion": spread(2e-4, 0.9),
        "friction_drift": st.floats(-0.5, 0.5),
    }
)
STATES = st.tuples(st.floats(0, 1.5), st.floats(-2000, 2000), st.floats(-1, 1), st.floats(-100, 100))
MOVES = st.just({}) | st.fixed_dictionaries(
    {"start": st.floats(0, 0.7), "goal": st.floats(1, math.pi / 2), "duration": st.floats(1, 1.5)}
)


@examples(200, shrink=False)
@given(
    arms=st.lists(ARMS, min_size=1, max_size=3),
    motion=st.none() | STATES,
    move=MOVES,
    torques=st.lists(st.floats(-3, 3), min_size=1, max_size=8),
    sensors=st.sampled_from(["encoder", "tip", "full", "accelerometer"]),
    delay=st.floats(0, 2),
    profile=st.sampled_from(["trapezoid", "scurve", "quintic"]),
    seed=st.integers(0, 2**31),
)
def test_never_a_nan_and_always_within_bounds(
    arms: list[dict[str, float]],
    motion: tuple[float, ...] | None,
    move: dict[str, float],
    torques: list[float],
    sensors: Any,
    delay: float,
    profile: Any,
    seed: int,
):
    envs = BeltArmVectorEnv(len(arms), sensors=sensors, delay=delay, profile=profile)
    columns = {name: [arm[name] for arm in arms] for name in ArmParams.__slots__}
    options: dict[str, Any] = {"params": columns, "move": move}
    if motion is not None:
        joint, *rest = motion
        options["state"] = [[joint * arm["gear_ratio"], *rest] for arm in arms]
    try:
        returned: list[tuple[Any, ...]] = [envs.reset(seed=seed, options=options)]
    except ValueError as error:
        assume("integrat" not in str(error) and "joint and arm angle within" not in str(error))
        raise
    returned += [envs.step(np.full((len(arms), 1), torque)) for torque in torques for _ in range(10)]
    observations = np.stack([result[0] for result in returned])
    rewards = np.stack([result[1] for result in returned[1:]])
    bound = bounds(sensors)
    assert (np.abs(observations) <= bound).all(), "beyond the bounds, or not a number"
    assert ((rewards <= 0) & (rewards >= -MAX_COST * EPISODE_STEPS)).all()
    assert all(np.isfinite(array.astype(np.float64)).all() for result in returned for array in result[-1].values())
    assert np.isfinite(envs.state).all()


WILD: list[dict[str, Any]] = [
    {
        "params": {
            "gear_ratio": 1.0,
            "link_length": 1.0,
            "motor_inertia": 0.0067,
            "arm_inertia": 0.05,
            "arm_inertia_swing": 0.0,
            "payload_mass": 1.0,
            "belt_stiffness": 1.0,
            "belt_damping_ratio": 1.0,
        },
        "state": [1.0, -86.0, 0.0, 0.0],
    },
    {
        "params": {
            "gear_ratio": 598.0,
            "link_length": 1.38,
            "motor_inertia": 4.68e-7,
            "motor_viscous_friction": 5.52e-6,
            "coulomb_friction": 0.0,
            "arm_inertia": 1.48e-4,
            "arm_inertia_swing": 1.64,
            "belt_stiffness": 31900.0,
            "belt_damping_ratio": 0.0,
            "torque_limit": 4.41,
        },
        "move": {"start": 0.8, "goal": 1.4},
    },
    {"state": [60.0, 0.0, 0.0, 1e5]},
    {"state": [60.0, 1e9, 0.0, 0.0]},
]


@pytest.mark.parametrize("options", WILD, ids=["heavy payload", "heavy swing, from rest", "fast torsion", "fast motor"])
def test_motion_too_wild_to_integrate_is_refused_or_ends_without_a_nan(options: dict[str, Any]):
    env = BeltArmEnv(sensors="full")
    try:
        observation, _ = env.reset(seed=0, options=options)
    except ValueError as error:
        assert "state" in str(error)
        return
    assert observation in env.observation_space
    over = False
    while not over:
        observation, reward, terminated, truncated, info = env.step(-np.ones(1, np.float32))
        over = terminated or truncated
        assert observation in env.observation_space
        assert -MAX_COST * EPISODE_STEPS <= reward <= 0
        assert np.isfinite([*info.values(), *env.state]).all()


@examples(30, shrink=False)
@given(torques=st.lists(st.floats(-3, 3), min_size=5, max_size=40), seed=st.integers(0, 2**31))
def test_batch_agrees_with_single_arms_for_any_torques(torques: list[float], seed: int):
    envs, single = make(2, randomization="train"), BeltArmEnv(randomization="train")
    envs.reset(seed=seed)
    single.reset(seed=seed + 1)
    for torque in np.repeat(torques, 8):
        observations, rewards, terminated, *_ = envs.step(np.array([[-torque], [torque]]))
        observation, reward, *_ = single.step(np.array([torque]))
        assert observations[1].tobytes() == observation.tobytes() and rewards[1] == reward
        if terminated.any():
            break


# Compiled or not


STICK_SLIP = """
import numpy as np
from beltarm_env import BeltArmEnv, BeltArmVectorEnv

torques = np.repeat([0.25, -0.3, 0.12, 0.0, 0.4], 10)[:, None]
single = BeltArmEnv(sensors="full", delay=1)
batch = BeltArmVectorEnv(3, sensors="tip", profile="scurve", randomization="train", delay=[0.0, 1.0, 1.4])
felt = BeltArmVectorEnv(2, sensors="accelerometer", randomization="train", delay=[0.0, 0.3])
options = {"move": {"start": 0.7, "goal": 1.4}, "params": {"belt_stiffness": 60.0}}
returned = [single.reset(seed=1, options=options)[0], batch.reset(seed=2)[0], felt.reset(seed=3)[0]]
speeds = []
for torque in torques:
    observation, reward, *_ = single.step(torque)
    observations, rewards, *_ = batch.step(torque * [[1.0], [0.7], [-1.0]])
    returned += [observation, np.array(reward), observations, rewards, batch.tip_errors()]
    returned.append(felt.step(torque * [[1.0], [-0.5]])[0])
    speeds.append(single.state[1])
"""


def without_compiler(code: str, folder: Path) -> None:
    """Run code in a process where kernels are plain Python, warnings being errors."""
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)}
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], cwd=folder, env=environment, capture_output=True, text=True
    )
    assert result.returncode == 0, result.stderr


def test_without_compiler_the_very_same_numbers(tmp_path: Path):
    compiled: dict[str, Any] = {}
    exec(STICK_SLIP, compiled)
    speeds = np.array(compiled["speeds"])
    assert (speeds == 0).any() and (speeds > 1).any() and (speeds < -1).any(), (
        "the motor should stick, slip and reverse"
    )

    check = "import beltarm_env.kernels.step as k; assert not hasattr(k.step_arm, 'py_func')"
    without_compiler(f"{STICK_SLIP}\nnp.savez('plain.npz', *returned); {check}", tmp_path)
    with np.load(tmp_path / "plain.npz") as plain:
        assert len(plain.files) == len(compiled["returned"])
        for name, array in zip(plain.files, compiled["returned"], strict=True):
            assert plain[name].tobytes() == array.tobytes()


CHECK = """
import gymnasium, numpy, beltarm_env
from gymnasium.utils.env_checker import check_env

env = gymnasium.make("BeltArm-v0").unwrapped
check_env(env, skip_render_check=True)
env = gymnasium.make("BeltArm-v0").unwrapped
env.reset(seed=0)
for action in numpy.ones((1200, 1)):
    _, reward, terminated, truncated, info = env.step(action)
    assert [type(value) for value in (reward, terminated, truncated)] == [float, bool, bool], "types"
    assert {type(value) for value in info.values()} == {float}, "types in info"
    if terminated:
        break
"""


def test_without_compiler_the_very_same_types(tmp_path: Path):
    without_compiler(CHECK, tmp_path)
