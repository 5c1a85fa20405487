"""Flatness feed-forward and gain-scheduled LQG: the flat inverse, the gains, and the controller made of them."""

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from properties import examples
from scipy.integrate import solve_ivp
from scipy.linalg import solve_discrete_are, solve_discrete_lyapunov

from baselines.estimation.observer import kalman_gains
from baselines.gains import tuned
from baselines.loops.models import closed_poles, loop_at
from baselines.models.actuator import dead_time
from baselines.models.flatness import Corners, FlatMotion, flat_motion, smoothed
from baselines.models.linear import ANGLES, linear_arm
from baselines.optimal.lqg import LqgController, LqgGains, feedback_gains
from baselines.planning.plan import Weights
from baselines.planning.tip_error import bounded_sine, softened_sine, write_tip_errors
from beltarm_env import CONTROL_PERIOD, ArmParams, BeltArmVectorEnv
from beltarm_env.physics.sampled import sampled_state_space
from beltarm_env.rollout import rollout
from beltarm_env.task.ranges import design_model
from beltarm_env.task.reference import TRAPEZOID, MoveShape, reference_at

Floats = NDArray[np.float64]

GEAR = 88.0
SEED = 5_000_000
MOVE = np.array([[0.2, 1.4, 0.9, 0.25]])
UNDAMPED = ArmParams(belt_damping_ratio=0.0)
MOVES = st.builds(
    lambda start, length, duration, share: np.array([[start, start + length, duration, share * duration]]),
    st.floats(0.0, 0.6),
    st.floats(0.26, 0.97),
    st.floats(0.5, 1.2),
    st.floats(0.15, 0.35),
)
SPREADS = st.floats(0.02, 2.0)


def at(corners: Corners, times: Floats, params: ArmParams = UNDAMPED) -> FlatMotion:
    """One arm's motion at many times."""
    many = Corners(*(np.repeat(part, len(times), axis=0) for part in corners))
    return flat_motion(many, times, params)


def knots(corners: Corners) -> Floats:
    """Times at which the fourth derivative jumps."""
    return np.unique(corners.onset[0] + np.outer([0.0, 0.5, 1.0], corners.time[0]))


class TestSmoothedMove:
    @given(move=MOVES, first=SPREADS, others=SPREADS)
    @examples(40)
    def test_sets_out_and_arrives_as_the_task_and_meets_it_in_between(self, move: Floats, first: float, others: float):
        corners = smoothed(move, UNDAMPED, first, others)
        start, goal, duration, ramp = move[0]
        ends = corners.onset[0] + corners.time[0]
        assert corners.onset[0, 0] == 0.0 and (corners.onset >= 0).all()
        assert corners.time[0, 0] <= 0.5 * ramp + 1e-12
        assert corners.time.max() <= ramp and ends[3] <= duration + 0.5 * ramp + 1e-12
        link = at(corners, np.array([0.0, ends[3], 1.8])).link
        np.testing.assert_allclose(link[:, 0], [start, goal, goal], atol=1e-12)
        np.testing.assert_allclose(link[:, 1:4], 0.0, atol=1e-9)
        cruising = np.linspace(max(ends[1], ramp), min(corners.onset[0, 2], duration - ramp), 5)
        if cruising[0] < cruising[-1]:
            task = [reference_at(TRAPEZOID, MoveShape(start, goal, duration, ramp), t)[:2] for t in cruising]
            np.testing.assert_allclose(at(corners, cruising).link[:, :2], task, atol=1e-12)

    def test_derivatives_are_those_of_each_other(self):
        corners = smoothed(MOVE, UNDAMPED, 0.4, 0.7)
        times = np.linspace(0.01, 1.2, 400)
        times = times[np.abs(times[:, None] - knots(corners)).min(axis=1) > 1e-3]
        step = 2e-4
        middle = at(corners, times).link
        slopes = (at(corners, times + step).link - at(corners, times - step).link) / (2 * step)
        for k in range(4):
            np.testing.assert_allclose(slopes[:, k], middle[:, k + 1], atol=1e-4 * np.abs(middle[:, k + 1]).max())
        jumps = at(corners, knots(corners) + 1e-10).link - at(corners, knots(corners) - 1e-10).link
        assert np.abs(jumps[:, :4]).max() < 1e-5 < 100 < np.abs(jumps[:, 4]).max()

    def test_goes_to_the_task_as_spreads_vanish(self):
        times = np.linspace(0.0, 1.2, 500)
        task = [reference_at(TRAPEZOID, MoveShape(*MOVE[0]), t).angle for t in times]
        errors = [np.abs(at(smoothed(MOVE, UNDAMPED, s, s), times).link[:, 0] - task).max() for s in (0.4, 0.2, 0.02)]
        assert errors[2] < 1e-3 < errors[1] < errors[0] < 0.05

    def test_mistakes_are_named(self):
        with pytest.raises(ValueError, match=r"moves must have shape \(n, 4\).*got \(4,\)"):
            smoothed(MOVE[0], UNDAMPED, 0.3, 0.3)
        for bad in (0.0, -1.0, math.nan, math.inf):
            with pytest.raises(ValueError, match=rf"spreads of corners must be positive .* got 0.3 and {bad}"):
                smoothed(MOVE, UNDAMPED, 0.3, bad)


def integrate(corners: Corners, params: ArmParams) -> tuple[Floats, Floats]:
    """Times, and states of (5a), (5b) under the flat torque without Coulomb friction: the equations written anew."""
    p = params
    swing = p.arm_inertia_swing + (2 * p.link_length) ** 2 * p.payload_mass
    damping = 2 * p.belt_damping_ratio * math.sqrt(p.belt_stiffness * (p.arm_inertia + p.arm_inertia_swing))

    def rates(time: float, y: Floats) -> list[float]:
        theta, phi, theta_rate, phi_rate = y
        torque = flat_motion(corners, np.array([time]), p).torque[0]
        belt = p.belt_stiffness * (theta - phi) + damping * (theta_rate - phi_rate)
        viscous = p.motor_viscous_friction * GEAR * theta_rate
        motor = (torque - viscous - belt / GEAR) / (p.motor_inertia * GEAR)
        m2, half_slope = p.arm_inertia + swing * math.sin(phi) ** 2, swing * math.sin(phi) * math.cos(phi)
        return [theta_rate, phi_rate, motor, (belt - half_slope * phi_rate**2) / m2]

    first = flat_motion(corners, np.zeros(1), p).state[0]
    y = np.array([first[0] / GEAR, first[0] / GEAR - first[2], first[1] / GEAR, first[1] / GEAR - first[3]])
    edges = np.append(knots(corners), 1.5)
    times, states = [0.0], [y]
    for begin, end in pairwise(edges):  # between the jumps of the torque
        if end - begin < 1e-9:
            continue
        instants = np.linspace(begin, np.nextafter(end, begin), 8)
        span = (begin, instants[-1])
        run = solve_ivp(rates, span, states[-1], "DOP853", instants[1:], rtol=1e-11, atol=1e-12)
        times += [*instants[1:]]
        states += [*run.y.T]
    y = np.array(states)
    return np.array(times), np.column_stack([GEAR * y[:, 0], GEAR * y[:, 2], y[:, 0] - y[:, 1], y[:, 2] - y[:, 3]])


class TestFlatInverse:
    @pytest.mark.parametrize("payload", [0.0, 0.3])
    @pytest.mark.parametrize("move", [MOVE, np.array([[1.5, 0.1, 1.0, 0.2]])])
    def test_torque_drives_the_undamped_arm_along_the_smoothed_move(self, move: Floats, payload: float):
        params = ArmParams(belt_damping_ratio=0.0, payload_mass=payload)
        corners = smoothed(move, params, 0.3, 0.7)
        times, states = integrate(corners, params)
        planned = at(corners, times, params)
        np.testing.assert_allclose(states, planned.state, atol=1e-7)
        np.testing.assert_allclose(states[:, 0] / GEAR - states[:, 2], planned.link[:, 0], atol=1e-9)
        assert np.abs(planned.state[:, 2]).max() > 0.01, "the belt gives way"

    def test_damped_belt_costs_hardly_anything(self):
        corners = smoothed(MOVE, ArmParams(), 0.3, 0.7)
        times, states = integrate(corners, ArmParams())
        planned = at(corners, times, ArmParams())
        assert np.abs(states[:, 0] / GEAR - states[:, 2] - planned.link[:, 0]).max() < 1e-4
        assert np.abs(states[:, 2] - planned.state[:, 2]).max() < 1e-4


def tip_errors(angle: float, speed: float = 0.0) -> Floats:
    """C of the nominal arm, about a joint at this angle [rad] that turns at this speed [rad/s]."""
    errors = np.empty((4, 4))
    write_tip_errors(angle, speed, bounded_sine(angle), ArmParams().plant(), errors)
    return errors


def with_last_torque(transition: Floats, by_torque: Floats) -> tuple[Floats, Floats]:
    """The arm with its last torque as a further state, and the change of the torque as input."""
    size = len(by_torque)
    a, b = np.eye(size + 1), np.append(by_torque, 1.0)
    a[:size, :size], a[:size, size] = transition, by_torque
    return a, b


class TestFeedbackGains:
    @pytest.mark.parametrize("weights", [Weights(), Weights(0.05, 100.0, 3.0)])
    def test_are_the_optimum_of_the_riccati_equation(self, weights: Weights):
        tables = linear_arm(ArmParams())
        for k in (0, 22, 45):
            a, b = with_last_torque(tables.transition[k], tables.by_torque[k])
            gain = feedback_gains(ArmParams(), weights)[k] + [0, 0, 0, 0, 1]  # of the change
            c, q = tip_errors(float(ANGLES[k])), np.zeros((5, 5))
            q[:4, :4] = c.T @ np.diag([1e4, 1e4, weights.velocity / 0.04, weights.velocity / 0.04]) @ c
            q[4, 4] = weights.torque
            closed = a - np.outer(b, gain)
            # The cost of the loop itself, as an infinite sum by doubling: J = sum of closed^T^i (Q + R K'K) closed^i.
            cost, power = q + weights.change * np.outer(gain, gain), closed
            for _ in range(14):
                cost, power = cost + power.T @ cost @ power, power @ power
            to_go = weights.change + b @ cost @ b
            np.testing.assert_allclose(gain, b @ cost @ a / to_go, rtol=1e-5, atol=1e-6 * np.abs(gain).max())

    @pytest.mark.parametrize("speed", [0.0, 1.7])
    def test_errors_are_the_tips(self, speed: float):
        # Finite differences of the exact tip, in a frame that turns with the reference, at 40 degrees.
        angle, step = math.radians(40.0), 1e-6
        reference = np.array([GEAR * angle, GEAR * speed, 0.0, 0.0])

        def tip(deviation: Floats) -> Floats:
            (theta, omega), (torsion, rate) = (reference + deviation)[:2] / GEAR, deviation[2:]
            reach = 0.5 * math.cos(theta - torsion) + 0.1
            reach_rate = -0.5 * math.sin(theta - torsion) * (omega - rate)
            return np.array([reach, reach * torsion, reach_rate, reach_rate * torsion + reach * rate])

        slopes = np.column_stack([(tip(step * unit) - tip(-step * unit)) / (2 * step) for unit in np.eye(4)])
        np.testing.assert_allclose(tip_errors(angle, speed), slopes, atol=1e-8)

    def test_bounds_of_the_sine_hold_the_motor_at_0_degrees_alone(self):
        assert (bounded_sine(0.0), softened_sine(0.0)) == (0.1, 0.05)
        for bound in (bounded_sine, softened_sine):
            assert bound(1.2) == pytest.approx(math.sin(1.2), rel=2e-3)

    @pytest.mark.parametrize("gains", [LqgGains(), LqgGains(torque_weight=1e4), tuned("lqg", LqgGains)])
    def test_loops_are_stable_at_every_angle_and_between_tables(self, gains: LqgGains):
        controls, filters = feedback_gains(ArmParams(), gains.weights()), kalman_gains(ArmParams(), gains.noise())
        tables = linear_arm(ArmParams())
        measured = np.array([1.0, 0, 0, 0, 0])
        for k in range(len(ANGLES)):
            a, b = tables.transition[k], tables.by_torque[k]
            extended = np.eye(5)
            extended[:4, :4], extended[:4, 4] = a, b
            for other in (max(k - 1, 0), k, min(k + 1, len(ANGLES) - 1)):  # scheduled by an angle that is not the arm's
                of_state, of_last = controls[other, :4], controls[other, 4]
                # [x; v_last]: v = -K [x; v_last]
                held = np.block([[a - np.outer(b, of_state), -of_last * b[:, None]], [-of_state, -of_last]])
                assert np.abs(np.linalg.eigvals(held)).max() < 1
                # [x; xhat, dhat; v_last] with tau = v - dhat
                law = np.concatenate([np.zeros(4), -of_state, [-1.0, -of_last]])
                arm = np.hstack([a, np.zeros((4, 6))]) + np.outer(b, law)
                predicted = np.hstack([np.zeros((5, 4)), extended, np.zeros((5, 1))]) + np.outer([*b, 0.0], law)
                corrected = predicted + np.outer(filters[other], arm[0] - measured @ predicted)
                last = law + np.eye(10)[8]  # v = tau + dhat
                assert np.abs(np.linalg.eigvals(np.vstack([arm, corrected, last]))).max() < 1

    @pytest.mark.parametrize("latency", [0.0, 0.75, 1.5, 2.9])
    @pytest.mark.parametrize("k", [0, 20, 45])
    def test_feedback_on_the_state_ahead_is_as_good_as_on_the_actuators_states(self, latency: float, k: int):
        params = replace(design_model(), command_latency=latency * CONTROL_PERIOD, belt_stiffening=0.0)
        weights, angle = Weights(0.3, 1.0, 30.0), float(ANGLES[k])
        transition, by_command, _ = sampled_state_space(params, angle)
        a, b = with_last_torque(transition, by_command[:, 0])
        c, q = tip_errors(angle), np.zeros_like(a)
        q[:4, :4] = c.T @ np.diag([1e4, 1e4, weights.velocity / 0.04, weights.velocity / 0.04]) @ c
        q[-1, -1] = weights.torque
        to_go = solve_discrete_are(a, b[:, None], q, np.array([[weights.change]]))
        late = dead_time(params) / CONTROL_PERIOD
        step = np.linalg.matrix_power(a, int(late))  # with the last command held
        ahead = step + (late - int(late)) * (a @ step - step)
        gain = feedback_gains(params, weights)[k] + [0, 0, 0, 0, 1]
        gain = gain[:4] @ ahead[:4] + gain[4] * np.eye(len(a))[-1]
        closed = a - np.outer(b, gain)
        cost = solve_discrete_lyapunov(closed.T, q + weights.change * np.outer(gain, gain))
        pushed = np.zeros(len(a))
        pushed[:4] = 0.01, 1.0, 1e-3, 0.05
        assert 1 - 1e-9 < pushed @ cost @ pushed / (pushed @ to_go @ pushed) < 1.0001

    def test_feedback_on_the_state_now_bears_no_late_command(self):
        params = replace(design_model(), command_latency=1.5 * CONTROL_PERIOD)
        weights, k = Weights(0.3, 0.01, 0.01), 20
        transition, by_command, _ = sampled_state_space(params, float(ANGLES[k]))
        gain = np.zeros(len(transition))
        gain[:4] = feedback_gains(params, weights)[k, :4]
        assert np.abs(np.linalg.eigvals(transition - np.outer(by_command[:, 0], gain))).max() > 1.01
        law = LqgController(LqgGains(velocity_weight=0.3, torque_weight=0.01, change_weight=0.01), params)
        assert np.abs(closed_poles(loop_at(law, k))).max() < 1


def batch(count: int) -> BeltArmVectorEnv:
    env = BeltArmVectorEnv(count, autoreset_mode="Disabled", randomization="ideal")
    env.reset(seed=SEED)
    return env


class TestController:
    def test_follows_the_smoothed_move_without_friction_and_rounding(self):
        options = {
            "params": {"coulomb_friction": 0.0},
            "move": {"start": 0.2, "goal": 1.4, "duration": 0.9, "ramp_time": 0.25},
        }
        params = ArmParams(coulomb_friction=0.0)
        controller = LqgController(LqgGains(), params)
        run = rollout(controller, 1, seed=0, options=options, encoder_counts=10**7)
        gains = controller.gains
        planned = at(smoothed(MOVE, params, gains.first_spread, gains.spread), run.time, params).state
        error = np.abs(run.state[:, 0] - planned)
        assert (error[:, 0] / GEAR).max() < 1e-4 and error[:, 2].max() < 1e-4
        assert np.abs(run.tip_error[-200:]).max() < 2e-5

    @pytest.mark.parametrize(("start", "goal"), [(0.0, 90.0), (90.0, 0.0), (10.0, 30.0), (80.0, 60.0)])
    def test_moves_the_nominal_arm_anywhere_to_within_millimetres(self, start: float, goal: float):
        move = {"start": math.radians(start), "goal": math.radians(goal), "duration": 1.1, "ramp_time": 0.25}
        run = rollout(LqgController(params=ArmParams()), 1, seed=0, options={"move": move})
        assert np.abs(run.tip_error[-200:]).max() < 2e-3
        assert np.abs(run.tip_error).max() < 0.02

    def test_smoothing_quietens_arms_that_differ(self):
        smooth, sharp = (
            rollout(LqgController(LqgGains(spread=s, first_spread=f)), 64, seed=SEED, randomization="ideal")
            for f, s in ((0.3, 0.8), (0.02, 0.02))
        )
        assert np.median(smooth.metrics()["tip_acc_rms"]) < 0.9 * np.median(sharp.metrics()["tip_acc_rms"])

    def test_batch_is_bit_for_bit_as_single_arms(self):
        together = rollout(LqgController(), 6, seed=SEED, randomization="ideal")
        for arm in (0, 3, 5):
            alone = rollout(LqgController(), 1, seed=SEED + arm, randomization="ideal")
            np.testing.assert_array_equal(together.torque[:, arm], alone.torque[:, 0])

    def test_nothing_leaks_from_one_episode_into_the_next(self):
        env, controller = batch(2), LqgController()
        first, _ = env.reset(seed=SEED)
        _, fresh = controller.predict(first, None, np.array([True, True]))
        _, other = controller.predict(first[::-1], None, np.array([True, True]))
        memory, observations = other, first[::-1]
        for _ in range(60):
            action, memory = controller.predict(observations, memory, np.array([False, False]))
            observations, *_ = env.step(action)
        observations[1] = first[1]
        _, again = controller.predict(observations, memory, np.array([False, True]))
        np.testing.assert_array_equal(again.corners[1], fresh.corners[1])
        np.testing.assert_array_equal(again.corners[0], memory.corners[0])
        np.testing.assert_array_equal(again.estimate.state[1], fresh.estimate.state[1])
        np.testing.assert_array_equal(again.estimate.state[1, 2:], 0.0)
        assert (again.estimate.state[0, 2:] != 0).any()

    def test_memory_is_not_changed_by_the_next_call(self):
        env, controller = batch(2), LqgController()
        observations, _ = env.reset(seed=SEED)
        action, memory = controller.predict(observations)
        observations, *_ = env.step(action)
        once, _ = controller.predict(observations, memory)
        twice, _ = controller.predict(observations, memory)
        np.testing.assert_array_equal(once, twice)

    def test_mistakes_are_named(self):
        bad: Any = -1
        with pytest.raises(ValueError, match=r"LqgGains.spread must lie within 0.02 and 4, got -1"):
            LqgGains(spread=bad)
        with pytest.raises(TypeError, match=r"LqgGains.velocity_weight must be a number, got '1'"):
            LqgGains(velocity_weight="1")  # type: ignore[arg-type]
        with pytest.raises(ValueError, match=r"observations must have shape \(n, 25\) or wider, got \(2, 7\)"):
            LqgController().predict(np.zeros((2, 7), np.float32))
