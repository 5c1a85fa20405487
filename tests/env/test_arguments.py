"""Specs and arguments of the environments: what they tell, what JSON can hold, and what cannot be set."""

import copy
import inspect
import pickle
from functools import partial
from importlib.util import find_spec
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import TimeAwareObservation
from numpy.typing import NDArray
from sb3_contrib.common.wrappers import TimeFeatureWrapper
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from beltarm_env import EPISODE_STEPS, BeltArmEnv, BeltArmVectorEnv

STILL = np.zeros(1, np.float32)


def torques(steps: int) -> NDArray[np.float32]:
    return np.random.default_rng(0).uniform(-0.3, 0.3, (steps, 1)).astype(np.float32)


def play(env: gym.Env[Any, Any], actions: NDArray[np.float32], seed: int) -> list[tuple[Any, ...]]:
    """Everything that an episode returns after its reset, observations as bytes."""
    env.reset(seed=seed)
    record: list[tuple[Any, ...]] = []
    for action in actions:
        observation, *rest = env.step(action)
        record.append((observation.tobytes(), *rest))
        if rest[1] or rest[2]:
            break
    return record


IDS = ["BeltArm-v0", *(["BeltArmMuJoCo-v0"] if find_spec("mujoco") else [])]


@pytest.mark.parametrize("name", IDS)
def test_specs_tell_the_number_of_steps(name: str):
    specs = [
        gym.spec(name),
        gym.make(name).spec,
        gym.make_vec(name, num_envs=2).spec,
        gym.make_vec(name, num_envs=2, vectorization_mode="sync").spec,
    ]
    for spec in specs:
        assert spec is not None
        assert EnvSpec.from_json(spec.to_json()).max_episode_steps == EPISODE_STEPS


def test_wrappers_that_count_steps_stay_within_their_spaces():
    for wrapper in (TimeAwareObservation, TimeFeatureWrapper):
        env = wrapper(gym.make("BeltArm-v0"))
        observation: Any = env.reset(seed=0)[0]
        over, times = False, []
        while not over:
            assert observation in env.observation_space
            observation, _, _, over, _ = env.step(STILL)
            times.append(float(observation[-1]))
        assert observation in env.observation_space
        assert len(times) == EPISODE_STEPS and len(np.unique(times)) == EPISODE_STEPS


def test_totals_are_told_whoever_ends_the_episode():
    env = Monitor(gym.make("BeltArm-v0", max_episode_steps=100), info_keywords=("total_cost", "episode_steps"))
    for _ in range(2):
        *_, (_, _, terminated, truncated, info) = play(env, torques(200), seed=1)
        assert truncated and not terminated
        assert info["episode"]["episode_steps"] == info["episode"]["l"] == 100
        assert info["episode"]["total_cost"] == pytest.approx(-info["episode"]["r"], abs=1e-5)


NUMPY_SETTINGS: list[dict[str, Any]] = [
    {"randomization": {"payload_mass": (np.float64(0.1), np.float32(0.5)), "torque_ripple_order": np.array([4, 8])}},
    {"sensors": np.str_("tip"), "profile": np.str_("scurve"), "model": np.str_("lagrangian")},
    {"encoder_counts": np.int64(1000), "delay": np.float32(0.5), "randomization": np.str_("train")},
    {"delay": np.array(1), "render_mode": np.str_("rgb_array")},
]
FOR_MANY: list[dict[str, Any]] = [
    {"delay": np.array([0.0, 1.5])},
    {"num_threads": np.int64(2), "autoreset_mode": AutoresetMode.SAME_STEP, "max_episode_steps": np.int64(100)},
]


@pytest.mark.parametrize("settings", NUMPY_SETTINGS, ids=str)
def test_specs_of_arguments_as_numpy_has_them_go_through_json(settings: dict[str, Any]):
    env = gym.make("BeltArm-v0", **settings)
    assert env.spec is not None
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert play(again, torques(20), seed=3) == play(env, torques(20), seed=3)
    for name in settings:
        assert again.get_wrapper_attr(name) == env.get_wrapper_attr(name)


@pytest.mark.parametrize("settings", NUMPY_SETTINGS + FOR_MANY, ids=str)
def test_specs_of_batches_go_through_json(settings: dict[str, Any]):
    envs = gym.make_vec("BeltArm-v0", num_envs=np.int64(2), **settings)  # pyright: ignore[reportArgumentType]
    assert envs.spec is not None
    again = gym.make_vec(EnvSpec.from_json(envs.spec.to_json()))
    assert np.array_equal(again.reset(seed=1)[0], envs.reset(seed=1)[0])
    for name in (*settings, "num_envs"):
        assert getattr(again.unwrapped, name) == getattr(envs.unwrapped, name)


ARGUMENTS = {
    "sensors": "full",
    "profile": "scurve",
    "model": "lagrangian",
    "randomization": "train",
    "encoder_counts": 100,
    "delay": 1,
    "render_mode": "rgb_array",
}
OF_BATCHES = {**ARGUMENTS, "num_envs": 3, "num_threads": 2, "autoreset_mode": "SameStep", "max_episode_steps": 7}


def test_arguments_are_those_of_the_constructor():
    for kind, names in ((BeltArmEnv, ARGUMENTS), (BeltArmVectorEnv, OF_BATCHES)):
        assert {*inspect.signature(kind).parameters} == {*names}


@pytest.mark.parametrize("name", OF_BATCHES)
def test_what_is_fixed_at_construction_refuses_to_be_set(name: str):
    value, kinds = OF_BATCHES[name], [BeltArmVectorEnv] + [BeltArmEnv] * (name in ARGUMENTS)
    for env in (kind() for kind in kinds):
        before = getattr(env, name)
        with pytest.raises(AttributeError, match=rf"{name} .*make a new one") as told:
            setattr(env, name, value)
        assert "\n" not in str(told.value)
        assert getattr(env, name) == before
        assert getattr(type(env)(**{name: value}), name) in (value, AutoresetMode.SAME_STEP)


@pytest.mark.parametrize("name", ARGUMENTS)
def test_vector_environments_refuse_to_set_what_is_fixed(name: str):
    several = [
        SyncVectorEnv([partial(gym.make, "BeltArm-v0")]),
        DummyVecEnv([BeltArmEnv]),  # with a wrapper, Stable-Baselines3 sets an attribute of that
    ]
    for envs in several:
        with pytest.raises(AttributeError, match=name):
            envs.set_attr(name, ARGUMENTS[name])


def test_ranges_that_were_given_or_read_are_not_the_environment_s():
    given: dict[str, Any] = {"payload_mass": (0.1, 0.2)}
    env = BeltArmEnv(randomization=given)
    given["payload_mass"] = env.randomization["payload_mass"] = (0.5, 0.6)
    assert env.randomization == {"payload_mass": (0.1, 0.2)}


@pytest.mark.parametrize("through", [copy.copy, copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_copies_have_the_arguments(through: Any):
    for env in (BeltArmEnv(sensors="tip", delay=1), BeltArmVectorEnv(2, delay=[0, 1], autoreset_mode="SameStep")):
        env.reset(seed=0)
        again = through(env)
        assert [getattr(again, name) for name in ARGUMENTS] == [getattr(env, name) for name in ARGUMENTS]
        with pytest.raises(AttributeError):
            again.sensors = "full"
