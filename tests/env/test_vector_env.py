"""The batch: each arm is an environment alone, resets, and Gymnasium's rules."""

from collections.abc import Iterator
from functools import partial
from itertools import combinations
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from episodes import assert_as_alone, torques
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.vector.utils import batch_space
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from properties import examples

from baselines.reading import read
from beltarm_env import IDEAL_RANGES, TRAIN_RANGES, ArmParams, BeltArmEnv, BeltArmVectorEnv
from beltarm_env.arm import COLUMN, FIELDS
from beltarm_env.info import TOTALS
from beltarm_env.task.ranges import PRESLIDING

make = BeltArmVectorEnv
EACH_MODE = pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP], ids=lambda m: m.value)
MOVE = {"start": 0.3, "goal": 1.2, "duration": 1.0, "ramp_time": 0.3}


def random_actions(steps: int, count: int, seed: int = 0) -> NDArray[np.float32]:
    """Torques held for 60 samples, none in the first arm, the strongest in the last, shape (steps, count, 1)."""
    levels = np.random.default_rng(seed).uniform(-1, 1, (-(-steps // 60), count, 1))
    levels *= np.linspace(0, 1, count)[:, None]
    return np.repeat(levels, 60, axis=0)[:steps].astype(np.float32)


CASES: dict[AutoresetMode, dict[str, Any]] = {
    AutoresetMode.NEXT_STEP: {"num_envs": 1, "sensors": "full", "profile": "quintic", "moves": 2},
    AutoresetMode.SAME_STEP: {"num_envs": 5, "sensors": "tip", "randomization": "train", "delay": 1, "moves": 2},
    AutoresetMode.DISABLED: {"num_envs": 4, "encoder_counts": 1000, "max_episode_steps": 1500, "moves": 2},
}
STEPS = {AutoresetMode.NEXT_STEP: 2600, AutoresetMode.SAME_STEP: 3000, AutoresetMode.DISABLED: 2000}


def pruned(value: Any) -> Any:
    """Without what holds for no environment: Gymnasium leaves such keys out."""
    if not isinstance(value, dict):
        return value
    holding = {name for name in value if value[name if name[0] == "_" else f"_{name}"].any()}
    return {name: pruned(value[name]) for name in holding}


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


@pytest.mark.parametrize("mode", CASES, ids=lambda mode: mode.value)
def test_batch_is_bit_for_bit_gymnasiums_batch_of_single_environments(mode: AutoresetMode):
    case, batch = dict(CASES[mode]), make(autoreset_mode=mode, **CASES[mode])
    count = case.pop("num_envs")
    actions = random_actions(STEPS[mode], count)
    maker = partial(gym.make, "BeltArm-v0", disable_env_checker=True, **case)
    singles = SyncVectorEnv([maker] * count, autoreset_mode=mode)
    left = finished = 0
    both = zip(play(batch, actions, mode), play(singles, actions, mode), strict=True)
    for step, (ours, (*theirs, info)) in enumerate(both):
        over = theirs[2] | theirs[3] if step else np.zeros(count, np.bool_)
        theirs += [totals_at_ends(info, over, mode)]
        same = [data_equivalence(pruned(a), pruned(b), exact=True) for a, b in zip(ours, theirs, strict=True)]
        assert all(same), (step, same)
        left, finished = left + int(theirs[2].sum()), finished + int(theirs[3].sum())
    assert finished > 0 and (left > 0 or count == 1), "the actions should end episodes in both ways"


@examples(20, shrink=False)
@given(
    case=st.fixed_dictionaries(
        {
            "sensors": st.sampled_from(["encoder", "tip", "full", "accelerometer"]),
            "profile": st.sampled_from(["trapezoid", "scurve", "quintic"]),
            "model": st.sampled_from(["lumped", "lagrangian"]),
            "randomization": st.sampled_from(["off", "ideal", "train", {"payload_mass": (0.1, 0.5)}]),
            "encoder_counts": st.sampled_from([1000, 4000, 20_000]),
        }
    ),
    delays=st.lists(st.sampled_from([0.0, 1.0, 2.0]) | st.floats(0, 2), min_size=1, max_size=3),
    strength=st.floats(0.1, 2),
    seed=st.integers(0, 2**31),
)
def test_arms_of_any_batch_are_environments_alone_bit_for_bit(
    case: dict[str, Any], delays: list[float], strength: float, seed: int
):
    late, actions = np.array(delays), strength * random_actions(500, len(delays), seed)
    actions[:, 0] = 1.0  # which drives the first arm out of its workspace
    envs = make(len(delays), delay=late, autoreset_mode="SameStep", **case)
    late[:] = 0.0  # which the batch does not see
    assert assert_as_alone(envs, [BeltArmEnv(delay=delay, **case) for delay in delays], actions, seed) >= 1


def test_arms_behind_ideal_and_built_drives_in_any_place_of_a_large_batch_move_as_they_do_alone():
    rng, arms = np.random.default_rng(0), (0, 1, 2, 135, 136, 298, 299)  # a block has 136 lanes
    ranges = [IDEAL_RANGES, {name: pair for name, pair in TRAIN_RANGES.items() if name != "torque_ripple_order"}]
    ranges += [{**ranges[1], **PRESLIDING}, {"presliding_deflection": (3e-4, 2e-2)}]
    params = [{name: rng.uniform(*pair) for name, pair in ranges[arm % 4].items()} for arm in range(300)]
    columns = {name: [arm.get(name, getattr(ArmParams(), name)) for arm in params] for name in FIELDS}
    batch, alone = BeltArmVectorEnv(300), {arm: BeltArmEnv() for arm in arms}
    batch.reset(seed=5, options={"params": columns})
    for arm, env in alone.items():
        env.reset(seed=5 + arm, options={"params": params[arm]})
    for action in 0.3 * np.stack([torques(400, arm, hold=15) for arm in range(300)], axis=1):
        batch.step(action)
        for arm, env in alone.items():
            env.step(action[arm])
    for arm, env in alone.items():
        assert batch.state[arm].tobytes() == env.state.tobytes() and batch.motor_torques[arm] == env.motor_torque
        assert batch.params[arm] == env.params and batch.moves[arm].tolist() == [*env.move.values()]
        assert batch.params_table[arm].tolist() == [getattr(env.params, name) for name in FIELDS]
        assert np.transpose(batch.reference(0.2))[arm].tolist() == [*env.reference(0.2)]
    info, errors = batch.step(np.zeros((300, 1), np.float32))[4], batch.tip_errors()
    assert np.hypot(*errors[:, :2].T) == pytest.approx(info["tip_error"], rel=1e-12, abs=1e-15)
    assert np.minimum(np.hypot(*errors[:, 2:].T) / 0.2, 10) == pytest.approx(info["cost_velocity"], rel=1e-12)


class TestReset:
    def test_options_one_per_arm_and_one_for_all(self):
        envs, single = make(3, randomization="train"), BeltArmEnv(randomization="train")
        masses, goals = [0.0, 0.1, 0.4], [0.5, 0.9, 1.5]
        states = np.array([[10.0, 1.0, 0.01, 0.0], [50.0, 0.0, 0.0, 0.1], [80.0, 0.0, -0.01, 0.0]])
        options = {"params": {"payload_mass": masses, "hand_length": 0.2}, "move": {"goal": goals}, "state": states}
        observations, _ = envs.reset(seed=3, options=options)
        for arm in range(3):
            params, move = {"payload_mass": masses[arm], "hand_length": 0.2}, {"goal": goals[arm]}
            alone, _ = single.reset(seed=3 + arm, options={"params": params, "move": move, "state": states[arm]})
            assert np.array_equal(observations[arm], alone) and envs.params[arm] == single.params
            assert np.array_equal(envs.state[arm], single.state)
        assert read(observations, ArmParams()).holds_part.tolist() == [0.0, 1.0, 1.0]
        assert set(options) == {"params", "move", "state"}
        envs.reset(seed=3, options={"params": {"payload_mass": 0.3}, "move": MOVE, "state": states[0]})
        assert envs.params_table[:, COLUMN.payload_mass].tolist() == [0.3] * 3
        assert np.array_equal(envs.moves, [list(MOVE.values())] * 3) and np.array_equal(envs.state, [states[0]] * 3)
        free = make(3, randomization="train")
        free.reset(seed=3)
        assert np.array_equal(free.reset()[0], envs.reset()[0]), "options do not disturb the random streams"

    def test_mask_resets_and_seeds_those_arms_alone(self):
        envs = make(4, autoreset_mode="Disabled")
        observations, _ = envs.reset(seed=0)
        for action in random_actions(50, 4):
            observations, *_ = envs.step(action)
        states, moves, mask = envs.state, envs.moves, np.array([True, False, True, False])
        options = {"reset_mask": mask, "params": {"payload_mass": [0.1, 0.2]}}
        again, _ = envs.reset(options=options)
        assert np.array_equal(again[~mask], observations[~mask])
        assert np.array_equal(envs.state[~mask], states[~mask]) and np.array_equal(envs.moves[~mask], moves[~mask])
        assert (envs.moves[mask] != moves[mask]).any(axis=1).all()
        assert [arm.payload_mass for arm in envs.params] == [0.1, 0.0, 0.2, 0.0]
        assert options["reset_mask"] is mask and mask.tolist() == [True, False, True, False]
        seeded, _ = envs.reset(seed=40, options={"reset_mask": np.arange(4) == 1})
        assert np.array_equal(seeded[1], BeltArmEnv().reset(seed=41)[0]) and np.array_equal(seeded[2:], again[2:])
        plain = make(4)
        plain.reset(seed=0)
        assert np.array_equal(envs.reset()[0][3], plain.reset()[0][3]), "an arm that was not reset has its own stream"

    def test_without_autoreset_every_ended_arm_must_be_reset(self):
        envs = make(3, autoreset_mode="Disabled")
        envs.reset(seed=0, options={"move": MOVE})
        over = np.zeros(3, np.bool_)
        while not over.any():
            over = envs.step(np.array([[0], [1], [1]], np.float32))[2]
        assert over.tolist() == [False, True, True]
        for arm in (1, 2):
            with pytest.raises(ResetNeeded, match=f"arm {arm}"):
                envs.step(np.zeros((3, 1), np.float32))
            envs.reset(options={"reset_mask": np.arange(3) == arm})
        assert not envs.step(np.zeros((3, 1), np.float32))[2].any()

    def test_seeds_one_per_arm(self):
        envs, single = make(3), BeltArmEnv()
        observations, _ = envs.reset(seed=[7, 3, 100])
        assert np.array_equal(observations, [single.reset(seed=seed)[0] for seed in (7, 3, 100)])
        observations, _ = envs.reset(seed=[9, 3, None])
        expected = [single.reset(seed=9)[0], single.reset(seed=3)[0], (single.reset(seed=100), single.reset())[1][0]]
        assert np.array_equal(observations, expected), "an arm whose seed is None goes on with its own generator"
        starts = np.concatenate([make(4).reset()[0], make(4).reset()[0]])
        assert len(np.unique(starts, axis=0)) == 8, "unseeded arms differ"

    @pytest.mark.parametrize(
        ("randomization", "expected"),
        [
            *(("off", {}), ("ideal", IDEAL_RANGES), ("train", TRAIN_RANGES)),
            ({"payload_mass": (0.2, 0.5)}, {"payload_mass": (0.2, 0.5)}),
        ],
    )
    def test_ranges_are_covered_and_nothing_else_varies(self, randomization: Any, expected: dict[str, Any]):
        envs = make(2000, randomization=randomization)
        envs.reset(seed=0)
        for column, name in enumerate(FIELDS):
            drawn = envs.params_table[:, column]
            low, high = expected.get(name, (getattr(ArmParams(), name),) * 2)
            assert low <= drawn.min() <= low + 0.02 * (high - low)
            assert high - 0.02 * (high - low) <= drawn.max() <= high
        if randomization == "train":
            orders, counts = np.unique(envs.params_table[:, COLUMN.torque_ripple_order], return_counts=True)
            assert orders.tolist() == list(range(4, 13)) and (np.abs(counts / 2000 - 1 / 9) < 0.03).all()


def arrays(value: Any) -> Iterator[NDArray[Any]]:
    if isinstance(value, np.ndarray):
        yield value
    children = value.values() if isinstance(value, dict) else value
    if not isinstance(value, np.ndarray) or value.dtype == object:
        for child in () if children is None else children:
            yield from arrays(child)


class TestGymnasium:
    @EACH_MODE
    def test_spaces_and_mode(self, mode: AutoresetMode, monkeypatch: pytest.MonkeyPatch):
        # Gymnasium 1.2's own batches leave their mode in the class for later tests.
        monkeypatch.delitem(BeltArmEnv.metadata, "autoreset_mode", raising=False)
        envs, single = make(3, sensors="tip", autoreset_mode=mode.value), BeltArmEnv(sensors="tip")
        assert envs.single_observation_space == single.observation_space
        assert envs.single_action_space == single.action_space
        assert envs.observation_space == batch_space(single.observation_space, 3)
        assert envs.action_space == batch_space(single.action_space, 3)
        assert envs.metadata["autoreset_mode"] is mode and "autoreset_mode" not in BeltArmEnv.metadata
        assert (envs.num_envs, envs.render_mode) == (3, None)
        observations, info = envs.reset(seed=0)
        assert observations in envs.observation_space and info == {}
        envs.close()
        envs.close()

    @EACH_MODE
    def test_nothing_returned_shares_memory(self, mode: AutoresetMode):
        envs, actions = make(3, autoreset_mode=mode), np.array([[0.0], [2.0], [-3.0]])
        returned: list[Any] = [envs.reset(seed=0)]
        over = np.zeros(3, np.bool_)
        while not over.any():
            result = envs.step(actions)
            over = result[2] | result[3]
            returned = [*returned[-2:], result]
        returned += [envs.step(actions), envs.reset()]
        every = list(arrays(returned))
        assert len(every) > 30
        assert not [True for a, b in combinations(every, 2) if np.shares_memory(a, b)]
        assert actions.tolist() == [[0.0], [2.0], [-3.0]], "actions are left as they were"
