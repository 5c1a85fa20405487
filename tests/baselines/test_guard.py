"""The guard: its kernel under any input, its levels, its settings, and arms whose sensors or policies fail."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples
from refusals import refused

from agents.policy.bundle import POLICIES, load_controller
from agents.residual.controller import behind_guard
from baselines.guard import guard
from baselines.guard.controller import GuardedController, servo_for
from baselines.guard.encoder import UNSEEN
from baselines.guard.settings import GuardSettings
from baselines.registry import CONTROLLERS
from beltarm_env import CONTROL_PERIOD, ArmParams, design_model
from beltarm_env.rollout import record, rollout
from beltarm_env.task.ranges import TRAIN_RANGES
from eval.comparison.rollouts import Recorder
from eval.studies.guard.faults import FAULTS, FaultyArms

PARAMS = design_model()
LIMIT = PARAMS.torque_limit
DESIGN = GuardSettings().design(PARAMS, residual=0.5)
WAIT = DESIGN.wait
ANY = st.floats(allow_nan=True, allow_infinity=True)
ARMS: dict[str, Any] = {"randomization": TRAIN_RANGES, "seed": 4_900_100}


class Bench:
    def __init__(self, servo: float = -0.01) -> None:
        self.memory, self.command, self.servo = np.full(guard.GUARD_SIZE, np.nan), 0.0, servo
        self.begins = self.anew = True

    def step(
        self, base: float = 0.01, residual: float = 0.02, angle: float = 10.0, surprise: float = 0.9
    ) -> tuple[float, float]:
        """Command [N m] and level after a sample."""
        servo = self.servo if not self.begins and self.memory[guard.ASKS] != 0 else math.nan
        now = guard.GuardInputs(base, residual, servo, angle, surprise, self.command)
        self.command = guard.guarded_torque(DESIGN, now, self.begins, self.anew, self.memory)
        self.begins = self.anew = False
        return self.command, float(self.memory[guard.LEVEL])

    def steps(self, count: int, **given: float) -> tuple[float, float]:
        return [self.step(**given) for _ in range(count)][-1]


class TestKernel:
    @examples(60)
    @given(st.lists(st.tuples(ANY, ANY, ANY, ANY, ANY, ANY), min_size=1, max_size=40))
    def test_command_is_a_number_within_its_limits_whatever_comes_in(self, rows: list[tuple[float, ...]]):
        memory = np.full(guard.GUARD_SIZE, np.nan)
        for k, row in enumerate(rows):
            command = guard.guarded_torque(DESIGN, guard.GuardInputs(*row), k % 20 == 0, k == 0, memory)
            assert abs(command) <= LIMIT
            last = row[5] if math.isfinite(row[5]) else 0.0
            if abs(last) <= LIMIT:
                assert abs(command - last) <= DESIGN.slew * (1 + 1e-12)

    def test_nothing_changes_while_all_is_well_and_a_jump_is_slewed(self):
        bench = Bench()
        assert bench.steps(500) == (0.01 + 0.02, guard.LEARNED_LEVEL) and bench.memory[guard.CHANGED] == 0
        bench = Bench()
        bench.step(base=-0.3, residual=0.0)
        assert bench.step(base=0.3, residual=0.0)[0] == pytest.approx(-0.3 + DESIGN.slew)
        assert bench.memory[guard.CHANGED] == 1

    @pytest.mark.parametrize("bad", [math.nan, math.inf, 0.2])
    def test_residual_that_is_no_good_fades_out_and_returns(self, bad: float):
        bench = Bench()
        bench.steps(10)
        fade = round(0.05 / CONTROL_PERIOD)
        first, level = bench.step(residual=bad)
        assert level == guard.BASE_LEVEL and 0.028 < first < 0.03, "what was good last is faded out, without a jump"
        command, _ = bench.steps(fade, residual=bad)
        assert command == pytest.approx(0.01)
        assert bench.steps(WAIT - 1)[1] == guard.BASE_LEVEL
        assert bench.step()[1] == guard.LEARNED_LEVEL
        assert bench.steps(fade)[0] == pytest.approx(0.03)

    def test_every_further_fall_waits_longer(self):
        bench = Bench()
        bench.steps(2)
        for times in (1, 2, 4, 8, 8):
            bench.step(residual=math.nan)
            assert bench.steps(times * WAIT - 1)[1] == guard.BASE_LEVEL
            assert bench.step()[1] == guard.LEARNED_LEVEL

    def test_residual_at_its_limit_for_long(self):
        bench, limited = Bench(), {"base": -0.14, "residual": 0.15}
        assert bench.steps(DESIGN.longest_saturation, **limited)[1] == guard.LEARNED_LEVEL
        assert bench.step(**limited)[1] == guard.BASE_LEVEL

    @pytest.mark.parametrize("surprise", [7.0, 1.0, math.nan])
    def test_observer_that_knows_no_such_arm(self, surprise: float):
        bench = Bench()
        bench.steps(10)
        assert bench.step(surprise=surprise)[1] == guard.SERVO_LEVEL
        assert bench.steps(50, surprise=4.0)[0] == pytest.approx(-0.01), "the servo has it"
        assert bench.steps(2 * WAIT, surprise=4.0)[1] == guard.SERVO_LEVEL, "too surprised still"
        assert bench.steps(WAIT, surprise=2.0)[1] == guard.LEARNED_LEVEL

    def test_base_that_is_no_number(self):
        bench = Bench()
        bench.steps(10)
        assert bench.step(base=math.nan) == (0.03, guard.SERVO_LEVEL), "the last command is held"
        assert bench.step(base=math.nan)[0] == -0.01, "the servo's at once"
        bench = Bench(servo=math.nan)
        bench.steps(10)
        assert bench.step(base=math.nan) == (0.03, guard.SERVO_LEVEL)
        assert bench.steps(20, base=math.nan) == (0.0, guard.PASSIVE_LEVEL), "there is none that gives a number"

    def test_lost_sample_holds_the_command(self):
        bench, angle = Bench(), 10.0
        for k in range(200):
            angle += min(0.001 * k, 0.1)
            bench.step(angle=angle)
        assert bench.memory[guard.LEVEL] == guard.LEARNED_LEVEL
        before, _ = bench.step(angle=angle + 0.1)
        assert bench.step(base=-0.2, angle=angle + 0.1) == (before, guard.SERVO_LEVEL), "shown twice"
        assert bench.step(base=-0.2, angle=angle + 0.3)[0] == before, "its speed is no speed"
        assert bench.step(base=-0.2, angle=angle + 0.4)[0] < before
        bench.begins = True
        levels = [bench.step(angle=angle + 0.5 + 0.1 * k)[1] for k in range(9)]
        assert levels == [guard.LEARNED_LEVEL] * 9, "a move that begins while the motor turns"

    @pytest.mark.parametrize("torque", [0.2, -0.2])
    def test_motor_that_rests_under_a_large_torque(self, torque: float):
        bench = Bench()
        assert bench.steps(DESIGN.longest_rest, base=torque, residual=0.0)[1] == guard.LEARNED_LEVEL
        assert bench.steps(2, base=torque, residual=0.0)[1] == guard.PASSIVE_LEVEL
        assert bench.steps(20, base=torque, residual=0.0)[0] == 0
        assert bench.steps(3 * WAIT, base=0.0, residual=0.0)[1] == guard.PASSIVE_LEVEL, "for the rest of the move"
        bench.begins = True
        assert bench.step()[1] == guard.LEARNED_LEVEL
        bench.memory[guard.PASSIVE], bench.memory[UNSEEN], bench.begins = 1.0, DESIGN.longest_loss, True
        assert bench.step(angle=99.0) == (0.0, guard.PASSIVE_LEVEL), "no torque while the encoder is not believed"


@pytest.mark.parametrize("value", [0.0, math.nan, 2e6, True, "1"])
def test_settings_out_of_range_are_refused(value: Any):
    refused(ValueError, ("GuardSettings.slew", "1e+06"), lambda: GuardSettings(slew=value))


class TestInTheLoop:
    @pytest.mark.parametrize("name", ["paper", "flat"])
    def test_healthy_arms_move_as_without_it_alone_and_in_a_batch(self, name: str):
        plain, behind = rollout(CONTROLLERS[name](), 4, **ARMS), rollout(behind_guard(CONTROLLERS[name]()), 4, **ARMS)
        np.testing.assert_array_equal(plain.torque, behind.torque)
        alone = rollout(behind_guard(CONTROLLERS[name]()), 1, **{**ARMS, "seed": ARMS["seed"] + 2})
        np.testing.assert_array_equal(behind.torque[:, 2], alone.torque[:, 0])

    @pytest.mark.parametrize("fault", ["stuck encoder", "sign error"])
    def test_passive_where_the_encoder_lies(self, fault: str):
        arms = FaultyArms(4, fault, randomization=TRAIN_RANGES)
        recorder = Recorder(behind_guard(CONTROLLERS["flat"]()), lambda memory: memory.level)
        run, levels = record(recorder, arms, seed=ARMS["seed"]), np.array(recorder.notes)
        assert run.finished.all()
        for arm, onset in enumerate(arms.onset):
            assert (levels[:onset, arm] == guard.LEARNED_LEVEL).all()
            assert (levels[onset + 40 :, arm] == guard.PASSIVE_LEVEL).all()
            assert (run.torque[onset + 50 :, arm] == 0).all()

    def test_learned_policy_that_is_no_number_is_its_base(self):
        policy = load_controller(POLICIES / "ppo" / "seed0")
        policy.policy.predict = lambda seen, *_, **__: (np.full((len(seen), 1), np.nan, np.float32), None)  # type: ignore
        of_any_change = GuardSettings(slew=2.0)  # `adaptive` turns its torque about within a sample
        run = rollout(guarded := behind_guard(policy, of_any_change), 2, **ARMS)
        assert guarded.servo is not None
        base = rollout(policy.informed.base, 2, **ARMS)
        np.testing.assert_allclose(run.torque, base.torque, atol=1e-6)


def test_the_servo_is_the_tuned_one_for_the_arm_of_a_controller_that_needs_it():
    servos = {name: servo_for(make()) for name, make in CONTROLLERS.items()}
    assert {name for name, servo in servos.items() if servo} == {"lqg", "robust", "preview", "mpc", "adaptive"}
    geared = CONTROLLERS["preview"](params=ArmParams(gear_ratio=100.0))
    servo: Any = servo_for(geared)
    assert servo.gains == CONTROLLERS["flat"]().gains and servo.params == geared.params
    refused(ValueError, ("gear_ratio 100.0", "88"), lambda: GuardedController(geared, CONTROLLERS["flat"]()))
    for geared.profile in ("quintic", "Quintic"):
        refused(ValueError, ("trapezoid", repr(geared.profile)), lambda: GuardedController(geared, servo))


def test_faults_change_nothing_before_their_onset():
    healthy = record(CONTROLLERS["flat"](), FaultyArms(3, "none", randomization=TRAIN_RANGES), seed=5)
    for fault in FAULTS:
        arms = FaultyArms(3, fault, randomization=TRAIN_RANGES)
        run = record(CONTROLLERS["flat"](), arms, seed=5)
        for arm, onset in enumerate(arms.onset):
            np.testing.assert_array_equal(run.state[:onset, arm], healthy.state[:onset, arm], fault)
            if fault not in ("none", "NaN weights"):
                assert (run.state[-1, arm] != healthy.state[-1, arm]).any(), fault
