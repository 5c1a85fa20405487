"""Episodes of several moves: what goes on from move to move, what is new, and what is told of each."""

import copy
import pickle
from typing import Any

import numpy as np
import pytest
from episodes import torques
from numpy.typing import NDArray
from refusals import refused

from baselines.registry import CONTROLLERS
from beltarm_env import EPISODE_STEPS, BeltArmEnv, BeltArmVectorEnv
from beltarm_env.arm import COLUMN, FIELDS, params_table
from beltarm_env.info import MOVE_TOTALS
from beltarm_env.metrics import METRICS
from beltarm_env.observation import decode, index
from beltarm_env.physics.models import ModelName
from beltarm_env.rollout import rollout
from beltarm_env.simulation import ArmSimulation
from beltarm_env.task.cost import MAX_COST
from beltarm_env.task.ranges import PART_MASS, SHIFT_RANGES
from beltarm_env.task.shift import next_drift
from beltarm_env.timing import CONTROL_PERIOD, EPISODE_TIME

STILL = np.zeros(1, np.float32)
NEW = ("reference", "error", "start", "goal", "duration", "ramp_time", "elapsed_time", "holds_part")
"""Words in the names of observation entries that a new move changes."""
ELAPSED = index("elapsed_time")
FRICTION = [COLUMN.motor_viscous_friction, COLUMN.coulomb_friction]


def gentle(steps: int, seed: int = 0) -> NDArray[np.float32]:
    return 0.25 * torques(steps, seed, hold=15)


class TestContinuity:
    @pytest.mark.parametrize("sensors", ["tip", "accelerometer"])
    def test_the_first_move_is_the_episode_of_one_move_and_the_arm_goes_on_from_there(self, sensors: Any):
        settings: Any = {"sensors": sensors, "randomization": SHIFT_RANGES, "delay": 1.5}
        single, shift = BeltArmEnv(**settings), BeltArmEnv(moves=3, **settings)
        assert np.array_equal(single.reset(seed=4)[0], shift.reset(seed=4)[0])
        *both, ends = [(single.step(action), shift.step(action)) for action in gentle(EPISODE_STEPS)]
        for one, several in both:
            assert np.array_equal(one[0], several[0]) and one[1:] == several[1:]
        (last, *ended, _), (first, *goes_on, info) = ends
        assert ended[1:] == [False, True] and goes_on == [ended[0], False, False]
        assert np.array_equal(shift.state, single.state) and shift.motor_torque == single.motor_torque
        for name, value in decode(first, sensors).items():
            assert any(word in name for word in NEW) or value == decode(last, sensors)[name]
        seen = decode(first, sensors)
        assert (seen["elapsed_time"], shift.time, shift.move_number) == (0.0, 0.0, 1)
        assert shift.move["start"] == single.move["goal"] and shift.reference(0.0).angle == shift.move["start"]
        assert {*MOVE_TOTALS} <= {*info} and info["total_cost"] == info["move_cost"]

    @pytest.mark.parametrize("model", ["lumped", "lagrangian"])
    def test_an_arm_moves_as_its_equations_with_the_row_of_each_move(self, model: ModelName):
        """With commands on their way, motor torque and presliding handed on from move to move."""
        env = BeltArmEnv(model=model, randomization=SHIFT_RANGES, moves=3)
        env.reset(seed=7)
        state: Any = None
        for move in range(3):
            table = params_table([env.params])
            arm = ArmSimulation(env.params, model=model)
            state = arm.at_rest(np.array([env.state[0]])) if state is None else state
            for k, action in enumerate(gentle(EPISODE_STEPS, move)):
                arm.set_table(table, np.array([float(k)]))
                state = arm.advance(state, action.astype(np.float64) * table[:, COLUMN.torque_limit])
                env.step(action)
                assert np.array_equal(env.state, state[0, :4]), (move, k)
            assert env.motor_torque == state[0, 4]

    def test_noise_of_a_sensor_does_not_repeat_from_move_to_move(self):
        env = BeltArmEnv(sensors="accelerometer", moves=2, randomization={"coulomb_friction": (0.032, 0.032)})
        env.reset(seed=0)
        seen = np.array([env.step(STILL)[0][-1] for _ in range(2 * EPISODE_STEPS)])
        assert np.std(seen) > 0 and abs(np.corrcoef(seen[100:1100], seen[1300:2300])[0, 1]) < 0.2

    def test_a_copy_goes_on_over_the_end_of_a_move_as_the_original(self):
        settings: Any = {"moves": 2, "randomization": "train", "sensors": "tip", "delay": 1}
        for env in (BeltArmEnv(**settings), BeltArmVectorEnv(3, **settings)):
            shape = env.action_space.shape or ()
            env.reset(seed=1)
            for _ in range(EPISODE_STEPS - 5):
                env.step(np.zeros(shape, np.float32))
            twins: list[Any] = [copy.deepcopy(env), pickle.loads(pickle.dumps(env)), env]
            assert all(getattr(twin, name) == getattr(env, name) for twin in twins for name in list(settings)[1:])
            for _ in range(10):
                seen = [twin.step(np.full(shape, 0.1, np.float32))[0].tobytes() for twin in twins]
                assert len({*seen}) == 1
            assert len({(twin.state.tobytes(), twin.reset()[0].tobytes()) for twin in twins}) == 1


class TestDraws:
    def test_parts_friction_and_moves_of_a_long_shift(self):
        moves, ranges = 12, {**SHIFT_RANGES, "friction_drift": (-0.2, 0.2)}
        env = BeltArmVectorEnv(40, moves=moves, randomization=ranges)
        env.reset(seed=0)
        tables, tasks = list[Any](), list[Any]()
        for k in range(moves):
            tables, tasks = [*tables, env.params_table], [*tasks, env.moves]
            assert env.move_numbers.tolist() == [k] * 40
            for _ in range(EPISODE_STEPS):
                env.step(np.zeros((40, 1), np.float32))
        table, task = np.stack(tables), np.stack(tasks)
        assert np.array_equal(task[1:, :, 0], task[:-1, :, 1]), "each move starts at the last goal"
        assert len(np.unique(task[:, :, 2])) == moves * 40
        assert not table[1::2, :, COLUMN.payload_mass].any()
        masses = table[::2, :, COLUMN.payload_mass]
        assert len(np.unique(masses)) == masses.size and PART_MASS[0] <= masses.min() and masses.max() <= PART_MASS[1]
        assert masses.mean() == pytest.approx(np.mean(PART_MASS), rel=0.08)
        drift = table[:, :, COLUMN.friction_drift]
        for column in FRICTION:
            assert np.allclose(table[1:, :, column], table[:-1, :, column] * (1 + drift[:-1]), rtol=1e-15)
        level = table[:, :, COLUMN.coulomb_friction] / table[0, :, COLUMN.coulomb_friction]
        ends = level * (1 + drift)
        assert 0.8 - 1e-12 <= ends.min() < 0.82 and 1.22 < ends.max() <= 1.25 + 1e-12
        assert (drift > 0).any() and (drift < 0).any() and np.abs(drift).max() <= 0.2
        same = [k for k in range(len(FIELDS)) if k not in (*FRICTION, COLUMN.payload_mass, COLUMN.friction_drift)]
        assert (table[:, :, same] == table[0][:, same]).all()

    @pytest.mark.parametrize(
        ("randomization", "masses"),
        [
            *((word, PART_MASS) for word in ("off", "ideal", "train")),
            *(({"payload_mass": (0.1, 0.2)}, (0.1, 0.2)), ({"arm_inertia": (0.009, 0.011)}, (0.0, 0.0))),
        ],
    )
    def test_what_parts_weigh(self, randomization: Any, masses: tuple[float, float]):
        env = BeltArmVectorEnv(200, moves=2, randomization=randomization)
        env.reset(seed=0)
        loads = env.params_table[:, COLUMN.payload_mass]
        assert masses[0] <= loads.min() <= loads.max() <= masses[1] <= 1.1 * loads.max()
        env.reset(seed=0, options={"params": {"payload_mass": 0.3}})
        assert (env.params_table[:, COLUMN.payload_mass] == 0.3).all()

    def test_friction_that_drifts_far_comes_back_and_a_drift_may_be_the_first_effect_of_a_drive(self):
        env = BeltArmEnv(moves=3, randomization={"friction_drift": (-0.5, 0.5)})
        env.reset(seed=0, options={"params": {"friction_drift": 0.5}})
        found = []
        for _ in range(2):
            for _ in range(EPISODE_STEPS):
                env.step(STILL)
            found.append((env.params.coulomb_friction / 0.032, env.params.friction_drift))
        (level, drift), (_, last) = found
        assert level == pytest.approx(1.5) and 0.8 - 1e-12 <= level * (1 + drift) <= 1.25 + 1e-12 and last != drift
        assert next_drift(0.1, 0.5) == 0.5
        env.reset(seed=0, options={"params": {"friction_drift": 0.0}})
        for k in range(EPISODE_STEPS + 1):
            assert env._batch.real_drive is (None if k < EPISODE_STEPS else True)
            env.step(np.full(1, 0.01, np.float32))
            assert env.motor_torque == pytest.approx(0.003)

    def test_arms_that_a_shift_makes_too_fast_are_refused(self):
        for viscous, drift in ((1.9, 0.0), (1.5, 0.45)):
            arm = {"motor_viscous_friction": viscous, "friction_drift": drift}
            ranges = {name: (value, value) for name, value in arm.items()}
            BeltArmEnv(randomization=ranges)
            refused(ValueError, ("rad/s",), lambda ranges=ranges: BeltArmEnv(randomization=ranges, moves=2))
            BeltArmEnv().reset(options={"params": arm})
            refused(ValueError, ("rad/s",), lambda arm=arm: BeltArmEnv(moves=2).reset(options={"params": arm}))


class TestTotals:
    def test_what_is_told_of_each_move_is_what_happened_in_it(self):
        env, costs = BeltArmVectorEnv(6, moves=3, randomization="train"), []
        controller, memory, start = CONTROLLERS["preview"](), None, np.ones(6, np.bool_)
        observation, info = env.reset(seed=2)
        for move in range(3):
            duration, errors, rewards = env.moves[:, 2], [], []
            for k in range(EPISODE_STEPS):
                action, memory = controller.predict(observation, memory, start)
                observation, reward, _, truncated, info = env.step(action)
                errors, rewards, start = [*errors, env.tip_errors()[:, :2]], [*rewards, reward], np.zeros(6, np.bool_)
                ended = k == EPISODE_STEPS - 1
                assert ("move_cost" in info) == ended and truncated.all() == (ended and move == 2)
            error, time = np.array(errors), CONTROL_PERIOD * np.arange(1, EPISODE_STEPS + 1)
            distance = np.hypot(*error.transpose(2, 0, 1))
            assert info["_move_cost"].all() and info["move_cost"] == pytest.approx(-np.sum(rewards, axis=0), rel=1e-12)
            assert info["move_tip_error_rms"] == pytest.approx(np.sqrt(np.mean(distance**2, axis=0)), rel=1e-12)
            assert info["move_tip_error_max"] == pytest.approx(distance.max(axis=0), rel=1e-12)
            for arm in range(6):
                after = error[time >= duration[arm], arm]
                assert info["move_vibration"][arm] == pytest.approx(np.ptp(after, axis=0).max(), rel=1e-9)
                away = np.flatnonzero(distance[:, arm] > 0.0005)[-1]
                still = min((away + 2) * CONTROL_PERIOD, EPISODE_TIME) - duration[arm]
                assert info["move_still_time"][arm] == pytest.approx(max(still, 0.0), abs=1e-12)
            costs.append(info["move_cost"])
        assert info["total_cost"] == pytest.approx(np.sum(costs, axis=0), rel=1e-12)
        assert info["episode_steps"].tolist() == [3600] * 6
        assert len(np.unique(info["move_still_time"])) > 2


class TestRecordings:
    def test_columns_are_arms_and_moves_as_they_are_when_stepped(self):
        controller, moves, seed = CONTROLLERS["paper"](), 3, 5
        run = rollout(controller, 2, seed=seed, moves=moves, randomization="train", model="lagrangian")
        assert (run.num_arms, run.num_moves, run.state.shape) == (2, moves, (EPISODE_STEPS, 2 * moves, 4))
        for arm in range(2):
            env = BeltArmEnv(moves=moves, randomization="train", model="lagrangian")
            observation, _ = env.reset(seed=seed + arm)
            memory: Any = None
            for k in range(moves):
                column = 2 * k + arm
                assert run.params[column].tolist() == env.params.row().tolist()
                assert run.moves[column].tolist() == [*env.move.values()]
                limit, info = env.params.torque_limit, {}
                for row in range(EPISODE_STEPS):
                    action, memory = controller.predict(observation[None], memory)
                    observation, *_, info = env.step(action[0])
                    assert np.array_equal(run.state[row, column], env.state)
                    assert run.torque[row, column] == limit * float(action[0, 0])
                assert run.cost[column] == pytest.approx(info["move_cost"], rel=1e-12)
        metrics, third, second = run.metrics(), run.arm(1), run.of_move(2)
        assert {*metrics} == {*METRICS}
        for name, values in metrics.items():
            assert np.array_equal(third.metrics()[name], values[1::2])
            assert np.array_equal(second.metrics()[name], values[4:])
        assert np.array_equal(run.in_turn(run.state), np.concatenate([run.of_move(k).state for k in range(moves)]))
        assert (third.num_arms, third.num_moves, second.num_arms, second.num_moves) == (1, moves, 2, 1)
        refused(IndexError, ("there are",), lambda: run.of_move(3))
        pytest.importorskip("pandas")
        frame = run.to_pandas()
        assert frame.groupby(["move", "arm"]).size().tolist() == [EPISODE_STEPS] * 6
        of_one = frame[(frame["arm"] == 1) & (frame["move"] == 2)]
        assert np.array_equal(of_one["motor_angle"], run.state[:, 5, 0])

    def test_an_arm_that_leaves_stays_where_it_left_and_the_moves_that_it_misses_cost_the_most(self):
        class Outward:
            def predict(self, observation: Any, state: Any = None, *_: Any, **__: Any) -> tuple[Any, Any]:
                step = 0 if state is None else state + 1
                action = np.zeros((len(observation), 1), np.float32)
                action[0] = step > 1300
                return action, step

        run = rollout(Outward(), 2, seed=3, moves=4)
        assert run.finished.tolist() == [True, True, False, True, False, True, False, True]
        assert run.cost[[4, 6]].tolist() == [MAX_COST * EPISODE_STEPS] * 2
        assert run.cost[2] < MAX_COST * EPISODE_STEPS and "1 left" in repr(run)
        end = run.state[-1, 2]
        assert (run.state[:, [4, 6]] == end).all() and not run.torque[:, [4, 6]].any()
        assert np.array_equal(run.params[[4, 6]], run.params[[2, 2]])


@pytest.mark.parametrize("name", ["paper", "preview"])
def test_a_controller_begins_anew_with_each_move(name: str):
    class Forgetful:
        params = CONTROLLERS[name]().params

        def predict(self, observation: Any, state: Any = None, *_: Any, **__: Any) -> tuple[Any, Any]:
            if observation[0, ELAPSED] == 0:
                self.controller, state = CONTROLLERS[name](), None
            return self.controller.predict(observation, state)

    settings: dict[str, Any] = {"seed": 3, "moves": 2, "randomization": "train"}
    runs = [rollout(controller, 2, **settings) for controller in (CONTROLLERS[name](), Forgetful())]
    assert np.array_equal(runs[0].torque, runs[1].torque)
