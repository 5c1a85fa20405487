import copy
import math
import pickle
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env as gymnasium_check_env
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv
from gymnasium.wrappers import PassiveEnvChecker, TimeLimit
from numpy.typing import NDArray
from stable_baselines3.common.env_checker import check_env as sb3_check_env
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv

from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS, TRAIN_RANGES, ArmParams, BeltArmEnv
from beltarm_env.kernels import layout
from beltarm_env.observation import ENTRIES, LOOKAHEADS, decode
from beltarm_env.task.cost import MAX_COST
from eval.reference.event_located import tip

SENSORS = ("encoder", "tip", "full", "accelerometer")
PROFILES = ("trapezoid", "scurve", "quintic")
TERMS = ("cost_position", "cost_velocity", "cost_torque_rate")
TOTALS = {"total_cost", *(f"total_{term}" for term in TERMS), "episode_steps", "tip_error_rms", "tip_error_max"}
INFO = {"tip_error", *TERMS, *TOTALS}
STILL = np.zeros(1, np.float32)
OUTWARD = np.ones(1, np.float32)
LONG_MOVE = {"start": 0.1, "goal": 1.4, "duration": 1.1, "ramp_time": 0.3}


def make(**settings: Any) -> BeltArmEnv:
    env = gym.make("BeltArm-v0", **settings).unwrapped
    assert isinstance(env, BeltArmEnv)
    return env


def torques(steps: int, seed: int = 0, hold: int = 40) -> NDArray[np.float32]:
    """Random torques, each held for a while: enough to slide, stick and reverse, shape (steps, 1)."""
    levels = np.random.default_rng(seed).uniform(-1, 1, (-(-steps // hold), 1))
    return np.repeat(levels, hold, axis=0)[:steps].astype(np.float32)


def play(env: gym.Env[Any, Any], actions: NDArray[np.float32], **reset: Any) -> list[tuple[Any, ...]]:
    """Everything that an episode returns, observations as bytes so that lists compare bit for bit."""
    observation, info = env.reset(**reset)
    record: list[tuple[Any, ...]] = [(observation.tobytes(), info)]
    for action in actions:
        observation, *rest = env.step(action)
        record.append((observation.tobytes(), *rest))
        if rest[1] or rest[2]:
            break
    return record


# Checkers


@pytest.mark.parametrize("randomization", ["off", "train"])
@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("sensors", SENSORS)
def test_both_checkers_are_content(sensors: str, profile: str, randomization: str):
    settings = {"sensors": sensors, "profile": profile, "randomization": randomization}
    gymnasium_check_env(make(**settings), skip_render_check=True)
    sb3_check_env(make(**settings), warn=True, skip_render_check=True)


def test_name_with_module_makes_the_same_environment():
    wrapped = gym.make("beltarm_env:BeltArm-v0")
    assert isinstance(wrapped.unwrapped, BeltArmEnv)
    assert play(wrapped, torques(50), seed=1) == play(make(), torques(50), seed=1)


def test_no_wrapper_is_in_the_way_of_a_step_unless_asked_for():
    env = gym.make("BeltArm-v0")
    assert isinstance(env, TimeLimit) and env.env is env.unwrapped
    bare = gym.make("BeltArm-v0", max_episode_steps=-1)
    assert bare is bare.unwrapped
    assert isinstance(gym.make("BeltArm-v0", disable_env_checker=False, max_episode_steps=-1), PassiveEnvChecker)


# What a step returns


def test_types_of_what_a_step_returns():
    env = make()
    env.reset(seed=0)
    for action in (STILL, OUTWARD, np.array([-5.0]), np.array([1], np.int64)):
        observation, reward, terminated, truncated, info = env.step(action)  # pyright: ignore[reportArgumentType]
        assert type(observation) is np.ndarray
        assert (observation.dtype, observation.shape) == (np.float32, env.observation_space.shape)
        assert [type(value) for value in (reward, terminated, truncated)] == [float, bool, bool]
        assert {type(value) for value in info.values()} == {float}
        assert set(info) == INFO


@pytest.mark.parametrize("action", [STILL, OUTWARD], ids=["truncated", "terminated"])
def test_info_until_the_end(action: NDArray[np.float32]):
    env = make()
    record = play(env, np.tile(action, (EPISODE_STEPS, 1)), seed=0)
    assert record[0][-1] == {}
    assert all(set(step[-1]) == INFO for step in record[1:])
    assert {type(value) for value in record[-1][-1].values()} == {float}


@pytest.mark.parametrize("sensors", SENSORS)
def test_observations_stay_within_the_space(sensors: str):
    env = make(sensors=sensors, randomization="train")
    for seed in range(5):
        observation, _ = env.reset(seed=seed)
        assert observation in env.observation_space
        for action in torques(EPISODE_STEPS, seed, hold=150):
            observation, _, terminated, truncated, _ = env.step(action)
            assert observation in env.observation_space
            if terminated or truncated:
                break


def test_every_call_returns_data_of_its_own():
    env = make(sensors="full")
    returned: list[Any] = [env.reset(seed=0)]
    returned += [env.step(action)[::4] for action in torques(3)]
    returned += [env.reset(seed=0)]
    observations = [observation for observation, _ in returned]
    for k, one in enumerate(observations):
        assert all(not np.shares_memory(one, other) for other in observations[k + 1 :])
    assert len({id(info) for _, info in returned}) == len(returned)


def test_spoiling_what_was_returned_changes_nothing():
    expected = play(make(), torques(30), seed=4)
    env = make()
    observation, info = env.reset(seed=4)
    for action, (observation_bytes, reward, *_) in zip(torques(30), expected[1:], strict=True):
        observation[:], info["tip_error"] = 7.0, 7.0
        env.state[:] = 7.0
        observation, step_reward, _, _, info = env.step(action)
        assert (observation.tobytes(), step_reward) == (observation_bytes, reward)


def test_state_is_a_float64_copy():
    env = make()
    env.reset(seed=0)
    before = env.state
    assert before.dtype == np.float64
    kept = before.copy()
    env.state[:] = 3.0
    assert np.array_equal(env.state, kept)
    env.step(OUTWARD)
    assert np.array_equal(before, kept)
    assert not np.array_equal(env.state, kept)


# Beginning and end


def test_truncates_at_exactly_1200_steps():
    env = make()
    record = play(env, np.zeros((2 * EPISODE_STEPS, 1), np.float32), seed=0)
    assert EPISODE_STEPS == 1200
    assert len(record) == 1 + 1200
    assert [step[2:4] for step in record[1:]] == [(False, False)] * 1199 + [(False, True)]
    assert env.time == pytest.approx(1.8)


@pytest.mark.parametrize("action", [STILL, OUTWARD], ids=["truncated", "terminated"])
def test_step_needs_a_reset_before_and_after_an_episode(action: NDArray[np.float32]):
    env = make()
    with pytest.raises(ResetNeeded, match=r"call reset\(\)"):
        env.step(action)
    play(env, np.tile(action, (EPISODE_STEPS, 1)), seed=0)
    with pytest.raises(ResetNeeded, match=r"call reset\(\)"):
        env.step(action)
    env.reset()
    env.step(action)


def test_a_time_limit_ends_the_episode_that_the_arm_ends_itself():
    """Also where the arm leaves its workspace with the last step: Gymnasium's TimeLimit calls that both."""
    alone, wrapped = make(), gym.make("BeltArm-v0")
    for env in (alone, wrapped):
        env.reset(seed=0, options={"move": {"goal": 1.5}})
        for _ in range(EPISODE_STEPS - 1):
            assert not any(env.step(STILL)[2:4])
        alone_or_in_it = env.unwrapped
        assert isinstance(alone_or_in_it, BeltArmEnv)
        alone_or_in_it._batch.blocks[0, layout.STATE * layout.LANES] = 200.0  # far outside
        assert env.step(STILL)[2:4] == (True, True)


def outside(env: BeltArmEnv) -> bool:
    joint = env.state[0] / env.params.gear_ratio
    arm = joint - env.state[2]
    return not (-0.25 <= min(joint, arm) and max(joint, arm) <= np.pi / 2 + 0.25)


@pytest.mark.parametrize("direction", [-1.0, 1.0])
def test_terminates_when_the_arm_leaves_the_workspace_and_not_before(direction: float):
    env = make(randomization="train")
    env.reset(seed=3)
    terminated = truncated = False
    while not terminated:
        assert not truncated and not outside(env)
        _, _, terminated, truncated, _ = env.step(np.array([direction], np.float32))
    assert outside(env) and not truncated


def test_leaving_is_charged_the_bound_for_every_remaining_step():
    record = play(make(), np.tile(OUTWARD, (EPISODE_STEPS, 1)), seed=0)
    steps = len(record) - 1
    _, reward, terminated, _, info = record[-1]
    assert terminated and 50 < steps < EPISODE_STEPS
    assert reward == pytest.approx(-sum(info[term] for term in TERMS) - MAX_COST * (EPISODE_STEPS - steps), rel=1e-12)
    assert info["episode_steps"] == steps


@pytest.mark.parametrize("push", [10, 40, 80, 200])
def test_ending_early_never_pays(push: int):
    """Pushing on, out of the workspace, costs more than stopping to push, whenever that is."""
    actions = np.zeros((EPISODE_STEPS, 1), np.float32)
    actions[:push] = 0.35
    stays = play(make(), actions, seed=2, options={"move": LONG_MOVE})
    actions[push:] = 1.0
    leaves = play(make(), actions, seed=2, options={"move": LONG_MOVE})
    assert leaves[-1][2]
    assert sum(step[1] for step in leaves[1:]) < sum(step[1] for step in stays[1:])
    worst_of_staying = sum(step[1] for step in leaves[1:-1]) - MAX_COST * (EPISODE_STEPS - len(leaves) + 2)
    assert worst_of_staying <= sum(step[1] for step in leaves[1:])
    assert sum(step[1] for step in leaves[1:]) < worst_of_staying + MAX_COST


# Reproducibility


@pytest.mark.parametrize("sensors", SENSORS)
def test_same_seed_gives_the_same_episodes(sensors: str):
    first, second = (make(sensors=sensors, randomization="train") for _ in range(2))
    actions = torques(EPISODE_STEPS, hold=15)
    assert play(first, actions, seed=5) == play(second, actions, seed=5)
    assert play(first, actions) == play(second, actions)
    assert play(first, actions, seed=5) == play(second, actions, seed=5)


def test_seeds_and_episodes_differ():
    env = make(randomization="train")
    starts = [env.reset(seed=seed)[0] for seed in range(5)] + [env.reset()[0] for _ in range(5)]
    assert len({start.tobytes() for start in starts}) == 10


SETTINGS: dict[str, Any] = {"sensors": "full", "profile": "scurve", "randomization": "train", "delay": 1}


@pytest.mark.slow
def test_worker_processes_of_gymnasium_give_the_same_episodes():
    makers = [partial(gym.make, "beltarm_env:BeltArm-v0", **SETTINGS)] * 2
    there, here = AsyncVectorEnv(makers, context="spawn"), SyncVectorEnv(makers)
    try:
        assert np.array_equal(there.reset(seed=8)[0], here.reset(seed=8)[0])
        actions = np.stack([torques(EPISODE_STEPS + 60, seed, hold=15) for seed in (0, 1)], axis=1)
        for action in actions:
            results, expected = there.step(action), here.step(action)
            assert all(np.array_equal(a, b) for a, b in zip(results[:4], expected[:4], strict=True))
            assert all(np.array_equal(results[4][name], expected[4][name]) for name in expected[4])
    finally:
        there.close()


@pytest.mark.slow
def test_worker_processes_of_sb3_give_the_same_episodes():
    makers = [partial(gym.make, "beltarm_env:BeltArm-v0", **SETTINGS)] * 2
    there, here = SubprocVecEnv(makers, start_method="spawn"), DummyVecEnv(makers)
    try:
        there.seed(8)
        here.seed(8)
        start, expected_start = there.reset(), here.reset()
        assert np.array_equal(start, expected_start)  # pyright: ignore[reportArgumentType]
        single = make(**SETTINGS)
        assert np.array_equal(expected_start[1], single.reset(seed=9)[0])  # pyright: ignore[reportArgumentType]
        ends = 0
        for action in np.stack([torques(EPISODE_STEPS + 60, seed, hold=15) for seed in (0, 1)], axis=1):
            (seen, rewards, done, infos), expected = there.step(action), here.step(action)
            assert np.array_equal(seen, expected[0])  # pyright: ignore[reportArgumentType]
            assert np.array_equal(np.float32(rewards), expected[1]) and np.array_equal(done, expected[2])
            for info, expected_info in zip(infos, expected[3], strict=True):
                terminal = info.pop("terminal_observation", None), expected_info.pop("terminal_observation", None)
                assert np.array_equal(*terminal) and info == expected_info
            ends += int(done.sum())
        assert ends >= 2
    finally:
        there.close()


# Options of reset


FIXED: list[dict[str, Any]] = [
    {"params": {"payload_mass": 0.15}},
    {"params": {"belt_stiffness": 20.0, "hand_length": 0.2, "torque_limit": 0.5}},
    {"move": {"start": 0.2}},
    {"move": {"goal": 0.9}},
    {"move": {"duration": 1.3}},
    {"move": {"ramp_time": 0.25}},
    {"move": {"start": 1.5, "goal": 0.3, "duration": 1.2}},
    {"move": LONG_MOVE},
    {"state": [30.0, 5.0, 0.01, -0.2]},
    {"params": {"coulomb_friction": 0.0}, "move": {"goal": 1.0}, "state": np.array([60.0, 0.0, 0.0, 0.0])},
]


@pytest.mark.parametrize("options", FIXED, ids=str)
def test_options_fix_what_they_name(options: dict[str, Any]):
    env = make(randomization="train")
    for seed in range(10):
        env.reset(seed=seed)
        drawn = env.params
        env.reset(seed=seed, options=options)
        for name in ArmParams.__slots__:
            assert getattr(env.params, name) == options.get("params", {}).get(name, getattr(drawn, name))
        for name, value in options.get("move", {}).items():
            assert env.move[name] == value
        start = env.move["start"] * env.params.gear_ratio
        at_rest = [start, 0.0, -kinematic_error(env.params, start)[0], 0.0]  # the belt is
        assert env.state.tolist() == pytest.approx(list(options.get("state", at_rest)), rel=1e-12, abs=1e-15)


def kinematic_error(params: ArmParams, motor_angle: float) -> tuple[float, float]:
    """Return what the harmonic drive adds to theta_a / G [rad], and its derivative by theta_a."""
    twice = 2 * motor_angle + params.kinematic_error_phase
    return params.kinematic_error * math.sin(twice), 2 * params.kinematic_error * math.cos(twice)


@pytest.mark.parametrize("options", FIXED, ids=str)
def test_options_do_not_disturb_the_random_stream(options: dict[str, Any]):
    free, fixed = (make(randomization="train") for _ in range(2))
    free.reset(seed=6)
    fixed.reset(seed=6, options=options)
    for _ in range(3):
        assert free.reset()[0].tobytes() == fixed.reset()[0].tobytes()
        assert free.params == fixed.params and free.move == fixed.move


def test_options_are_left_as_they_were_and_not_remembered():
    env = make()
    options = {"params": {"payload_mass": 0.3}, "move": dict(LONG_MOVE), "state": [10.0, 0.0, 0.0, 0.0]}
    before = copy.deepcopy(options)
    env.reset(seed=0, options=options)
    assert options == before
    env.reset()
    assert env.params == ArmParams()
    assert env.move != LONG_MOVE


@pytest.mark.parametrize("name", ["start", "goal", "duration", "ramp_time"])
def test_whatever_the_environment_draws_can_be_fixed_alone(name: str):
    env = make()
    for seed in range(200):
        env.reset(seed=seed)
        value = env.move[name]
        env.reset(seed=1000 + seed, options={"move": {name: value}})
        assert env.move[name] == value


@pytest.mark.parametrize("profile", PROFILES)
def test_moves_drawn_are_those_promised(profile: str):
    env = make(profile=profile)
    moves = []
    for _ in range(500):
        env.reset()
        moves.append(list(env.move.values()))
    start, goal, duration, ramp_time = np.array(moves).T
    assert (np.minimum(start, goal) >= 0).all() and (np.maximum(start, goal) <= np.pi / 2).all()
    assert (abs(goal - start) >= np.radians(15) - 1e-9).all()
    assert (duration >= 0.5).all() and (duration <= 1.2 + 1e-9).all()
    assert (ramp_time >= 0.15 * duration - 1e-9).all() and (ramp_time <= 0.35 * duration + 1e-9).all()
    assert (goal > start).any() and (goal < start).any()


def test_training_ranges_are_covered_and_nothing_else_varies():
    env = make(randomization="train")
    drawn: dict[str, list[float]] = {name: [] for name in ArmParams.__slots__}
    for _ in range(300):
        env.reset()
        for name, values in drawn.items():
            values.append(getattr(env.params, name))
    for name, values in drawn.items():
        low, high = TRAIN_RANGES.get(name, (getattr(ArmParams(), name),) * 2)
        assert low <= min(values) <= low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) <= max(values) <= high


def test_own_ranges():
    env = make(randomization={"payload_mass": (0.2, 0.5), "belt_stiffness": (20.0, 20.0)})
    for seed in range(20):
        env.reset(seed=seed)
        assert 0.2 <= env.params.payload_mass <= 0.5
        assert env.params == ArmParams(payload_mass=env.params.payload_mass, belt_stiffness=20.0)


# Reward


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


@pytest.mark.parametrize("profile", PROFILES)
def test_reward_is_the_documented_cost(profile: str):
    env = make(profile=profile, randomization="train")
    env.reset(seed=1, options={"params": {"hand_length": 0.17, "link_length": 0.3}})
    last, largest = 0.0, 0.0
    for action in 1.3 * torques(EPISODE_STEPS, 3, hold=25):
        torque = float(np.clip(action[0], -1, 1))
        _, reward, terminated, truncated, info = env.step(action)
        if terminated or truncated:
            break
        assert {name: info[name] for name in ("tip_error", *TERMS)} == pytest.approx(
            expected_cost(env, torque, last), abs=1e-6
        )
        assert reward == -(info["cost_position"] + info["cost_velocity"] + info["cost_torque_rate"])
        assert -MAX_COST <= reward <= 0
        last, largest = torque, max(largest, info["tip_error"])
    assert largest > 0.1, "the position term should have saturated"


def test_terms_saturate():
    env = make()
    env.reset(seed=0, options={"move": LONG_MOVE, "state": [100.0, 250.0, 0.3, 60.0]})
    _, reward, _, _, info = env.step(-OUTWARD)
    assert (info["cost_position"], info["cost_velocity"]) == (10.0, 10.0)
    assert reward == pytest.approx(-20.1)
    _, reward, *_ = env.step(OUTWARD)
    assert reward == pytest.approx(-MAX_COST)


@pytest.mark.parametrize(
    ("model", "torque_limit"),
    [("lumped", 1e6), ("lumped", 1e7), ("lagrangian", 1e5), ("lumped", 1e9), ("lagrangian", 1e9)],
)
@pytest.mark.filterwarnings("ignore:.* encountered in:RuntimeWarning")  # of NumPy, where kernels run as plain Python
def test_an_arm_that_a_torque_tears_apart_has_a_finite_tip_error(model: str, torque_limit: float):
    env = make(model=model)
    env.reset(seed=0, options={"params": {"torque_limit": torque_limit, "belt_stiffness": 40.0}, "move": LONG_MOVE})
    _, reward, terminated, _, info = env.step(OUTWARD)
    assert terminated and math.isfinite(reward)
    for name in ("tip_error", "tip_error_max", "tip_error_rms"):
        assert 0 < info[name] <= 1e6
    assert info["tip_error"] == 1e6 or torque_limit == 1e9, "a state that is no number is that of an arm at rest"


@pytest.mark.parametrize("hold", [5, 200], ids=["truncated", "terminated"])
def test_totals_are_the_sums(hold: int):
    record = play(make(), 1.5 * torques(EPISODE_STEPS, 1, hold), seed=1)
    _, _, terminated, _, last = record[-1]
    assert terminated == (hold == 200)
    infos = [step[-1] for step in record[1:]]
    for term in TERMS:
        assert last[f"total_{term}"] == pytest.approx(sum(info[term] for info in infos), rel=1e-12)
    errors = np.array([info["tip_error"] for info in infos])
    assert last["total_cost"] == pytest.approx(-sum(step[1] for step in record[1:]), rel=1e-12)
    assert last["tip_error_max"] == errors.max()
    assert last["tip_error_rms"] == pytest.approx(np.sqrt(np.mean(errors**2)), rel=1e-12)
    assert last["episode_steps"] == len(infos)
    for k in (0, 60):  # what was told on the way was true then
        assert infos[k]["episode_steps"] == k + 1
        assert infos[k]["total_cost"] == pytest.approx(-sum(step[1] for step in record[1 : k + 2]), rel=1e-12)
        assert infos[k]["tip_error_max"] == errors[: k + 1].max()


def test_totals_begin_anew_with_every_episode():
    env = make()
    action = np.tile(OUTWARD, (EPISODE_STEPS, 1))
    assert play(env, action, seed=1) == play(env, action, seed=1)


# Observation


def close(value: float) -> Any:
    """Equal but for the float32 of the observation."""
    return pytest.approx(value, rel=3e-7, abs=1e-7)


@pytest.mark.parametrize("profile", PROFILES)
def test_observation_decodes_to_what_the_accessors_say(profile: str):
    env = make(profile=profile, randomization="train")
    observation, _ = env.reset(seed=7)
    last = 0.0
    for action in [*torques(600, 2, hold=9), STILL]:
        told = decode(observation)
        now = env.reference(env.time)
        assert told["reference_angle"] == close(now.angle)
        assert told["reference_speed"] == close(now.speed)
        assert told["reference_acceleration"] == close(now.acceleration)
        for ahead in LOOKAHEADS:
            then = env.reference(env.time + ahead)
            assert told[f"reference_speed_ahead_{1000 * ahead:.0f}ms"] == close(then.speed)
            assert told[f"reference_acceleration_ahead_{1000 * ahead:.0f}ms"] == close(then.acceleration)
        assert {name: told[name] for name in env.move} == {name: close(value) for name, value in env.move.items()}
        assert told["elapsed_time"] == close(env.time)
        assert told["last_command"] == close(last)
        observation, _, terminated, truncated, _ = env.step(2 * action)
        last = float(np.clip(2 * action[0], -1, 1))
        if terminated or truncated:
            break
    assert env.time > 0.3, "the arm left before the reference had changed much"


@pytest.mark.parametrize("delay", [0, 1, 2])
@pytest.mark.parametrize("encoder_counts", [4000, 1000])
def test_encoder_entries_are_those_of_a_quantised_and_late_encoder(encoder_counts: int, delay: int):
    env = make(encoder_counts=encoder_counts, delay=delay)
    observation, _ = env.reset(seed=7, options={"move": LONG_MOVE, "state": [60.0, 30.0, 0.01, 0.0]})
    resolution = 2 * np.pi / encoder_counts
    angles = [60.0 - 30.0 * CONTROL_PERIOD * k for k in (3, 2, 1, 0)]
    for action in torques(300, 2, hold=10):
        told, counts = decode(observation), np.rint(np.array(angles) / resolution)
        now, before = counts[-1 - delay], counts[-2 - delay]
        speed = (now - before) * resolution / CONTROL_PERIOD
        gear, reference = env.params.gear_ratio, env.reference(env.time)
        assert told["motor_angle_error"] == close(reference.angle * gear - now * resolution)
        assert told["motor_speed_error"] == close(reference.speed * gear - speed)
        assert told["motor_speed"] == close(speed)
        assert told["motor_angle"] == close(now * resolution)
        assert told["sin_2_motor_angle"] == close(np.sin(2 * now * resolution))
        assert told["cos_2_motor_angle"] == close(np.cos(2 * now * resolution))
        observation, *_ = env.step(action)
        angles.append(env.state[0])


def test_encoder_error_is_below_half_a_count():
    env = make()
    for seed in range(50):
        observation, _ = env.reset(seed=seed, options={"state": [20.0 + seed / 7, 0.0, 0.0, 0.0], "move": LONG_MOVE})
        error = env.reference(0.0).angle * env.params.gear_ratio - env.state[0]
        assert abs(decode(observation)["motor_angle_error"] - error) <= np.pi / 4000 + 1e-5


def test_entries_are_cut_at_their_bounds():
    env = make(sensors="full")
    strong = {"params": {"torque_limit": 50.0}, "state": [60.0, 2000.0, 0.0, 200.0], "move": LONG_MOVE}
    env.reset(seed=0, options=strong)
    observation, *_ = env.step(np.ones(1, np.float32))
    assert env.state[1] > 2000 and env.state[3] > 200
    assert observation in env.observation_space
    told = decode(observation, "full")
    assert told["motor_speed"] == close(2000.0)
    assert told["torsion_speed"] == close(200.0)
    for entry in ENTRIES["full"]:
        assert abs(told[entry.name]) <= entry.bound * (1 + 1e-6)


def radial_tip_speed(env: BeltArmEnv) -> float:
    step = 1e-5 * np.array([env.state[1], 0.0, env.state[3], 0.0])
    return float((tip(env.params, env.state + step) - tip(env.params, env.state - step))[0] / 2e-5)


@pytest.mark.parametrize("delay", [0, 1, 2])
def test_tip_tier_adds_the_late_radial_speed_of_the_tip(delay: int):
    env = make(sensors="tip", randomization="train", delay=delay)
    env.reset(seed=3, options={"move": LONG_MOVE})
    speeds = [0.0, 0.0, 0.0]
    for action in torques(300, 4, hold=30):
        observation, *_ = env.step(action)
        speeds.append(radial_tip_speed(env))
        assert decode(observation, "tip")["tip_speed"] == pytest.approx(speeds[-1 - delay], rel=1e-5, abs=1e-6)
    assert max(np.abs(speeds)) > 0.1


def test_tip_tier_knows_the_speed_of_an_arm_that_starts_moving():
    env = make(sensors="tip")
    observation, _ = env.reset(seed=3, options={"move": LONG_MOVE, "state": [60.0, 100.0, 0.02, 0.5]})
    assert abs(radial_tip_speed(env)) > 0.1
    assert decode(observation, "tip")["tip_speed"] == pytest.approx(radial_tip_speed(env), rel=1e-5)


@pytest.mark.parametrize("delay", [0, 2])
def test_full_tier_adds_the_true_torsion(delay: int):
    env = make(sensors="full", randomization="train", delay=delay)
    observation, _ = env.reset(seed=3, options={"state": [60.0, 0.0, 0.03, -0.4]})
    for action in torques(100, 4, hold=20):
        told = decode(observation, "full")
        angle, speed, torsion, torsion_speed = env.state
        error, slope = kinematic_error(env.params, angle)
        assert told["torsion"] == close(torsion + error)
        assert told["torsion_speed"] == close(torsion_speed + slope * speed)
        observation, *_ = env.step(action)


@pytest.mark.parametrize("sensors", SENSORS[1:])
def test_tiers_differ_only_by_what_they_add(sensors: str):
    plain, more = make(randomization="train"), make(sensors=sensors, randomization="train")
    expected, told = plain.reset(seed=1)[0], more.reset(seed=1)[0]
    for action in torques(200):
        assert np.array_equal(told[: len(expected)], expected)
        expected, told = plain.step(action)[0], more.step(action)[0]


# Specs, copies, closing


SPEC_SETTINGS: list[dict[str, Any]] = [
    {},
    SETTINGS,
    {"randomization": {"payload_mass": (0.1, 0.4)}, "encoder_counts": 1000},
]


@pytest.mark.parametrize("settings", SPEC_SETTINGS, ids=str)
@pytest.mark.parametrize(
    "through",
    [lambda spec: EnvSpec.from_json(spec.to_json()), lambda spec: pickle.loads(pickle.dumps(spec)), copy.deepcopy],
    ids=["json", "pickle", "deepcopy"],
)
def test_spec_makes_the_environment_again(settings: dict[str, Any], through: Any):
    env = gym.make("BeltArm-v0", **settings)
    again = gym.make(through(env.spec))
    assert again.observation_space == env.observation_space
    assert play(again, torques(60), seed=3) == play(env, torques(60), seed=3)


def test_deepcopy_goes_on_by_itself_exactly_as_the_original():
    original = make(randomization="train")
    play(original, torques(100, hold=15), seed=3)
    before = original.state
    twin = copy.deepcopy(original)
    after = []
    for env in (twin, original):
        assert np.array_equal(env.state, before)
        steps = [env.step(action) for action in torques(50, 9)]
        assert not np.array_equal(env.state, before)
        after.append((env.state.tolist(), env.time, [step[1:] for step in steps], env.reset()[0].tolist()))
    assert after[0] == after[1]


def test_closing_twice_does_no_harm():
    for env in (gym.make("BeltArm-v0"), make()):
        env.reset(seed=0)
        env.close()
        env.close()
