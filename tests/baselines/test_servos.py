"""Servo-type controllers: the paper's retuned, PID along smooth and shaped moves, and the disturbance observer."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields, replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from scipy.signal import lsim

from baselines.models.friction import (
    FrictionGains,
    commanded_direction,
    dry_friction,
    friction_level,
    smooth_direction,
)
from baselines.models.linear import turning_load
from baselines.models.modes import Mode, held_mode
from baselines.models.ramps import Ramps, motion_at
from baselines.models.rigid_arm import inertia_at, rigid_torque
from baselines.reading import read, sample_of
from baselines.servo.adrc import AdrcController, AdrcGains
from baselines.servo.disturbance import FAST_LOAD, KNOWN, LOAD, DisturbanceController, DisturbanceGains
from baselines.servo.flat import FlatController, FlatGains
from baselines.servo.paper import TORSION, TORSION_RATE, PaperController
from baselines.servo.pid import INTEGRAL, MOST_RAMPS, PidGains
from baselines.servo.retuned import RetunedController, RetunedGains
from baselines.servo.shaping import (
    GAINS,
    ExtraInsensitiveGains,
    Kind,
    ShapingController,
    ShapingGains,
    plan_shaped,
    shares_of,
    write_impulses,
)
from baselines.servo.smooth import SmoothController, SmoothGains, plan_smooth
from beltarm_env import CONTROL_PERIOD, ArmParams, BeltArmVectorEnv, observation, state_space
from beltarm_env.rollout import Recording, rollout
from beltarm_env.task.reference import SCURVE, TRAPEZOID, MoveShape, Reference, reference_at

NOMINAL = ArmParams()
SERVOS: dict[str, Callable[..., Any]] = {
    "retuned": RetunedController,
    "smooth": SmoothController,
    "zv": partial(ShapingController, kind="zv"),
    "zvd": partial(ShapingController, kind="zvd"),
    "ei": partial(ShapingController, kind="ei"),
    "flat": FlatController,
    "disturbance": DisturbanceController,
    "adrc": AdrcController,
}
ALL_GAINS = (RetunedGains, SmoothGains, ShapingGains, ExtraInsensitiveGains, FlatGains, DisturbanceGains, AdrcGains)
MOVES = np.radians([(0, 90), (90, 0), (10, 30), (30, 10), (45, 90), (90, 60), (0, 45), (20, 80)])


def over_the_range(controller: Any, **settings: Any) -> Recording:
    """Moves all over the workspace, each in a time that its length allows."""
    start, goal = MOVES.T
    duration = 0.6 + 0.3 * np.abs(goal - start)
    move = {"start": start, "goal": goal, "duration": duration, "ramp_time": 0.3 * duration}
    return rollout(controller, len(MOVES), seed=5_000_000, options={"move": move, **settings})


def observations(count: int = 5, steps: int = 250, seed: int = 5_000_000) -> np.ndarray:
    """What a few arms observe under random torques, shape (steps, count, size)."""
    env = BeltArmVectorEnv(count, randomization="ideal")
    seen = [env.reset(seed=seed)[0]]
    torques = np.random.default_rng(0).uniform(-0.4, 0.4, (steps, count, 1)).repeat(10, axis=0)[:steps]
    seen += [env.step(torque)[0] for torque in torques]
    return np.stack(seen)


def planned(controller: SmoothController | ShapingController, move: np.ndarray) -> Ramps:
    """Ramps of a controller for one move: start, goal, duration, ramp time."""
    ramps = Ramps(*np.zeros((3, MOST_RAMPS)))
    plan = plan_smooth if isinstance(controller, SmoothController) else plan_shaped
    plan(controller.kernel().design, MoveShape(*move), ramps)
    count = np.count_nonzero(ramps.speed)
    return Ramps(*(part[:count] for part in ramps))


def along(ramps: Ramps, start: float, time: float, smooth: bool = False) -> Reference:
    """Motion along all of some ramps."""
    return motion_at(ramps, len(ramps.speed), smooth, start, time)


def shaper(kind: Kind, mode: Mode, vibration: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Weights and delays of a shaper's impulses."""
    shares = shares_of(kind, vibration)
    ramps = Ramps(*np.zeros((3, len(shares))))
    write_impulses(shares, mode, 0, ramps)
    return ramps.speed, ramps.onset


def residual(weights: np.ndarray, delays: np.ndarray, frequency: float, zeta: float) -> float:
    """Amplitude an oscillator is left with after a sequence of impulses, over that after a single one, by SciPy."""
    damped = frequency * math.sqrt(1 - zeta**2)
    modal = [[-zeta * frequency, damped], [-damped, -zeta * frequency]]  # amplitude = length of the state
    state = np.zeros(2)
    for k, weight in enumerate(weights):
        state = state + np.array([0.0, weight])
        if k + 1 < len(delays):
            time = np.linspace(0.0, delays[k + 1] - delays[k], 3)
            _, _, path = lsim((modal, np.zeros((2, 1)), np.eye(2), np.zeros((2, 1))), np.zeros(3), time, state)
            state = path[-1]
    return float(np.linalg.norm(state))


class TestEveryServo:
    @pytest.mark.parametrize("name", SERVOS)
    def test_stabilises_the_nominal_arm_over_the_whole_range(self, name: str):
        run = over_the_range(SERVOS[name]())
        assert run.finished.all() and np.isfinite(run.state).all()
        joint_error = run.state[-1, :, 0] / 88 - MOVES[:, 1]
        assert np.abs(joint_error).max() < math.radians(1.0)
        assert np.abs(run.state[-200:, :, 2]).max() < 0.06  # and the belt rings no more than stiction hides

    @pytest.mark.parametrize("name", SERVOS)
    def test_does_better_than_the_paper(self, name: str):
        """On the nominal arm, or, by what its margins leave of its gain, on the arms that they are for."""
        arms = "train" if name in ("retuned", "disturbance") else "off"
        makers = (PaperController, SERVOS[name])
        runs = [rollout(make(), 64, seed=5_000_000, randomization=arms) for make in makers]
        paper, servo = (run.metrics() for run in runs)
        if name == "smooth":  # which does not even try to follow the task's profile closely
            assert np.median(servo["residual_pp_mm"]) < 0.4 * np.median(paper["residual_pp_mm"])
        else:
            assert np.median(servo["cost"]) < 0.9 * np.median(paper["cost"])

    @pytest.mark.parametrize("name", SERVOS)
    def test_batch_is_so_many_single_controllers_bit_for_bit(self, name: str):
        seen, controller = observations(), SERVOS[name]()
        batch: Any = None
        single: list[Any] = [None] * 5
        for k, step in enumerate(seen):
            starts = np.array([k == 0, k in (0, 7), k == 0, k in (0, 100), k == 0])
            actions, batch = controller.predict(step, batch, starts)
            for arm in range(5):
                action, single[arm] = controller.predict(step[arm : arm + 1], single[arm], starts[arm : arm + 1])
                np.testing.assert_array_equal(action[0], actions[arm])
                np.testing.assert_array_equal(single[arm][0], batch[arm])

    @pytest.mark.parametrize("name", SERVOS)
    def test_nothing_leaks_from_episode_to_episode(self, name: str):
        controller, memory, fresh = SERVOS[name](), None, None
        for step in observations():
            _, memory = controller.predict(step, memory)
        for k, step in enumerate(observations(seed=5_100_000)):
            start = np.full(5, k == 0)
            used, memory = controller.predict(step, memory, start)
            new, fresh = controller.predict(step, fresh, start)
            np.testing.assert_array_equal(used, new)

    @pytest.mark.parametrize("name", SERVOS)
    def test_memory_is_returned_not_changed(self, name: str):
        seen, controller = observations(steps=20), SERVOS[name]()
        memory = None
        for step in seen[:-1]:
            _, memory = controller.predict(step, memory)
        assert memory is not None
        before = memory.copy()
        first, _ = controller.predict(seen[-1], memory)
        second, _ = controller.predict(seen[-1], memory)
        np.testing.assert_array_equal(first, second)
        np.testing.assert_array_equal(before, memory)
        assert memory.shape == (5, controller.memory_size)

    @pytest.mark.parametrize("name", SERVOS)
    def test_kernel_is_the_law_of_one_arm(self, name: str):
        controller = SERVOS[name]()
        law, design, row = controller.kernel()
        row[:], memory = np.nan, None
        for k, seen in enumerate(observations(count=1, steps=30)):
            reading = read(seen, controller.params)
            torque, memory = controller.law(reading, np.array([k == 0]), memory)
            assert law(design, sample_of(reading, 0), k == 0, row) == torque[0]

    @pytest.mark.parametrize("name", SERVOS)
    def test_answers_with_actions(self, name: str):
        controller, memory = SERVOS[name](), None
        for step in observations(steps=40):
            action, memory = controller.predict(step, memory)
            assert action.shape == (5, 1) and action.dtype == np.float32 and np.abs(action).max() <= 1

    @pytest.mark.parametrize("name", SERVOS)
    def test_refuses_observations_of_another_shape(self, name: str):
        controller = SERVOS[name]()
        for shape in ((observation.size(),), (3, observation.size() - 1)):
            with pytest.raises(ValueError, match="observations must have shape"):
                controller.predict(np.zeros(shape, np.float32))

    @pytest.mark.parametrize("kind", ALL_GAINS)
    def test_refuses_gains_out_of_range(self, kind: type[FrictionGains]):
        for gain in fields(kind):
            for value in (gain.metadata["low"] - 1, gain.metadata["high"] + 1, math.nan, math.inf):
                with pytest.raises(ValueError, match=rf"{kind.__name__}\.{gain.name} must lie within"):
                    kind(**{gain.name: value})
            words: dict[str, Any] = {gain.name: "1"}
            with pytest.raises(TypeError, match=f"{gain.name} must be a number"):
                kind(**words)

    @pytest.mark.parametrize("kind", ALL_GAINS)
    def test_gains_lie_well_within_their_range(self, kind: type[FrictionGains]):
        for gain in fields(kind):
            assert gain.metadata["low"] < gain.default < gain.metadata["high"], gain.name


class TestComputedTorque:
    @pytest.mark.parametrize("angle", [0.0, 0.7, math.pi / 2])
    def test_makes_the_rigid_arm_accelerate_as_wanted(self, angle: float):
        # Lagrange for T = (G^2 M_a1 + M2) theta_1'^2 / 2, with dM2/dtheta_1 by differencing.
        speed, acceleration, h = 2.0, 7.0, 1e-5
        m2 = [0.01 + 0.06 * math.sin(angle + step) ** 2 for step in (-h, 0, h)]
        joint_torque = (88**2 * 6.3e-5 + m2[1]) * acceleration + 0.5 * (m2[2] - m2[0]) / (2 * h) * speed**2
        found = rigid_torque(Reference(angle, speed, acceleration), NOMINAL.plant())
        np.testing.assert_allclose(88 * found, joint_torque, rtol=1e-8)

    def test_payload_swings_with_the_links(self):
        plant = ArmParams(payload_mass=0.2).plant()
        np.testing.assert_allclose(turning_load(0.0, 1.0, plant), [0.01, 0.0])
        np.testing.assert_allclose(turning_load(math.pi / 2, 1.0, plant), [0.07 + 0.25 * 0.2, 0.0], atol=1e-15)


class TestFriction:
    def test_level_falls_from_breakaway_to_coulomb_friction(self):
        friction = dry_friction(ArmParams(static_friction_excess=0.4, stribeck_speed=5.0).row())
        found = [friction_level(friction, speed) for speed in (0.0, 5.0, -5.0, 1e6)]
        np.testing.assert_allclose(found, [0.032 * 1.4, 0.032 * 1.2, 0.032 * 1.2, 0.032])

    def test_direction_goes_through_zero_on_a_ramp_of_speed_and_torque(self):
        speed, torque = (
            np.array([0.0, 0.0, 0.0, 0.5, 9.0, 0.5, -9.0]),
            np.array([0.0, 0.01, -9.0, 0.0, -0.01, -0.01, 0.0]),
        )
        found = [smooth_direction(*asked, 1.0, 0.02) for asked in zip(speed, torque, strict=True)]
        np.testing.assert_allclose(found, [0, 0.5, -1, 0.5, 1, 0, -1])

    def test_direction_is_commanded_while_moving_and_pushed_at_rest(self):
        speed, acceleration = np.array([2.0, -0.1, 0.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.0, 5.0, 0.0, 0.0, 0.0])
        push = np.array([-9.0, 9.0, -9.0, 9.0, -0.005, 0.0])
        speed[5] = 1e-16  # rests, but for rounding
        wanted = [Reference(0.0, *motion) for motion in zip(speed, acceleration, strict=True)]
        found = [commanded_direction(*case, 0.01) for case in zip(wanted, push, strict=True)]
        np.testing.assert_allclose(found, [1, -1, 1, 1, -0.5, 0])

    def test_compensation_ends_the_stuck_motors_error(self):
        # Stiction would hold a PD of K_p = 50 up to tau_c / (M_a1 K_p) = 10 rad from its goal.
        errors = {}
        for share in (0.0, 0.95):
            run = over_the_range(RetunedController(RetunedGains(angle=50.0, friction=share)))
            errors[share] = np.abs(run.state[-1, :, 0] - 88 * MOVES[:, 1])
        assert np.median(errors[0.0]) > 2.0
        assert np.median(errors[0.95]) < 0.25 * np.median(errors[0.0])


class TestRetuned:
    def test_torque_is_equation_11(self):
        p, gains = NOMINAL, RetunedGains(torsion_speed=0.2, angle=30.0, speed=15.0, friction=1.0)
        controller, memory = RetunedController(gains, NOMINAL), None
        for seen in observations(steps=60):
            action, memory = controller.predict(seen, memory)
            now = read(seen, p)
            u_1 = 88 * now.reference_acceleration + 15 * (88 * now.reference_speed - now.motor_speed)
            u_1 += 30 * (88 * now.reference_angle - now.motor_angle)
            sine, cosine = np.sin(now.reference_angle), np.cos(now.reference_angle)
            inertia = 6.3e-5 + (0.01 + 0.06 * sine**2) / 88**2
            torque = inertia * u_1 + 0.06 * sine * cosine * now.reference_speed**2 / 88 + 3.5e-4 * now.motor_speed
            torque += 0.032 * np.sign(now.reference_speed) - 0.2 * memory[:, TORSION_RATE]
            moving = now.reference_speed != 0
            assert moving.all() or now.step[0] == 0
            np.testing.assert_allclose(action[moving, 0], np.clip(torque / 0.3, -1, 1)[moving], atol=1e-6)

    def test_torsion_is_simulated_as_the_paper_does(self):
        retuned, paper, of_retuned, of_paper = RetunedController(None, NOMINAL), PaperController(), None, None
        for k, seen in enumerate(observations()):
            start = np.array([k in (0, 40), k == 0, k == 0, k == 0, k == 0])
            _, of_retuned = retuned.predict(seen, of_retuned, start)
            _, of_paper = paper.predict(seen, of_paper, start)
            for entry in (TORSION, TORSION_RATE):
                np.testing.assert_allclose(of_retuned[:, entry], of_paper[:, entry], rtol=1e-4, atol=1e-9)


class TestRamps:
    @pytest.mark.parametrize(("profile", "smooth"), [(TRAPEZOID, False), (SCURVE, True)])
    def test_two_ramps_are_the_environments_profile(self, profile: int, smooth: bool):
        move = MoveShape(0.3, 1.4, 0.8, 0.2)
        cruise = 1.1 / 0.6
        ramps = Ramps(np.array([0.0, 0.6]), np.array([0.2, 0.2]), np.array([cruise, -cruise]))
        for time in np.linspace(0.0, 0.95, 78):
            np.testing.assert_allclose(along(ramps, 0.3, time, smooth), reference_at(profile, move, time), atol=1e-12)


class TestSmooth:
    def test_moves_from_start_to_goal_in_the_tasks_time(self):
        moves = read(observations(count=40, steps=1)[0], NOMINAL).move
        for move in moves:
            ramps, (start, goal, duration, _) = planned(SmoothController(), move), move
            arrived = along(ramps, start, duration, smooth=True)
            np.testing.assert_allclose(arrived[:2], [goal, 0], atol=1e-12)
            assert (ramps.onset >= 0).all() and (ramps.onset + ramps.time <= duration + 1e-12).all()

    def test_default_ramp_leaves_the_mode_at_rest(self):
        period = 2 * math.pi / 30
        time = np.linspace(0, 1.43 * period, 20_001)
        u = time / time[-1]
        _, _, state = lsim(([[0, 30], [-30, 0]], [[0], [30]], np.eye(2), np.zeros((2, 1))), 6 * u * (1 - u), time)
        assert np.linalg.norm(state[-1]) < 1e-3


class TestShaper:
    @pytest.mark.parametrize("zeta", [0.0, 0.02, 0.1])
    def test_impulses_are_the_closed_forms(self, zeta: float):
        root = math.sqrt(1 - zeta**2)
        half, k = math.pi / (20 * root), math.exp(-math.pi * zeta / root)
        mode = Mode(2 * half, k)
        closed: dict[Kind, list[float]] = {
            "zv": [1, k],
            "zvd": [1, 2 * k, k * k],
            "ei": [1.1, 1.8 * k, 1.1 * k * k],
        }
        for kind, shares in closed.items():
            weights, delays = shaper(kind, mode, 0.1)
            np.testing.assert_allclose(weights, np.array(shares) / sum(shares), rtol=1e-14)
            np.testing.assert_allclose(delays, half * np.arange(len(shares)), rtol=1e-14)

    @pytest.mark.parametrize("zeta", [0.0, 0.02, 0.1])
    @pytest.mark.parametrize("kind", ["zv", "zvd"])
    def test_matched_oscillator_is_left_at_rest(self, kind: Kind, zeta: float):
        root = math.sqrt(1 - zeta**2)
        mode = Mode(2 * math.pi / (20 * root), math.exp(-math.pi * zeta / root))
        weights, delays = shaper(kind, mode)
        assert residual(weights, delays, 20.0, zeta) < 1e-12

    def test_zvd_and_ei_forgive_a_wrong_frequency(self):
        mode = Mode(2 * math.pi / 20, 1.0)
        left = {}
        for kind in GAINS:
            weights, delays = shaper(kind, mode, 0.05)
            left[kind] = max(residual(weights, delays, 20.0 * off, 0.0) for off in (0.88, 1.12))
        assert left["zvd"] < 0.25 * left["zv"] and left["ei"] < left["zvd"]

    @pytest.mark.parametrize("limit", [0.02, 0.05, 0.2])
    def test_ei_reaches_its_limit_at_the_mode_and_zero_on_both_sides(self, limit: float):
        weights, delays = shaper("ei", Mode(2 * math.pi / 20, 1.0), limit)
        assert residual(weights, delays, 20.0, 0.0) == pytest.approx(limit)
        # At a frequency w the three impulses sum up to |(1 + V) cos(pi w / w_0) + 1 - V| / 2.
        zero = math.acos(-(1 - limit) / (1 + limit)) / math.pi
        for off in (zero, 2 - zero):
            assert residual(weights, delays, 20.0 * off, 0.0) < 1e-12
        between = [residual(weights, delays, 20.0 * off, 0.0) for off in np.linspace(zero, 2 - zero, 41)]
        assert max(between) == pytest.approx(limit)

    def test_ei_with_damping_stays_below_its_limit(self):
        root = math.sqrt(1 - 0.03**2)
        mode = Mode(2 * math.pi / (20 * root), math.exp(-math.pi * 0.03 / root))
        weights, delays = shaper("ei", mode, 0.05)
        assert 0.03 < residual(weights, delays, 20.0, 0.03) <= 0.05

    @pytest.mark.parametrize("degrees", [0, 45, 90])
    def test_mode_is_that_of_the_linear_arm_with_its_motor_held(self, degrees: int):
        angle = math.radians(degrees)
        a, _, _ = state_space(replace(NOMINAL, motor_inertia=1e6), angle)
        (pole,) = (value for value in np.linalg.eigvals(a) if value.imag > 1)
        mode = held_mode(angle, NOMINAL.plant())
        assert mode.period == pytest.approx(2 * math.pi / pole.imag, rel=1e-6)
        assert mode.decay == pytest.approx(math.exp(math.pi * pole.real / pole.imag), rel=1e-6)


class TestShapedMoves:
    @pytest.mark.parametrize("kind", GAINS)
    def test_plan_is_causal_and_reaches_the_goal(self, kind: Kind):
        moves = read(observations(count=60, steps=1)[0], NOMINAL).move
        controller = ShapingController(kind=kind)
        for move in moves:
            ramps, (start, goal, _, _) = planned(controller, move), move
            assert (ramps.onset >= 0).all() and (ramps.time > 0).all()
            np.testing.assert_allclose(along(ramps, start, 1.8)[:2], [goal, 0], atol=1e-12)

    def test_where_ramps_are_long_enough_there_is_no_delay(self):
        # At 0 and 20 degrees half a period is at most 71 ms, so that ramps of 0.4 s can be shortened by it.
        move = np.array([0.0, math.radians(20), 1.0, 0.4])
        ramps = planned(ShapingController(params=ArmParams(belt_damping_ratio=0.0), kind="zv"), move)
        np.testing.assert_allclose(ramps.onset[0], 0, atol=1e-12)
        np.testing.assert_allclose((ramps.onset + ramps.time)[[1, 3]], [0.4, 1.0])
        middle = along(ramps, 0.0, 0.5)
        np.testing.assert_allclose(middle.angle, math.radians(10), atol=5e-4)

    @pytest.mark.parametrize("kind", GAINS)
    def test_a_move_on_a_matched_linear_arm_leaves_no_ringing(self, kind: Kind):
        # M2 is the same everywhere: the arm is linear but for friction.
        params = ArmParams(arm_inertia=0.05, arm_inertia_swing=0.0, belt_damping_ratio=0.0)
        move = np.array([0.2, 1.2, 0.9, 0.2])
        gains = ExtraInsensitiveGains(vibration=0.0) if kind == "ei" else None
        controller = ShapingController(gains, params, kind)
        time = np.arange(0.0, 1.8, 1e-4)
        ramps = planned(controller, move)
        accelerations = np.array([along(ramps, 0.2, t).acceleration for t in time])
        w = math.sqrt(33 / 0.05)
        system = ([[0, w], [-w, 0]], [[0], [w]], np.eye(2), np.zeros((2, 1)))  # theta_s'' + w^2 theta_s = theta_1''
        _, _, shaped = lsim(system, accelerations, time)
        task = [reference_at(TRAPEZOID, MoveShape(*move), t).acceleration for t in time]
        _, _, unshaped = lsim(system, np.array(task), time)
        assert np.linalg.norm(shaped[-1]) < 0.01 * np.linalg.norm(unshaped[-1])

    def test_shaping_quietens_the_nominal_arm(self):
        shaped, paper = (
            rollout(controller, 64, seed=5_000_000).metrics()["residual_pp_mm"]
            for controller in (ShapingController(params=NOMINAL, kind="zv"), PaperController())
        )
        assert np.median(shaped) < 0.2 * np.median(paper)

    def test_refuses_unknown_kinds_and_gains_of_another(self):
        with pytest.raises(ValueError, match="kind must be one of 'zv', 'zvd', 'ei', got 'zvdd'"):
            ShapingController(kind="zvdd")  # type: ignore[arg-type]
        with pytest.raises(TypeError, match="kind='ei' takes ExtraInsensitiveGains, got ShapingGains"):
            ShapingController(ShapingGains(), kind="ei")


class TestPid:
    def test_integral_holds_still_while_the_torque_is_at_its_limit(self):
        seen = observations(count=2, steps=1)[0]
        seen[:, observation.index("motor_angle_error")] = (-1.0, 1e-3)  # far ahead, next to nothing
        gains = replace(SmoothGains(), angle=50_000.0)
        controller = SmoothController(gains)
        _, memory = controller.predict(seen)
        assert memory[0, INTEGRAL] == 0.0 and memory[1, INTEGRAL] != 0.0

    def test_push_is_the_proportional_gain_times_inertia_and_error(self):
        seen = observations(count=1, steps=1)[0]
        base = PidGains()
        torques = {}
        for error in (0.0, 0.2):
            seen[:, observation.index("motor_angle_error")] = error / 1.5
            action, _ = SmoothController(SmoothGains(friction=0.0), NOMINAL).predict(seen)
            torques[error] = 0.3 * action[0, 0]
        inertia = inertia_at(read(seen, NOMINAL).reference_angle[0], NOMINAL.plant())
        assert torques[0.2] - torques[0.0] == pytest.approx(inertia * base.angle * 0.2, rel=1e-4)


class LoadedBy:
    """A controller whose motor carries a constant torque that it is not told of; it sees its own torque alone."""

    def __init__(self, controller: Any, load: float) -> None:
        self._controller, self._share = controller, load / NOMINAL.torque_limit

    def predict(self, observed, state=None, episode_start=None, deterministic=True):
        told = observed.copy()
        told[:, observation.index("last_command")] += self._share * (told[:, observation.index("elapsed_time")] > 0)
        action, state = self._controller.predict(told, state, episode_start, deterministic)
        return action - np.float32(self._share), state


class TestDisturbanceObserver:
    @pytest.mark.parametrize("load", [-0.03, 0.03])
    def test_a_constant_load_leaves_no_error(self, load: float):
        errors = []
        for observer in (0.1, 15.0):
            run = over_the_range(LoadedBy(DisturbanceController(DisturbanceGains(observer=observer)), load))
            errors.append(np.abs(run.state[-1, :, 0] - 88 * MOVES[:, 1]))
        without, with_observer = errors
        assert np.median(without) > 1.0
        assert with_observer.max() < 0.35  # 4 mrad at the joint
        assert np.median(with_observer) < 0.1 * np.median(without)

    def test_other_friction_leaves_no_error(self):
        for friction in (0.7 * 0.032, 1.3 * 0.032):
            run = over_the_range(DisturbanceController(), params={"coulomb_friction": friction})
            assert np.abs(run.state[-1, :, 0] - 88 * MOVES[:, 1]).max() < 0.8

    def test_estimate_follows_a_step_as_its_filter_does(self):
        # The motor turns at constant speed; the torque steps by 0.1 N m, which must be a load.
        gains = DisturbanceGains(observer=20.0, reaction=200.0, friction=0.0)
        controller, memory = DisturbanceController(gains), None
        seen = np.zeros((1, observation.size()), np.float32)
        seen[:, [observation.index(name) for name in ("motor_speed", "reference_speed", "duration", "ramp_time")]] = 1.0
        loads = []
        for k in range(101):
            held = 0.0 if memory is None else memory[0, KNOWN] + 0.1
            seen[:, observation.index("last_command")] = held / 0.3
            _, memory = controller.predict(seen, memory, np.array([k == 0]))
            loads.append(memory[0, [LOAD, FAST_LOAD]])
        time = CONTROL_PERIOD * np.arange(101)[:, None]
        np.testing.assert_allclose(loads, 0.1 * (1 - np.exp(-time * [20.0, 200.0])), atol=1e-6)

    def test_estimate_is_frozen_while_the_motor_is_meant_to_stick(self):
        controller = DisturbanceController(DisturbanceGains(rest_width=0.3))
        seen = np.zeros((1, observation.size()), np.float32)
        seen[:, [observation.index("duration"), observation.index("ramp_time")]] = 1.0
        _, memory = controller.predict(seen)
        seen[:, observation.index("last_command")] = 0.05
        _, after = controller.predict(seen, memory)
        assert after[0, LOAD] == memory[0, LOAD] == 0.0

    def test_torsion_torque_feedback_damps(self):
        quiet, stiff = (
            rollout(DisturbanceController(DisturbanceGains(reaction_gain=gain), NOMINAL), 64, seed=5_000_000)
            for gain in (5.0, 0.1)
        )
        assert np.median(quiet.metrics()["tip_acc_rms"]) < 0.8 * np.median(stiff.metrics()["tip_acc_rms"])
