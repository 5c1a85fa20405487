"""The residual: zero is the base, one arm is a batch is a controller, what the agent observes, and SB3's protocol."""

import math
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from types import SimpleNamespace
from typing import Any, cast

import gymnasium as gym
import numpy as np
import pytest
import torch
from bundles import new_weights
from gymnasium.error import ResetNeeded
from gymnasium.wrappers import NormalizeObservation, RescaleAction
from refusals import refused
from stable_baselines3.common.env_checker import check_env

from agents.policy.bundle import BundleSpec
from agents.policy.network import NetworkPolicy
from agents.residual.controller import ResidualController, ResidualSettings
from agents.residual.env import ResidualEnv, ResidualVecEnv
from agents.residual.knowledge import ENTRIES, InformedBase, residual_observation_space
from baselines import CONTROLLERS
from baselines.optimal.adaptive import tuned_identifier
from baselines.reading import read
from baselines.registry import WITH_ACCELEROMETER
from beltarm_env import EPISODE_STEPS, ArmParams, BeltArmEnv, BeltArmVectorEnv
from beltarm_env.arrays import Singles
from beltarm_env.observation import index, size
from beltarm_env.rollout import Recording, rollout

SETTINGS = ResidualSettings()
HOLDS = EPISODE_STEPS // SETTINGS.hold
ARMS: dict[str, Any] = {"randomization": "train", "profile": "scurve"}
OUTWARD = ResidualSettings(limit=2.0, hold=7)  # with a residual of 1: the full torque until the arm has left
torch.set_num_threads(1)  # threads cost more than they give in networks this small


def single_env(settings: ResidualSettings = SETTINGS) -> ResidualEnv:
    return ResidualEnv(BeltArmEnv(**ARMS), CONTROLLERS["paper"](), settings)


def many(count: int, settings: ResidualSettings = SETTINGS, moves: int = 1, **options: Any) -> Any:
    """A batch that begins at the moves' start, seeded with 30, 31, ..."""
    arms = BeltArmVectorEnv(count, autoreset_mode="SameStep", moves=moves, **ARMS)
    batch = ResidualVecEnv(arms, CONTROLLERS["paper"](), settings, **{"stagger": False, **options})
    batch.seed(30)
    return batch


def random_residuals(count: int, seed: int = 0) -> Singles:
    """Shape (holds of an episode, count, 1); changing slowly, so that they move the arms."""
    levels = np.random.default_rng(seed).uniform(-1, 1, (HOLDS // 10, count, 1))
    return np.repeat(levels, 10, axis=0).astype(np.float32)


def base_run(count: int, moves: int = 1) -> Recording:
    return rollout(CONTROLLERS["paper"](), count, seed=30, moves=moves, **ARMS)


def seen_by_base(env: BeltArmEnv, seen: Singles, steps: int) -> Singles:
    """What an agent observes after so many steps of a fresh episode under the base alone."""
    informed = InformedBase(CONTROLLERS["paper"]())
    memory = informed.advance(seen[None], None, None)
    for _ in range(steps):
        seen = env.step(memory.action[0])[0]
        memory = informed.advance(seen[None], memory, None)
    return informed.seen(seen[None], memory)[0]


class Silent:
    def predict(self, observation: Singles, state: Any = None, episode_start: Any = None, deterministic: bool = True):
        return np.zeros((len(observation), 1), np.float32), state


def both(arms: tuple[Any, Any], base: Any, settings: ResidualSettings = SETTINGS) -> list[Callable[[], object]]:
    return [partial(ResidualVecEnv, arms[0], base, settings), partial(ResidualEnv, arms[1], base, settings)]


def test_what_does_not_fit_is_refused():
    paper, batch, single = CONTROLLERS["paper"], many(3), single_env()
    other = ResidualController(CONTROLLERS["ei"](params=ArmParams(gear_ratio=100.0)), Silent(), SETTINGS)
    weak = BeltArmVectorEnv(2, autoreset_mode="SameStep", randomization={"torque_limit": (0.2, 0.2)})
    felt: Any = WITH_ACCELEROMETER["preview"]()
    changed = NormalizeObservation(BeltArmEnv()), RescaleAction(BeltArmEnv(), np.float32(-2), np.float32(2))
    normalised: Any = type("Normalised", (Silent,), {"get_vec_normalize_env": lambda self: self, "norm_obs": True})()
    flat, loose = (cast("Any", SimpleNamespace(predict=lambda o, *_, n=n: (o[:, n], {}))) for n in (0, [0]))
    flat, loose = (ResidualController(paper(), policy, SETTINGS) for policy in (flat, loose))
    seen, shifts = np.full((3, 26), 1e-5, np.float32), (many(2, moves=2).env, BeltArmEnv(moves=2))
    refused(ResetNeeded, ("reset()",), lambda: single.step(np.zeros(1, np.float32)))
    single.reset(seed=0)
    batch.reset()
    calls: list[tuple[tuple[str, ...], Callable[[], object]]] = [
        *((("limit", repr(v)), partial(replace, SETTINGS, limit=v)) for v in (0, 2.1, math.nan, "0.5")),
        *((("hold", repr(v)), partial(replace, SETTINGS, hold=v)) for v in (0, 101, 4.0, True)),
        (("NextStep", "SameStep"), lambda: ResidualVecEnv(BeltArmVectorEnv(2), paper(), SETTINGS)),
        (("BeltArm",), lambda: ResidualEnv(gym.make("CartPole-v1"), paper(), SETTINGS)),
        *(((str(shape), "(3, 1)"), partial(batch.step, np.zeros(shape))) for shape in ((3,), (1, 1), (3, 2), ())),
        *((("put ResidualEnv first",), partial(ResidualEnv, each, paper(), SETTINGS)) for each in changed),
        (("predict", "'paper'"), lambda: ResidualController(cast("Any", "paper"), Silent(), SETTINGS)),
        (("VecNormalize",), lambda: ResidualController(paper(), normalised, SETTINGS)),
        (("(3, 1)", "(3,)"), lambda: flat.predict(seen)),
        (("1 of 3 arms", "dict", "array"), lambda: loose.predict(seen + 0.1, loose.predict(seen)[1], np.arange(3) < 1)),
        (("nan", "finite"), lambda: batch.step(np.array([[0.0], [math.nan], [0]], np.float32))),
        *(((), partial(single.step, cast("Any", residual))) for residual in ([math.nan], [0.1, 0.2], "0.5")),
        (("gear_ratio", "100.0"), lambda: rollout(other, 2, seed=30)),
        (("gear_ratio 100.0", "88.0"), lambda: single.reset(options={"params": {"gear_ratio": 100.0}})),
        (("'scurve'", "'trapezoid'"), lambda: rollout(other, 2, profile="scurve")),
        *((("'scurve'",), call) for call in both((batch.env, single.env), CONTROLLERS["zv"]())),
        *((("'accelerometer'", "'encoder'"), call) for call in both((weak, BeltArmEnv()), felt)),
        *((("1200", "got 7", "choose"), call) for call in both(shifts, paper(), OUTWARD)),
        (("torque_limit 0.2", "0.3"), lambda: ResidualVecEnv(weak, paper(), SETTINGS).reset()),
    ]
    for words, call in calls:
        refused((ValueError, TypeError), words, call)


def test_a_residual_of_zero_is_the_base():
    env, expected, total, truncated = single_env(), base_run(5), 0.0, False
    arm: Any = env.unwrapped
    env.reset(seed=30)
    for hold in range(HOLDS):
        _, reward, _, truncated, _ = env.step(np.zeros(1, np.float32))
        total += reward
        assert np.array_equal(arm.state, expected.state[SETTINGS.hold * (hold + 1) - 1, 0])
    assert truncated and -total == pytest.approx(expected.cost[0], rel=1e-12)
    recording = rollout(ResidualController(CONTROLLERS["paper"](), Silent(), SETTINGS), 5, seed=30, **ARMS)
    for name in Recording.__slots__:
        assert np.array_equal(getattr(recording, name), getattr(expected, name)), name
    assert (np.ptp(expected.state[:, :, 0], axis=0) > 10).all(), "the arms should have moved"


def test_batch_agrees_with_single_arms_bit_for_bit():
    batch, singles, done = many(5), [single_env() for _ in range(5)], np.zeros(5, np.bool_)
    assert np.array_equal(batch.reset(), [single.reset(seed=30 + i)[0] for i, single in enumerate(singles)])
    for residuals in 0.6 * random_residuals(5):
        observations, rewards, done, infos = batch.step(residuals)
        for i, single in enumerate(singles):
            seen, reward, terminated, truncated, _ = single.step(residuals[i])
            assert rewards[i] == np.float32(reward) and done[i] == (terminated or truncated)
            if not done[i]:
                assert observations[i].tobytes() == seen.tobytes()
                continue
            assert truncated, "an arm that leaves within a hold starts its new episode there, see below"
            assert infos[i]["terminal_observation"].tobytes() == seen.tobytes()
            assert observations[i].tobytes() == single.reset()[0].tobytes()
    assert done.all()


def test_a_policy_acts_alike_in_training_and_as_a_controller():
    count = moves = 2
    policy = NetworkPolicy(new_weights(BundleSpec("ppo", "paper", SETTINGS, (16, 16)), 0))
    controller = ResidualController(CONTROLLERS["paper"](), policy, SETTINGS)
    recording = rollout(controller, count, seed=30, moves=moves, **ARMS)
    assert recording.finished.all()
    assert not np.allclose(recording.state, base_run(count, moves).state)
    batch = many(count, moves=moves, reward_scale=0.5)
    observations, total, done = batch.reset(), np.zeros(count), np.zeros(count, np.bool_)
    for hold in range(moves * HOLDS):
        residuals, _ = policy.predict(observations, deterministic=True)
        observations, rewards, done, _ = batch.step(residuals)
        total += rewards
        if not done.any():
            run = recording.of_move(hold // HOLDS)
            assert np.array_equal(batch.env.state, run.state[SETTINGS.hold * (hold % HOLDS + 1) - 1])
    assert done.all()
    assert -2 * total == pytest.approx(recording.cost.reshape(moves, count).sum(axis=0), rel=1e-5)


def test_a_move_that_begins_with_the_sample_in_which_another_episode_ends():
    batch = many(2, moves=2, stagger=True)  # restarts its arms after 4 and 1204 of 2400 samples
    batch.reset()
    seen, _, done, _ = batch.step(np.zeros((2, 1), np.float32))
    env = BeltArmEnv(moves=2, **ARMS)
    alone = [seen_by_base(env, env.reset(seed=seed)[0], steps) for seed, steps in ((31, 1204), (None, 1200))]
    assert done.tolist() == [True, False] and (seen[:, index("elapsed_time")] == 0).all()
    assert batch.env.move_numbers.tolist() == [0, 1] and env.move_number == 1
    assert np.array_equal(seen[1], alone[1])


def test_what_the_agent_observes():
    batch, identifier, plain = many(3), tuned_identifier(), BeltArmVectorEnv(3, **ARMS)
    base, memory, belief, unexplained, commands = CONTROLLERS["paper"](), None, None, list[Any](), list[Any]()
    observations, seen = batch.reset(), plain.reset(seed=30)[0]
    for sample in range(30 * SETTINGS.hold):
        action, memory = base.predict(seen, memory)
        belief = identifier.update(belief, read(seen, ArmParams()), np.full(3, belief is None))
        unexplained.append(belief.angle - belief.state[:, 0])
        commands.append(action[:, 0])
        if sample % SETTINGS.hold == 0:
            z, doubt = belief.tracks.mean, np.sqrt(belief.tracks.covariance[:, 5, 5])
            expected = {
                **{"base_torque": action[:, 0], "believed_torsion": z[:, 2], "believed_delay": z[:, 10]},
                **{"believed_belt_stiffness": z[:, 5], "doubt_of_belt_stiffness": doubt},
                **{"surprise": belief.tracks.surprise, "unexplained_angle_0": unexplained[-1]},
            }
            if sample > 0:
                expected |= {"unexplained_angle_3": unexplained[-4], "command_2_before_last": commands[-4]}
            assert np.array_equal(observations[:, : size()], seen), sample
            for entry, value in zip(ENTRIES["belief"], observations[:, size() :].T, strict=True):
                if entry.name in expected:
                    np.testing.assert_allclose(entry.scale * value, expected[entry.name], rtol=1e-6, atol=1e-7)
        seen, *_ = plain.step(action)
        if sample % SETTINGS.hold == SETTINGS.hold - 1:
            observations, *_ = batch.step(np.zeros((3, 1), np.float32))


def test_price_of_the_torque_is_charged_for_every_change_to_the_last_sample():
    """The task charges 0.1 times every change, see `beltarm_env.task.cost`; so it does again for a price of two."""
    batch, dearer, given, charged = many(2), many(2, torque_price=2.0), random_residuals(2), np.zeros(2)
    batch.reset()
    dearer.reset()

    class Given:
        def predict(self, observation: Singles, state: int | None = None, *_: Any, **__: Any):
            return given[state or 0], (state or 0) + 1

    torques = rollout(ResidualController(CONTROLLERS["paper"](), Given(), SETTINGS), 2, seed=30, **ARMS).torque
    for residuals in given:
        charged += batch.step(residuals)[1] - dearer.step(residuals)[1]
    changes = np.abs(np.diff(torques, axis=0, prepend=0.0)).sum(axis=0) / ArmParams().torque_limit
    assert charged == pytest.approx(0.1 * changes, rel=1e-4)


@pytest.mark.parametrize("moves", [1, 2])
def test_the_end_of_an_episode(moves: int):
    batch = many(3, moves=moves)
    seen, infos, elapsed = batch.reset(), [], index("elapsed_time")
    for hold in range(moves * HOLDS):
        seen, _, done, infos = batch.step(np.zeros((3, 1), np.float32))
        assert done.all() == (hold == moves * HOLDS - 1) and done.any() == done.all()
        assert infos[0] == {} or done[0]
    assert (seen[:, elapsed] == 0).all()
    costs = base_run(3, moves).cost.reshape(moves, 3).sum(axis=0)
    for info, cost in zip(infos, costs, strict=True):
        assert info["TimeLimit.truncated"] is True and info["terminal_observation"] in batch.observation_space
        assert info["terminal_observation"][elapsed] == pytest.approx(1.8)
        assert (info["episode"]["l"], -info["episode"]["r"]) == (moves * EPISODE_STEPS, pytest.approx(cost))


def test_an_arm_that_leaves_within_a_hold():
    """Its reward ends with its episode, and the residual with it: the new one begins under the base alone."""
    batch, single = many(2, OUTWARD), single_env(OUTWARD)
    seen, infos, outward = batch.reset(), [], np.array([[1.0], [0.0]], np.float32)
    last, _ = single.reset(seed=30)
    terminated = False
    while not terminated:
        last, reward, terminated, *_ = single.step(outward[0])
        seen, rewards, done, infos = batch.step(outward)
        assert rewards[0] == np.float32(reward)
        assert done.tolist() == [terminated, False]
    info = infos[0]
    assert np.array_equal(info["terminal_observation"], last)
    assert info["TimeLimit.truncated"] is False
    samples = OUTWARD.hold - info["episode"]["l"] % OUTWARD.hold
    assert 0 < samples < OUTWARD.hold, "the arm should have left within a hold"
    arm: Any = single.unwrapped
    assert np.array_equal(seen[0], seen_by_base(arm, arm.reset()[0], samples))


@pytest.mark.parametrize(("count", "hold"), [(1, 4), (10, 7)])
def test_staggering_spreads_the_arms_over_the_episode(count: int, hold: int):
    batch = many(count, replace(SETTINGS, hold=hold), stagger=True)
    phases = np.sort(batch.reset()[:, index("elapsed_time")])
    gaps = np.diff(phases, append=phases[0] + 1.8)
    assert gaps == pytest.approx(np.full(count, 1.8 / count), abs=2 * hold * 0.0015)
    again = many(count, replace(SETTINGS, hold=hold), stagger=True)
    batch.seed(30)
    assert np.array_equal(batch.reset(), again.reset())


def test_staggered_arms_go_on_as_if_they_had_been_alone():
    batch = many(4, stagger=True)
    observations = batch.reset()
    steps = np.rint(observations[:, index("elapsed_time")] / 0.0015).astype(int)
    for arm in range(4):
        env = BeltArmEnv(**ARMS)
        move = dict(zip(env.move, batch.env.moves[arm], strict=True))
        seen, _ = env.reset(options={"params": asdict(batch.env.params[arm]), "move": move})
        assert np.array_equal(observations[arm], seen_by_base(env, seen, steps[arm]))


def test_spaces_and_protocol_of_the_library():
    batch = many(3)
    assert batch.observation_space == residual_observation_space() == single_env().observation_space
    assert batch.action_space == single_env().action_space
    assert batch.get_attr("sensors", indices=[0, 2]) == ["encoder"] * 2
    for call in (lambda: batch.set_attr("sensors", "tip"), lambda: batch.env_method("step")):
        refused(NotImplementedError, (), call)
    batch.close()
    batch.close()
    check_env(single_env(), warn=True, skip_render_check=True)
