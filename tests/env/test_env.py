"""The environment of one arm: Gymnasium's rules, episodes, options, reward, observation, and arguments."""

import copy
import inspect
import math
import pickle
from functools import partial
from importlib.util import find_spec
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from episodes import play, torques
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env as gymnasium_check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import PassiveEnvChecker, TimeLimit
from stable_baselines3.common.env_checker import check_env as sb3_check_env

from beltarm_env import EPISODE_STEPS, ArmParams, BeltArmEnv, BeltArmVectorEnv
from beltarm_env.info import MOVE_TOTALS
from beltarm_env.kernels import layout
from beltarm_env.observation import ENTRIES, LOOKAHEADS, decode
from beltarm_env.task.cost import MAX_COST
from eval.reference.event_located import tip

PROFILES = ("trapezoid", "scurve", "quintic")
TERMS = ("cost_position", "cost_velocity", "cost_torque_rate")
TOTALS = {"total_cost", *(f"total_{term}" for term in TERMS), "episode_steps", "tip_error_rms", "tip_error_max"}
INFO = {"tip_error", *TERMS, *TOTALS}
STILL, OUTWARD = np.zeros(1, np.float32), np.ones(1, np.float32)
LONG_MOVE = {"start": 0.1, "goal": 1.4, "duration": 1.1, "ramp_time": 0.3}


def make(**settings: Any) -> BeltArmEnv:
    env = gym.make("BeltArm-v0", **settings).unwrapped
    assert isinstance(env, BeltArmEnv)
    return env


class TestGymnasium:
    @pytest.mark.parametrize("settings", [{}, {"sensors": "full", "profile": "scurve"}, {"sensors": "accelerometer"}])
    def test_both_checkers_are_content(self, settings: dict[str, Any]):
        gymnasium_check_env(make(moves=2, **settings), skip_render_check=True)
        sb3_check_env(make(moves=2, **settings), warn=True, skip_render_check=True)

    def test_no_wrapper_is_in_the_way_of_a_step_unless_asked_for(self):
        bare, limited = gym.make("beltarm_env:BeltArm-v0"), gym.make("BeltArm-v0", max_episode_steps=7)
        assert bare is bare.unwrapped and isinstance(bare, BeltArmEnv)
        assert isinstance(limited, TimeLimit) and limited.env is limited.unwrapped
        assert isinstance(gym.make("BeltArm-v0", disable_env_checker=False), PassiveEnvChecker)
        for each in (bare, limited):
            each.reset(seed=0)
            each.close()
            each.close()

    def test_data_that_was_returned_is_the_callers(self):
        expected = play(make(), torques(30), seed=4)
        env = make()
        observation, info = env.reset(seed=4)
        for action, (observation_bytes, reward, *_) in zip(torques(30), expected[1:], strict=True):
            observation[:], info["tip_error"] = 7.0, 7.0
            env.state[:] = 7.0
            kept = env.state
            before = kept.copy()
            observation, step_reward, _, _, info = env.step(action)
            assert (observation.tobytes(), step_reward) == (observation_bytes, reward)
            assert kept.dtype == np.float64 and np.array_equal(kept, before) and not np.array_equal(kept, env.state)


class TestBeginningAndEnd:
    def test_truncates_at_exactly_1200_steps(self):
        env = make()
        observation, info = env.reset(seed=0)
        assert info == {}
        for k in range(EPISODE_STEPS):
            observation, reward, terminated, truncated, info = env.step(STILL)
            assert (terminated, truncated) == (False, k == 1199)
            assert (type(observation), observation.dtype) == (np.ndarray, np.float32)
            assert [type(value) for value in (reward, terminated, truncated)] == [float, bool, bool]
            assert {type(value) for value in info.values()} == {float}
            assert set(info) == (INFO | {*MOVE_TOTALS} if truncated else INFO)
        assert env.time == pytest.approx(1.8)

    def test_a_time_limit_ends_the_episode_that_the_arm_ends_itself(self):
        """Also where the arm leaves its workspace with the last step: Gymnasium's TimeLimit calls that both."""
        for env in (make(), gym.make("BeltArm-v0", max_episode_steps=EPISODE_STEPS)):
            env.reset(seed=0, options={"move": {"goal": 1.5}})
            for _ in range(EPISODE_STEPS - 1):
                assert not any(env.step(STILL)[2:4])
            arm: Any = env.unwrapped
            arm._batch.blocks[0, layout.STATE] = 200.0  # far outside
            assert env.step(STILL)[2:4] == (True, True)

    @pytest.mark.parametrize(("direction", "moves", "rest"), [(-1.0, 1, 0), (1.0, 1, 0), (1.0, 3, 1300)])
    def test_leaving_the_workspace_ends_it_and_is_charged_for_steps_left(self, direction: int, moves: int, rest: int):
        env, terminated, steps, total = make(randomization="train", moves=moves), False, 0, 0.0
        _, info = env.reset(seed=3)
        while not terminated:
            action = np.array([direction * (steps >= rest)], np.float32)
            _, reward, terminated, truncated, info = env.step(action)
            joint, steps, total = env.state[0] / env.params.gear_ratio, steps + 1, total - float(reward)
            ends = joint, joint - env.state[2]
            assert terminated == (min(ends) < -0.25 or max(ends) > np.pi / 2 + 0.25) and not truncated
            charge = MAX_COST * (moves * EPISODE_STEPS - steps) * terminated
            assert reward == pytest.approx(-sum(info[term] for term in TERMS) - charge, rel=1e-12)
        assert rest + 50 < steps < rest + 1000 and info["episode_steps"] == steps and "move_cost" not in info
        assert env.move_number == moves // 2 and info["total_cost"] == pytest.approx(total, rel=1e-12)


def test_same_seed_gives_the_same_episodes():
    first, second = (make(randomization="train") for _ in range(2))
    actions = torques(EPISODE_STEPS, hold=15)
    for seed in (5, None, 5):
        assert play(first, actions, seed=seed) == play(second, actions, seed=seed)
    starts = [first.reset(seed=seed)[0] for seed in (*range(5), *[None] * 5)]
    assert len({start.tobytes() for start in starts}) == 10


OPTIONS = [
    {"params": {"belt_stiffness": 20.0, "hand_length": 0.2, "torque_limit": 0.5}},
    {"move": {"duration": 1.3}},
    {"move": {"start": 1.5, "goal": 0.3, "ramp_time": 0.25}},
    {"state": [30.0, 5.0, 0.01, -0.2]},
    {"params": {"coulomb_friction": 0.0}, "move": LONG_MOVE, "state": np.array([60.0, 0.0, 0.0, 0.0])},
]


class TestOptions:
    @pytest.mark.parametrize("options", OPTIONS, ids=str)
    def test_fix_what_they_name_and_do_not_disturb_the_random_stream(self, options: dict[str, Any]):
        free, env = (make(randomization="train") for _ in range(2))
        before = copy.deepcopy(options)
        for seed in range(3):
            free.reset(seed=seed)
            env.reset(seed=seed, options=options)
            for name in ArmParams.__slots__:
                assert getattr(env.params, name) == options.get("params", {}).get(name, getattr(free.params, name))
            assert env.move.items() >= options.get("move", {}).items()
            start = env.move["start"] * env.params.gear_ratio  # the belt is at rest, and takes up the kinematic error
            taken_up = env.params.kinematic_error * math.sin(2 * start + env.params.kinematic_error_phase)
            state = list(options.get("state", [start, 0.0, -taken_up, 0.0]))
            assert env.state.tolist() == pytest.approx(state, rel=1e-12, abs=1e-15)
            assert free.reset()[0].tobytes() == env.reset()[0].tobytes()
            assert free.params == env.params and free.move == env.move, "options are not remembered"
        assert str(options) == str(before)


def expected_cost(env: BeltArmEnv, torque: float, last_torque: float) -> dict[str, float]:
    """The design's formula on the tip from plane geometry, its velocity by a central difference; torques over limit."""
    params, state, reference = env.params, env.state, env.reference(env.time)
    step = 1e-5 * np.array([state[1], 0.0, state[3], 0.0])
    velocity = (tip(params, state + step) - tip(params, state - step)) / 2e-5
    reach = 2 * params.link_length * np.cos(reference.angle) + params.hand_length
    reach_speed = -2 * params.link_length * np.sin(reference.angle) * reference.speed
    error = float(np.linalg.norm(tip(params, state) - [reach, 0]))
    velocity_error = float(np.linalg.norm(velocity - [reach_speed, 0]))
    return {
        "tip_error": error,
        "cost_position": min(error / 0.010, 10.0),
        "cost_velocity": min(velocity_error / 0.200, 10.0),
        "cost_torque_rate": 0.1 * abs(torque - last_torque),
    }


class TestReward:
    @pytest.mark.parametrize("profile", PROFILES)
    def test_is_the_documented_cost(self, profile: str):
        env = make(profile=profile, randomization="train")
        env.reset(seed=1, options={"params": {"hand_length": 0.17, "link_length": 0.3}})
        last, largest = 0.0, 0.0
        for action in 1.3 * torques(EPISODE_STEPS, 3, hold=25):
            torque = float(np.clip(action[0], -1, 1))
            _, reward, terminated, truncated, info = env.step(action)
            if terminated or truncated:
                break
            expected = expected_cost(env, torque, last)
            assert {name: info[name] for name in expected} == pytest.approx(expected, abs=1e-6)
            assert reward == -(info["cost_position"] + info["cost_velocity"] + info["cost_torque_rate"])
            assert -MAX_COST <= reward <= 0
            last, largest = torque, max(largest, info["tip_error"])
        assert largest > 0.1, "the position term should have saturated"

    @pytest.mark.parametrize("hold", [5, 200], ids=["truncated", "terminated"])
    def test_totals_are_the_sums_of_each_episode(self, hold: int):
        env, actions = make(), 1.5 * torques(EPISODE_STEPS, 1, hold)
        record = play(env, actions, seed=1)
        assert play(env, actions, seed=1) == record, "they begin anew"
        assert record[-1][2] == (hold == 200)
        infos = [step[-1] for step in record[1:]]
        for k in (0, 60, len(infos) - 1):
            info, errors = infos[k], np.array([info["tip_error"] for info in infos[: k + 1]])
            for term in TERMS:
                assert info[f"total_{term}"] == pytest.approx(sum(info[term] for info in infos[: k + 1]), rel=1e-12)
            assert info["total_cost"] == pytest.approx(-sum(step[1] for step in record[1 : k + 2]), rel=1e-12)
            assert info["tip_error_max"] == errors.max() and info["episode_steps"] == k + 1
            assert info["tip_error_rms"] == pytest.approx(np.sqrt(np.mean(errors**2)), rel=1e-12)


class TestObservation:
    @pytest.mark.parametrize("profile", PROFILES)
    def test_decodes_to_what_the_accessors_say(self, profile: str):
        env = make(profile=profile, randomization="train")
        observation, _ = env.reset(seed=7)
        last = 0.0
        for action in torques(600, 2, hold=9):
            seen, now = decode(observation), env.reference(env.time)
            expected = {f"reference_{name}": value for name, value in now._asdict().items()}
            for ahead in LOOKAHEADS:
                then = env.reference(env.time + ahead)
                expected[f"reference_speed_ahead_{1000 * ahead:.0f}ms"] = then.speed
                expected[f"reference_acceleration_ahead_{1000 * ahead:.0f}ms"] = then.acceleration
            expected |= {**env.move, "elapsed_time": env.time, "last_command": last, "holds_part": 1.0}
            assert {name: seen[name] for name in expected} == pytest.approx(expected, rel=3e-7, abs=1e-7)  # float32
            observation, _, terminated, truncated, _ = env.step(2 * action)
            last = float(np.clip(2 * action[0], -1, 1))
            if terminated or truncated:
                break
        assert env.time > 0.3, "the arm left before the reference had changed much"

    def test_tiers_differ_only_by_what_they_add(self):
        plain, *more = [make(sensors=sensors, randomization="train") for sensors in ENTRIES]
        seen = [env.reset(seed=1)[0] for env in (plain, *more)]
        for action in torques(200):
            assert all(np.array_equal(other[: len(seen[0])], seen[0]) for other in seen[1:])
            seen = [env.step(action)[0] for env in (plain, *more)]


ARGUMENTS = {
    **{"sensors": "full", "profile": "scurve", "model": "lagrangian", "randomization": "train"},
    **{"encoder_counts": 100, "delay": 1, "moves": 3, "render_mode": "rgb_array"},
}
BATCH_ARGUMENTS = {**ARGUMENTS, "num_envs": 3, "num_threads": 2, "autoreset_mode": "SameStep", "max_episode_steps": 7}
NUMPY_SETTINGS: list[dict[str, Any]] = [
    {"randomization": {"payload_mass": (np.float64(0.1), np.float32(0.5)), "torque_ripple_order": np.array([4, 8])}},
    {"sensors": np.str_("tip"), "profile": np.str_("scurve"), "model": np.str_("lagrangian"), "delay": np.array(1)},
    {"encoder_counts": np.int64(1000), "delay": np.float32(0.5), "randomization": np.str_("train")},
    {"moves": np.int64(4)},
]
BATCH_SETTINGS: dict[str, Any] = {
    **{"num_threads": np.int64(2), "autoreset_mode": AutoresetMode.SAME_STEP, "max_episode_steps": np.int64(100)},
    **{"num_envs": np.int64(2), "delay": np.array([0.0, 1.5])},
}


def attribute_of(argument: str) -> str:
    """Attribute that tells an argument: `moves` of a batch are those that its arms make now."""
    return "num_moves" if argument == "moves" else argument


class TestArguments:
    @pytest.mark.parametrize("name", ["BeltArm-v0", *(["BeltArmMuJoCo-v0"] if find_spec("mujoco") else [])])
    def test_specs_tell_the_number_of_steps_that_was_given(self, name: str):
        def told(env: Any) -> tuple[int | None, int]:
            return EnvSpec.from_json(env.spec.to_json()).max_episode_steps, env.unwrapped.max_episode_steps

        both: list[Any] = [gym.make(name), gym.make_vec(name, num_envs=2)]
        for made in both:
            assert told(made) == (None, EPISODE_STEPS)
            assert told(gym.make_vec(made.spec, moves=3)) == (None, 3 * EPISODE_STEPS)
        assert told(gym.make(both[0].spec, moves=3)) == (None, 3 * EPISODE_STEPS)
        assert told(gym.make(name, max_episode_steps=7)) == (7, EPISODE_STEPS), "Gymnasium's wrapper ends the episode"
        assert told(gym.make_vec(name, num_envs=2, max_episode_steps=7)) == (7, 7)

    @pytest.mark.parametrize("settings", NUMPY_SETTINGS, ids=str)
    def test_specs_make_the_environment_again(self, settings: dict[str, Any]):
        env: Any = gym.make("BeltArm-v0", **settings)
        expected = play(env, torques(20), seed=3)
        for spec in (EnvSpec.from_json(env.spec.to_json()), pickle.loads(pickle.dumps(env.spec))):
            again: Any = gym.make(spec)
            assert again.observation_space == env.observation_space
            assert play(again, torques(20), seed=3) == expected
            for name in settings:
                assert getattr(again.unwrapped, attribute_of(name)) == getattr(env.unwrapped, attribute_of(name))

    def test_specs_make_the_batch_again(self):
        envs: Any = gym.make_vec("beltarm_env:BeltArm-v0", **BATCH_SETTINGS)
        for spec in (envs.spec, EnvSpec.from_json(envs.spec.to_json())):
            again: Any = gym.make_vec(spec)
            assert np.array_equal(again.reset(seed=1)[0], envs.reset(seed=1)[0])
            assert again.metadata["autoreset_mode"] is envs.metadata["autoreset_mode"]
            for name in BATCH_SETTINGS:
                assert getattr(again.unwrapped, name) == getattr(envs.unwrapped, name)

    @pytest.mark.parametrize("kind", [BeltArmEnv, BeltArmVectorEnv])
    def test_are_fixed_at_construction(self, kind: Any):
        arguments = ARGUMENTS if kind is BeltArmEnv else BATCH_ARGUMENTS
        assert {*inspect.signature(kind).parameters} == {*arguments}
        env = kind()
        for name, value in arguments.items():
            attribute = attribute_of(name)
            before = getattr(env, attribute)
            with pytest.raises(AttributeError, match=f"{name}="):
                setattr(env, attribute, value)
            assert getattr(env, attribute) == before
            assert getattr(kind(**{name: value}), attribute) in (value, AutoresetMode.SAME_STEP)
        with pytest.raises(AttributeError, match="moves"):  # of a batch, the table of what each arm does
            env.moves = 5
        with pytest.raises(AttributeError, match="sensors"):
            SyncVectorEnv([partial(gym.make, "BeltArm-v0")]).set_attr("sensors", "full")
        given: dict[str, Any] = {"payload_mass": (0.1, 0.2)}
        env = kind(randomization=given)
        given["payload_mass"] = env.randomization["payload_mass"] = (0.5, 0.6)
        assert env.randomization == {"payload_mass": (0.1, 0.2)}, "what was given or read is the caller's"
