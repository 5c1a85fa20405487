"""Input shaping and smooth moves: ramps, impulses against closed forms and oscillators, planned moves."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lsim

from baselines.models.modes import Mode, held_mode
from baselines.models.ramps import Ramps, motion_at
from baselines.reading import read
from baselines.servo.paper import PaperController
from baselines.servo.pid import MOST_RAMPS
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
from baselines.servo.smooth import SmoothController, plan_smooth
from beltarm_env import ArmParams, BeltArmVectorEnv, state_space
from beltarm_env.rollout import rollout
from beltarm_env.task.reference import SCURVE, TRAPEZOID, MoveShape, Reference, reference_at

NOMINAL = ArmParams()


def drawn_moves(count: int = 60) -> np.ndarray:
    """Moves that the environment draws: start, goal, duration, ramp time; shape (count, 4)."""
    env = BeltArmVectorEnv(count, randomization="ideal")
    return read(env.reset(seed=5_000_000)[0], NOMINAL).move


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
        for move in drawn_moves():
            ramps, (start, goal, duration, _) = planned(SmoothController(), move), move
            arrived = along(ramps, start, duration, smooth=True)
            np.testing.assert_allclose(arrived[:2], [goal, 0], atol=1e-12)
            assert (ramps.onset >= 0).all() and (ramps.onset + ramps.time <= duration + 1e-12).all()


class TestShaper:
    @pytest.mark.parametrize("zeta", [0.0, 0.02, 0.1])
    def test_impulses_are_the_closed_forms(self, zeta: float):
        root = math.sqrt(1 - zeta**2)
        half, k = math.pi / (20 * root), math.exp(-math.pi * zeta / root)
        mode = Mode(2 * half, k)
        closed: dict[Kind, list[float]] = {"zv": [1, k], "zvd": [1, 2 * k, k * k], "ei": [1.1, 1.8 * k, 1.1 * k * k]}
        for kind, shares in closed.items():
            weights, delays = shaper(kind, mode, 0.1)
            np.testing.assert_allclose(weights, np.array(shares) / sum(shares), rtol=1e-14)
            np.testing.assert_allclose(delays, half * np.arange(len(shares)), rtol=1e-14)

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
        controller = ShapingController(kind=kind)
        for move in drawn_moves():
            ramps, (start, goal, _, _) = planned(controller, move), move
            assert (ramps.onset >= 0).all() and (ramps.time > 0).all()
            np.testing.assert_allclose(along(ramps, start, 1.8)[:2], [goal, 0], atol=1e-12)

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
