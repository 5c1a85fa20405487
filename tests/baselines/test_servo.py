"""Servos by themselves: laws, disturbance observers, reference ramps and shapers, planned motions."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from episodes import torques
from scipy.linalg import expm
from scipy.signal import lsim

from baselines import TUNABLE, rigid_controller
from baselines.loops.laws import law_of
from baselines.models.linear import ANGLES, Mode, dead_time, held_mode
from baselines.models.rigid_arm import inertia_at
from baselines.reading import read
from baselines.servo import shaping
from baselines.servo.adrc import AdrcController, AdrcGains, ExtendedState, feedback, observe, observer_gains
from baselines.servo.disturbance import FAST_LOAD, LOAD, DisturbanceController, DisturbanceGains
from baselines.servo.disturbance import KNOWN as KNOWN_TORQUE
from baselines.servo.paper import TORSION, TORSION_RATE, PaperController, next_torsion
from baselines.servo.pid import INTEGRAL, MOST_RAMPS, Ramps, motion_at
from baselines.servo.shaping import ExtraInsensitiveGains
from baselines.servo.smooth import SmoothController, SmoothGains, plan_smooth
from beltarm_env import CONTROL_PERIOD, ArmParams, BeltArmVectorEnv, observation, state_space
from beltarm_env.observation import decode
from beltarm_env.task.ranges import design_model
from beltarm_env.task.reference import SCURVE, TRAPEZOID, MoveShape, Reference, reference_at

SHAPERS = ("zv", "zvd", "ei")
NOMINAL = ArmParams()


def observations(count: int = 5, steps: int = 250) -> np.ndarray:
    """What a few arms observe under random torques, shape (steps, count, size)."""
    env = BeltArmVectorEnv(count, randomization="ideal")
    first, pushes = env.reset(seed=5_000_000)[0], 0.4 * torques(steps, hold=10)
    return np.stack([first, *(env.step(np.full((count, 1), push))[0] for push in pushes)])


class TestPaper:
    def test_first_torque_is_equation_11_with_table_2(self):
        seen = observations(steps=1)[0]
        action, memory = PaperController().predict(seen)
        now = decode(seen)
        u_1 = 88 * now["reference_acceleration"] + 20 * now["motor_speed_error"] + 25 * now["motor_angle_error"]
        torque = 6.3e-5 * u_1 + 3.5e-4 * now["motor_speed"] + 0.032 * np.sign(now["reference_speed"])
        np.testing.assert_allclose(action[:, 0], torque / 0.3, atol=1e-7)
        assert (memory[:, TORSION] == 0).all()

    def test_vibration_feedback_is_k4_times_the_simulated_rate(self):
        paper, rigid = PaperController(), rigid_controller()
        memory = other = None
        for seen in observations():
            with_feedback, memory = paper.predict(seen, memory)
            without, other = rigid.predict(seen, other)
            free = (np.abs(with_feedback) < 1) & (np.abs(without) < 1)
            expected = without[:, 0] - 0.15 * memory[:, TORSION_RATE] / 0.3
            np.testing.assert_allclose(with_feedback[free[:, 0], 0], expected[free[:, 0]], atol=1e-6)
        assert memory is not None and np.abs(memory[:, TORSION_RATE]).max() > 0.01

    def test_torsion_simulation_solves_the_arm_behind_the_belt(self):
        # Joint speed constant within each sample, as the simulation assumes; M2 at the joint angle, its slope left out.
        damping = 2 * 0.05 * np.sqrt(33 * 0.07)
        plant = ArmParams(belt_damping_ratio=0.05).plant()
        joint, last, torsion, rate, exact = 0.8, 0.0, 0.0, 0.0, np.zeros(2)
        for speed in np.random.default_rng(1).uniform(-2, 2, 40):
            joint += speed * CONTROL_PERIOD
            torsion, rate = next_torsion(torsion, rate, speed - last, joint, plant)
            m2 = 0.01 + 0.06 * np.sin(joint) ** 2
            exact[1] += speed - last
            system = np.array([[0, 1], [-33 / m2, -damping / m2]])
            exact, last = expm(CONTROL_PERIOD * system) @ exact, speed
        np.testing.assert_allclose([torsion, rate], exact, rtol=1e-8)


def test_integral_holds_still_while_the_torque_is_at_its_limit():
    seen = observations(count=2, steps=1)[0]
    seen[:, observation.index("motor_angle_error")] = (-1.0, 1e-3)  # far ahead, next to nothing
    _, memory = SmoothController(replace(SmoothGains(), angle=50_000.0)).predict(seen)
    assert memory[0, INTEGRAL] == 0.0 and memory[1, INTEGRAL] != 0.0


def test_estimates_of_a_disturbance_follow_a_step_as_their_filters_do():
    # The motor turns at constant speed; the torque steps by 0.1 N m, which must be a load.
    gains = DisturbanceGains(observer=20.0, reaction=200.0, friction=0.0)
    controller, memory = DisturbanceController(gains), None
    seen = np.zeros((1, observation.size()), np.float32)
    seen[:, [observation.index(name) for name in ("motor_speed", "reference_speed", "duration", "ramp_time")]] = 1.0
    seen[:, observation.index("elapsed_time")] = 0.5
    loads = []
    for k in range(101):
        held = 0.0 if memory is None else memory[0, KNOWN_TORQUE] + 0.1
        seen[:, observation.index("last_command")] = held / 0.3
        _, memory = controller.predict(seen, memory, np.array([k == 0]))
        loads.append(memory[0, [LOAD, FAST_LOAD]])
    time = CONTROL_PERIOD * np.arange(101)[:, None]
    np.testing.assert_allclose(loads, 0.1 * (1 - np.exp(-time * [20.0, 200.0])), atol=1e-6)


KNOWN = replace(design_model(), coulomb_friction=0.0, belt_stiffening=0.0)


class TestExtendedState:
    @pytest.mark.parametrize("bandwidth", [1.0, 30.0, 400.0])
    def test_its_poles_lie_where_the_bandwidth_says(self, bandwidth: float):
        step = [observe(ExtendedState(*row), 0.0, 0.0, observer_gains(bandwidth)) for row in np.eye(3)]
        np.testing.assert_allclose(np.linalg.eigvals(np.array(step).T), np.exp(-bandwidth * CONTROL_PERIOD), atol=2e-4)

    def test_law_cancels_what_is_found_and_places_two_poles(self):
        h, z = 1e-4, np.array([1.0, 0.0, 7.0])
        transition = np.eye(3) + h * np.array([[0, 1, 0], [0, 0, 1], [0, 0, 0]])
        transition[1] += h * np.array([feedback(ExtendedState(*unit), 20.0) for unit in np.eye(3)])
        for _ in range(20_000):
            z = transition @ z
        np.testing.assert_allclose(z, [0, 0, 7], atol=1e-9)
        poles = np.sort(np.linalg.eigvals(transition[:2, :2]).real)
        np.testing.assert_allclose(np.log(poles) / h, -20.0, rtol=2e-3)


@pytest.mark.parametrize(("known", "actual"), [(True, (0.0, 1e-9)), (False, (10.0, 1000.0))])
def test_commands_on_their_way_are_no_disturbance(known: bool, actual: tuple[float, float]):
    """On a motor that is an inertia behind the drive's dead time, pushed at will, the observer finds nothing."""
    params = KNOWN if known else replace(KNOWN, command_latency=0.0, current_loop_time_constant=0.0)
    law = law_of(AdrcController(AdrcGains(observer=200.0), params), 20)
    inertia = inertia_at(ANGLES[20], KNOWN.plant())
    whole, rest = divmod(dead_time(KNOWN) / CONTROL_PERIOD, 1.0)
    memory, error, rate, largest = np.zeros(law.size), 0.0, 0.0, 0.0
    pushes = 0.02 * np.sin(0.2 * np.arange(-3, 300)) * (np.arange(-3, 300) >= 0)
    for k in range(3, 300):
        acting = (pushes[k - int(whole)] * (1 - rest) + pushes[k - int(whole) - 1] * rest) / inertia
        error += CONTROL_PERIOD * (rate + 0.5 * CONTROL_PERIOD * acting)
        rate += CONTROL_PERIOD * acting
        _, memory = law.step(error, rate, float(pushes[k]), memory)
        largest = max(largest, abs(float(memory[2])))
    assert actual[0] <= largest < actual[1]


def planned(controller: Any, move: np.ndarray) -> Ramps:
    ramps = Ramps(*np.zeros((3, MOST_RAMPS)))
    plan = plan_smooth if isinstance(controller, SmoothController) else shaping.plan_shaped
    plan(controller.kernel().design, MoveShape(*move), ramps)
    count = np.count_nonzero(ramps.speed)
    return Ramps(*(part[:count] for part in ramps))


def along(ramps: Ramps, start: float, time: float, smooth: bool = False) -> Reference:
    return motion_at(ramps, len(ramps.speed), smooth, start, time)


def shaper(kind: str, mode: Mode, vibration: float) -> tuple[np.ndarray, np.ndarray]:
    shares = np.array(TUNABLE[kind](ExtraInsensitiveGains(vibration=vibration)).shares())
    ramps = Ramps(*np.zeros((3, len(shares))))
    shaping.write_impulses(shares, mode, 0, ramps)
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
            state = lsim((modal, np.zeros((2, 1)), np.eye(2), np.zeros((2, 1))), np.zeros(3), time, state)[2][-1]
    return float(np.linalg.norm(state))


class TestRamps:
    @pytest.mark.parametrize(("profile", "smooth"), [(TRAPEZOID, False), (SCURVE, True)])
    def test_two_are_the_environments_profile(self, profile: int, smooth: bool):
        move, cruise = MoveShape(0.3, 1.4, 0.8, 0.2), 1.1 / 0.6
        ramps = Ramps(np.array([0.0, 0.6]), np.array([0.2, 0.2]), np.array([cruise, -cruise]))
        for time in np.linspace(0.0, 0.95, 78):
            np.testing.assert_allclose(along(ramps, 0.3, time, smooth), reference_at(profile, move, time), atol=1e-12)

    @pytest.mark.parametrize("kind", ["smooth", *SHAPERS])
    def test_of_drawn_moves_are_causal_and_reach_the_goal_a_smooth_move_in_the_tasks_time(self, kind: Any):
        env, smooth, controller = BeltArmVectorEnv(60, randomization="ideal"), kind == "smooth", TUNABLE[kind]()
        for move in read(env.reset(seed=5_000_000)[0], NOMINAL).move:
            ramps, (start, goal, duration, _) = planned(controller, move), move
            end = duration if smooth else 1.8
            np.testing.assert_allclose(along(ramps, start, end, smooth)[:2], [goal, 0], atol=1e-12)
            assert (ramps.onset >= 0).all() and (ramps.time > 0).all()
            assert (ramps.onset + ramps.time <= end + 1e-12).all()

    @pytest.mark.parametrize("kind", SHAPERS)
    def test_a_move_too_short_for_its_shaper_ends_late_at_its_goal(self, kind: str):
        for duration, ramp in ((0.22, 0.1), (0.25, 0.0875)):
            ramps = planned(TUNABLE[kind](), np.array([1.57, 1.31, duration, ramp]))
            np.testing.assert_allclose(along(ramps, 1.57, 1.8)[:2], [1.31, 0], atol=1e-12)
            speeds = [along(ramps, 1.57, time)[1] for time in np.linspace(0, 1, 300)]
            assert -2 * 0.26 / (duration - ramp) <= min(speeds) < 100 * -max(speeds)


class TestShaper:
    @pytest.mark.parametrize("zeta", [0.0, 0.02, 0.1])
    def test_impulses_are_the_closed_forms(self, zeta: float):
        root = math.sqrt(1 - zeta**2)
        half, k = math.pi / (20 * root), math.exp(-math.pi * zeta / root)
        mode = Mode(2 * half, k)
        closed: Any = {"zv": [1, k], "zvd": [1, 2 * k, k * k], "ei": [1.1, 1.8 * k, 1.1 * k * k]}
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

    @pytest.mark.parametrize("kind", SHAPERS)
    def test_a_move_on_a_matched_linear_arm_leaves_no_ringing(self, kind: str):
        # M2 is the same everywhere: the arm is linear but for friction.
        params = ArmParams(arm_inertia=0.05, arm_inertia_swing=0.0, belt_damping_ratio=0.0)
        move, time, w = np.array([0.2, 1.2, 0.9, 0.2]), np.arange(0.0, 1.8, 1e-4), math.sqrt(33 / 0.05)
        gains = ExtraInsensitiveGains(vibration=0.0) if kind == "ei" else None
        ramps = planned(TUNABLE[kind](gains, params), move)
        system = ([[0, w], [-w, 0]], [[0], [w]], np.eye(2), np.zeros((2, 1)))  # theta_s'' + w^2 theta_s = theta_1''
        _, _, shaped = lsim(system, [along(ramps, 0.2, t).acceleration for t in time], time)
        task = [reference_at(TRAPEZOID, MoveShape(*move), t).acceleration for t in time]
        _, _, unshaped = lsim(system, task, time)
        assert np.linalg.norm(shaped[-1]) < 0.01 * np.linalg.norm(unshaped[-1])
