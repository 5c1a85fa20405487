import math
from collections.abc import Callable
from dataclasses import asdict, astuple
from itertools import pairwise
from typing import Any

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from properties import examples
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import brentq

from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS, ArmParams, BeltArmEnv, state_space
from beltarm_env.arm import Plant, plant_of
from beltarm_env.jit import compiled
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.layout import LANES, load_state, store_plant, store_state
from beltarm_env.kernels.runge_kutta import DIRECTION, DT, NEXT, RK4_ROWS, TORQUE, rk4_steps
from beltarm_env.observation import decode
from beltarm_env.physics.integrator import hermite_root, mode_change, mode_margin
from beltarm_env.physics.models import (
    FULL_ARM,
    LUMPED,
    MODELS,
    Model,
    accelerations,
)
from beltarm_env.physics.state import ArmState
from beltarm_env.task.ranges import IDEAL_RANGES
from eval.reference.event_located import EventLocatedArm, tip

Floats = NDArray[np.float64]
Torque = Callable[[float, Floats], float]

GEAR = 88.0
LIMIT = 0.3
DEG_45, DEG_90 = math.pi / 4, math.pi / 2
LOSSLESS = {"coulomb_friction": 0.0, "motor_viscous_friction": 0.0, "belt_damping_ratio": 0.0}
FASTEST_TRAINED = {name: pair[0] for name, pair in IDEAL_RANGES.items()} | {
    "belt_stiffness": IDEAL_RANGES["belt_stiffness"][1]
}
SLOWEST_TRAINED = {name: pair[1] for name, pair in IDEAL_RANGES.items()} | {
    "belt_stiffness": IDEAL_RANGES["belt_stiffness"][0]
}


def plant(**changes: float) -> Plant:
    return plant_of(np.array(astuple(ArmParams(**changes))))


@compiled
def _rk4_step(work: Floats, x: ArmState, arm: Plant, model: Model) -> ArmState:
    store_state(work, at.STATE, 0, x)
    store_plant(work, 0, arm)
    rk4_steps(work, work, 1, model)
    return load_state(work, NEXT, 0)


def rk4_step(x: ArmState, torque: float, direction: float, dt: float, arm: Plant, model: Model) -> ArmState:
    work = np.zeros(RK4_ROWS * LANES)
    work[TORQUE * LANES], work[DIRECTION * LANES], work[DT * LANES] = torque, direction, dt
    return _rk4_step(work, x, arm, model)


def at_rest(joint: float, torsion: float = 0.0, torsion_speed: float = 0.0) -> Floats:
    return np.array([GEAR * joint, 0.0, torsion, torsion_speed])


def arm_env(params: dict[str, float], state: Floats, **settings: Any) -> BeltArmEnv:
    env = BeltArmEnv(**settings)
    env.reset(seed=0, options={"params": params, "state": state})
    return env


def apply(env: BeltArmEnv, torque: float) -> NDArray[np.float32]:
    observation, _, terminated, _, _ = env.step(np.array([torque / env.params.torque_limit]))
    assert not terminated, f"the arm left the workspace at {env.time:.3f} s: no test of anything"
    return observation


def no_torque(_: float, __: Floats) -> float:
    return 0.0


def wiggle(amplitude: float, frequency: float) -> Torque:
    return lambda time, _: amplitude * math.sin(2 * math.pi * frequency * time)


def back_and_forth(time: float, state: Floats) -> float:
    """Table 2's position loop without friction compensation, after a joint that swings by 0.3 rad around 45 degrees."""
    rate = 2 * math.pi * 1.2
    reference = DEG_45 + 0.3 * math.sin(rate * time)
    speed, acceleration = 0.3 * rate * math.cos(rate * time), -0.3 * rate**2 * math.sin(rate * time)
    demand = GEAR * acceleration + 20 * (GEAR * speed - state[1]) + 25 * (GEAR * reference - state[0])
    return min(max(6.3e-5 * demand + 3.5e-4 * state[1], -LIMIT), LIMIT)


def run_both(params: dict[str, float], state: Floats, torque: Torque) -> tuple[float, list[tuple[str, str]]]:
    """Worst distance [m] of the tip from the event-located solution over an episode, and the friction modes passed."""
    env = arm_env(params, state)
    arm = EventLocatedArm(env.params, env.state)
    worst = 0.0
    for k in range(EPISODE_STEPS):
        demand = torque(k * CONTROL_PERIOD, env.state)
        apply(env, demand)
        arm.advance(demand, CONTROL_PERIOD)
        worst = max(worst, float(np.linalg.norm(tip(env.params, env.state) - tip(arm.params, arm.state))))
    return worst, arm.mode_changes


def reversals(changes: list[tuple[str, str]]) -> int:
    slides = [mode for _, mode in changes if mode != "stuck"]
    return sum(before != after for before, after in pairwise(slides))


class TestAgainstEventLocatedIntegration:
    @pytest.mark.parametrize(
        ("params", "torque"),
        [
            pytest.param({}, wiggle(0.06, 4), id="nominal"),
            pytest.param({}, wiggle(0.042, 5), id="barely breaking away"),
            pytest.param({"payload_mass": 0.2}, wiggle(0.042, 3), id="payload 0.2 kg"),
            pytest.param({"payload_mass": 0.5}, wiggle(0.058, 4), id="payload 0.5 kg"),
            pytest.param({"coulomb_friction": 0.0224}, wiggle(0.034, 2), id="friction 0.7x"),
            pytest.param({"coulomb_friction": 0.1}, wiggle(0.15, 3), id="friction 3x, 120 degrees of the motor"),
            pytest.param({"belt_stiffness": 16.5, "belt_damping_ratio": 0.0}, wiggle(0.058, 4), id="soft belt"),
            pytest.param(FASTEST_TRAINED, wiggle(0.04, 4), id="fastest trained"),
            pytest.param(SLOWEST_TRAINED, wiggle(0.06, 4), id="slowest trained"),
            pytest.param(
                {"coulomb_friction": 0.0576, "motor_viscous_friction": 6.3e-4},
                back_and_forth,
                id="friction 1.8x, moves",
            ),
            pytest.param({"coulomb_friction": 0.1, "payload_mass": 0.2}, back_and_forth, id="friction 3x, moves"),
        ],
    )
    def test_stick_slip_moves(self, params: dict[str, float], torque: Torque):
        worst, changes = run_both(params, at_rest(DEG_45), torque)
        assert sum(new == "stuck" for _, new in changes) >= 4, "sticks"
        assert sum(old == "stuck" for old, _ in changes) >= 4, "breaks away"
        assert reversals(changes) >= 4, "reverses"
        assert worst < 1e-6

    @pytest.mark.parametrize("joint", [0.0, DEG_45, DEG_90])
    def test_stuck_motor_while_the_arm_rings(self, joint: float):
        worst, changes = run_both({}, at_rest(joint, 0.08), no_torque)
        assert [new for _, new in changes] == ["stuck"]
        assert worst < 1e-6

    def test_undamped_ringing_keeps_its_phase(self):
        # The most that phase errors can add up to: 48 mm of amplitude at the fastest mode for the whole episode.
        worst, _ = run_both({"belt_damping_ratio": 0.0}, at_rest(0.0, 0.08), no_torque)
        assert worst < 1e-4 * 0.048

    @pytest.mark.parametrize("belt_damping_ratio", [0.0, 0.01])
    @pytest.mark.parametrize("torque", [no_torque, wiggle(0.05, 3)])
    def test_zero_friction(self, torque: Torque, belt_damping_ratio: float):
        params = {"coulomb_friction": 0.0, "belt_damping_ratio": belt_damping_ratio}
        worst, changes = run_both(params, at_rest(DEG_45, 0.03), torque)
        assert "stuck" not in [new for _, new in changes] and reversals(changes) >= 4
        assert worst < 1e-6

    # An oiled motor crosses the whole band of sticking within one sample, either way.
    @pytest.mark.parametrize("torsion_speed", [-5.0, 5.0])
    @pytest.mark.parametrize("coulomb_friction", [1e-4, 1e-3])
    def test_little_friction(self, torsion_speed: float, coulomb_friction: float):
        params = {"coulomb_friction": coulomb_friction, "belt_damping_ratio": 0.0}
        worst, changes = run_both(params, at_rest(0.8, 0.0, torsion_speed), no_torque)
        assert changes[0][1] == "stuck" and len(changes) > 8
        assert worst < 1e-6

    @pytest.mark.parametrize("coulomb_friction", [0.032, 0.1])
    def test_fourth_order_across_sticking_and_breaking_away(self, coulomb_friction: float):
        params = ArmParams(coulomb_friction=coulomb_friction)
        torques = [1.5 * coulomb_friction * math.sin(2 * math.pi * 3 * k * CONTROL_PERIOD) for k in range(600)]
        arm = EventLocatedArm(params, at_rest(DEG_45, 0.02))
        exact = []
        for torque in torques:
            arm.advance(torque, CONTROL_PERIOD)
            exact.append(tip(params, arm.state))
        assert sum(old == "stuck" for old, _ in arm.mode_changes) >= 4
        errors = [
            np.linalg.norm(tips(params, at_rest(DEG_45, 0.02), torques, substeps) - exact, axis=1).max()
            for substeps in (1, 2, 4)
        ]
        np.testing.assert_allclose(np.log2(errors[:-1]) - np.log2(errors[1:]), 4.0, atol=0.3)


def tips(params: ArmParams, state: Floats, torques: list[float], substeps: int) -> Floats:
    """Tip positions after each of `torques`, held for a sample that is integrated in `substeps` steps."""
    env = arm_env(asdict(params), state)
    env.set_integration_steps(substeps)
    positions = []
    for torque in torques:
        apply(env, torque)
        positions.append(tip(params, env.state))
    return np.array(positions)


class TestIntegrator:
    @pytest.mark.parametrize("model", [LUMPED, FULL_ARM])
    @pytest.mark.parametrize("direction", [-1.0, 0.0, 1.0])
    def test_rk4_step_is_of_fourth_order_within_a_mode(self, direction: float, model: Model):
        arm = plant(payload_mass=0.1)
        start = ArmState(GEAR * 0.7, 60 * direction, 0.06, 1.5)

        def end(steps: int) -> Floats:
            x = start
            for _ in range(steps):
                x = rk4_step(x, 0.1, direction, 0.048 / steps, arm, model)
            return np.array(x) / [GEAR, GEAR, 1, 1]

        solutions = [end(steps) for steps in (8, 16, 32, 64)]
        halvings = np.linalg.norm(np.diff(solutions, axis=0), axis=1)
        np.testing.assert_allclose(np.log2(halvings[:-1] / halvings[1:]), 4.0, atol=0.25)

    def test_step_of_no_length_changes_nothing(self):
        x = ArmState(70.0, 3.0, 0.01, -0.2)
        assert rk4_step(x, 0.2, 1.0, 0.0, plant(), LUMPED) == x

    def test_where_cubics_that_are_nearly_straight_turn_negative(self):
        rng = np.random.default_rng(0)
        for size in 1000 * [1.0, 1e-3]:
            start, end = size * rng.uniform(0.1, 1), -size * rng.uniform(0.1, 1)
            slopes = (end - start) * rng.uniform(0.7, 1.3, size=2)
            exact = brentq(CubicHermiteSpline([0, 1], [start, end], slopes), 0, 1, xtol=1e-15)
            assert hermite_root(start, slopes[0], end, slopes[1]) == pytest.approx(exact, abs=1e-12)

    def test_where_cubics_that_begin_at_zero_turn_negative(self):
        rng = np.random.default_rng(0)
        for rise, fall, bent in rng.uniform([0.5, 0.5, -0.1], [1.0, 1.0, 0.1], size=(1000, 3)):
            cubic = Polynomial([0.0, rise, -rise - fall, bent])  # once more 0 near u = rise / (rise + fall)
            end, end_slope = float(cubic(1)), float(cubic.deriv()(1))
            exact = brentq(cubic, 0.05, 1, xtol=1e-15)
            assert hermite_root(0.0, rise, end, end_slope) == pytest.approx(exact, abs=1e-12)

    def test_a_cubic_whose_slope_is_zero_where_its_root_is_looked_for(self):
        assert hermite_root(0.125, -0.75, -0.125, -0.75) == pytest.approx(0.5)  # (1/2 - u)^3

    @pytest.mark.parametrize("model", [LUMPED, FULL_ARM])
    @pytest.mark.parametrize("coulomb_friction", [3e-4, 0.032])
    def test_instant_of_stopping_is_located(self, coulomb_friction: float, model: Model):
        arm = plant(coulomb_friction=coulomb_friction)
        rng = np.random.default_rng(0)
        stops = 0
        for _ in range(1500):
            joint, torsion, torsion_speed = rng.uniform([0, -0.05, -2], [DEG_90, 0.05, 2])
            x = ArmState(GEAR * joint, rng.uniform(0, 1), torsion, torsion_speed)
            torque = rng.uniform(-LIMIT, LIMIT)
            y = rk4_step(x, torque, 1.0, CONTROL_PERIOD, arm, model)
            if mode_margin(y, torque, 1.0, arm, model) >= 0:
                continue
            stops += 1
            share, _ = mode_change(x, torque, 1.0, CONTROL_PERIOD, y, arm, model)
            there = rk4_step(x, torque, 1.0, share * CONTROL_PERIOD, arm, model)
            # 15 ns of the sample: 4e-5 rad/s of the motor at most
            assert abs(there.motor_speed) < 1e-5 * abs(y.motor_speed - x.motor_speed), x
        assert stops > 500


def energy(params: ArmParams, states: Floats) -> Floats:
    """Kinetic energy of motor and arm plus the belt's [J]."""
    theta_a, omega_a, theta_s, omega_s = np.atleast_2d(states).T
    phi = theta_a / params.gear_ratio - theta_s
    phi_dot = omega_a / params.gear_ratio - omega_s
    swing = params.arm_inertia_swing + (2 * params.link_length) ** 2 * params.payload_mass
    m2 = params.arm_inertia + swing * np.sin(phi) ** 2
    return 0.5 * (params.motor_inertia * omega_a**2 + m2 * phi_dot**2 + params.belt_stiffness * theta_s**2)


def drift(energies: Floats) -> float:
    """Largest relative departure from the initial energy."""
    return float(np.abs(energies / energies[0] - 1).max())


def unforced(params: ArmParams, state: Floats, m2_slope: bool) -> Floats:
    """The lossless arm integrated by SciPy, with or without the term 1/2 M2' phi'^2: states at the samples."""
    swing = params.arm_inertia_swing + (2 * params.link_length) ** 2 * params.payload_mass

    def rates(_: float, y: Floats) -> list[float]:
        theta_a, omega_a, phi, phi_dot = y
        belt = params.belt_stiffness * (theta_a / params.gear_ratio - phi)
        m2 = params.arm_inertia + swing * math.sin(phi) ** 2
        centrifugal = swing * math.sin(phi) * math.cos(phi) * phi_dot**2 if m2_slope else 0.0
        return [omega_a, -belt / params.gear_ratio / params.motor_inertia, phi_dot, (belt - centrifugal) / m2]

    times = CONTROL_PERIOD * np.arange(EPISODE_STEPS + 1)
    theta_a, omega_a, theta_s, omega_s = state
    start = [theta_a, omega_a, theta_a / params.gear_ratio - theta_s, omega_a / params.gear_ratio - omega_s]
    y = solve_ivp(rates, (0, times[-1]), start, "DOP853", times, rtol=1e-11, atol=1e-12).y
    joint, joint_speed = y[0] / params.gear_ratio, y[1] / params.gear_ratio
    return np.column_stack([y[0], y[1], joint - y[2], joint_speed - y[3]])


class TestEnergy:
    @pytest.mark.parametrize("payload_mass", [0.0, 0.2])
    @pytest.mark.parametrize(
        ("joint", "torsion"),
        [(0.0, 0.1), (0.0, -0.1), (0.2, 0.1), (0.5, -0.1), (DEG_45, 0.1), (1.2, 0.1), (DEG_90, 0.1), (DEG_90, -0.1)],
    )
    def test_conserved_without_losses(self, joint: float, torsion: float, payload_mass: float):
        # RK4 itself loses (58.0/s * 1.5 ms)^6 / 72 = 6e-9 of the energy per step: 7e-6 in 1200 steps.
        env = arm_env({**LOSSLESS, "payload_mass": payload_mass}, at_rest(joint, torsion))
        states = [env.state]
        for _ in range(EPISODE_STEPS):
            apply(env, 0.0)
            states.append(env.state)
        energies = energy(env.params, np.array(states))
        assert energies[0] == pytest.approx(0.5 * 33 * torsion**2)
        assert drift(energies) < 1e-5

    def test_not_conserved_without_the_term_that_the_paper_leaves_out(self):
        params, start = ArmParams(**LOSSLESS), at_rest(DEG_45, 0.1)
        complete, as_printed = unforced(params, start, True), unforced(params, start, False)
        assert drift(energy(params, complete)) < 1e-7
        assert drift(energy(params, as_printed)) > 0.01
        env = arm_env(LOSSLESS, start)
        for _ in range(EPISODE_STEPS):
            apply(env, 0.0)
        assert np.linalg.norm(tip(params, env.state) - tip(params, complete[-1])) < 1e-6
        assert np.linalg.norm(tip(params, env.state) - tip(params, as_printed[-1])) > 1e-3

    @examples(80)
    @given(
        params=st.fixed_dictionaries(
            {
                "motor_inertia": st.floats(3e-5, 1.2e-4),
                "motor_viscous_friction": st.floats(0, 1e-3),
                "coulomb_friction": st.sampled_from([0.0, 0.001, 0.032]) | st.floats(0, 0.1),
                "arm_inertia": st.floats(0.005, 0.03),
                "arm_inertia_swing": st.floats(0, 0.12),
                "payload_mass": st.floats(0, 0.5),
                "belt_stiffness": st.floats(10, 60),
                "belt_damping_ratio": st.floats(0, 0.05),
            }
        ),
        state=st.tuples(st.floats(GEAR * 0.1, GEAR * 1.4), st.floats(-50, 50), st.floats(-0.1, 0.1), st.floats(-3, 3)),
        torques=st.lists(st.sampled_from([0.0, 0.03]) | st.floats(-LIMIT, LIMIT), min_size=1, max_size=6),
    )
    def test_never_created(self, params: dict[str, float], state: tuple[float, ...], torques: list[float]):
        env = arm_env(params, np.array(state))
        states, supplied = [env.state], [0.0]
        for k in range(50 * len(torques)):
            torque = torques[k // 50]
            terminated = env.step(np.array([torque / LIMIT]))[2]
            states.append(env.state)
            supplied.append(supplied[-1] + torque * (states[-1][0] - states[-2][0]))
            if terminated:
                break
        energies = energy(env.params, np.array(states))
        balance = energies - supplied
        created = balance - np.minimum.accumulate(balance)
        assert created.max() <= 1e-5 * energies.max()


def poles(a: Floats) -> NDArray[np.complexfloating[Any, Any]]:
    return np.sort_complex(np.linalg.eigvals(a))


def oscillating(a: Floats) -> complex:
    """The pole of a's oscillating pair in the upper half plane."""
    (pole,) = [pole for pole in np.linalg.eigvals(a) if pole.imag > 1e-6]
    return complex(pole)


def closed_loop(theta_1: float, k4: float = 0.15, k_p: float = 25.0, k_v: float = 20.0, sign: float = 1.0) -> Floats:
    """A - bK of the paper's loop (7), (9), (11) without the belt's damping; sign -1: b as printed in (6e)."""
    params = ArmParams(belt_damping_ratio=0.0)
    a, b, _ = state_space(params, theta_1)
    b[3] *= sign
    m, v = params.motor_inertia, params.motor_viscous_friction
    return a - b @ np.array([[m * k_p, m * k_v - v, 0.0, k4]])


class TestStateSpace:
    @pytest.mark.parametrize(("theta_1", "m2"), [(0.0, 0.01), (DEG_90, 0.07)])
    def test_modes_of_the_arm_alone(self, theta_1: float, m2: float):
        params = ArmParams(belt_damping_ratio=0.0, motor_viscous_friction=0.0)
        a, b, c = state_space(params, theta_1)
        mode = math.sqrt(33 * (1 / (6.3e-5 * GEAR**2) + 1 / m2))
        np.testing.assert_allclose(poles(a), [-1j * mode, 0, 0, 1j * mode], atol=1e-5)
        system = control.StateSpace(a, b, c, np.zeros((2, 1)))
        np.testing.assert_allclose(np.sort_complex(system.poles()), poles(a), atol=1e-5)

    # The design calls these the open-loop modes: the position loop is closed, the vibration feedback open (K4 = 0).
    @pytest.mark.parametrize(("theta_1", "frequency"), [(0.0, 58.0), (DEG_90, 22.6)])
    def test_modes_without_vibration_feedback(self, theta_1: float, frequency: float):
        pole = oscillating(closed_loop(theta_1, k4=0.0))
        assert pole.imag == pytest.approx(frequency, abs=0.05)
        assert 0 < -pole.real / abs(pole) < 0.04

    def test_closed_loop_poles_with_table_2(self):
        slow_pair = [-21.9, -11.9 - 51.7j, -11.9 + 51.7j, -1.34]
        np.testing.assert_allclose(poles(closed_loop(0.0)), slow_pair, atol=0.05)

    def test_sign_printed_in_6e_makes_the_loop_unstable(self):
        pole = oscillating(closed_loop(0.0, sign=-1.0))
        assert pole == pytest.approx(13 + 58j, abs=0.5)

    @pytest.mark.parametrize(("theta_1", "damping"), [(0.0, 0.225), (DEG_90, 0.237)])
    def test_damping_of_the_papers_loop(self, theta_1: float, damping: float):
        a = closed_loop(theta_1)
        frequencies, ratios, _ = control.damp(control.ss(a, np.zeros((4, 1)), np.eye(4), 0), doprint=False)
        assert min(ratios) == pytest.approx(damping, abs=5e-4)
        pole = oscillating(a)
        assert -pole.real / abs(pole) == pytest.approx(damping, abs=5e-4)
        assert np.isclose(frequencies, abs(pole)).sum() == 2

    def test_more_torsion_feedback_is_better_only_up_to_a_point(self):
        gains = np.arange(0.0, 0.4, 0.005)
        damping = []
        for k4 in gains:
            pairs = [pole for pole in np.linalg.eigvals(closed_loop(DEG_90, k4=float(k4))) if pole.imag > 1e-6]
            damping.append(min(-pole.real / abs(pole) for pole in pairs))
        best = int(np.argmax(damping))
        assert gains[best] == pytest.approx(0.17, abs=0.011)
        assert damping[-1] < 0.9 * damping[best] and damping[0] < 0.9 * damping[best]

    @pytest.mark.parametrize("theta_1", [0.0, DEG_45, DEG_90])
    @pytest.mark.parametrize("params", [{}, {"payload_mass": 0.3, "belt_damping_ratio": 0.05, "gear_ratio": 60.0}])
    @pytest.mark.parametrize("model", ["lumped", "lagrangian"])
    def test_agrees_with_finite_differences_of_the_simulated_arm(
        self, theta_1: float, params: dict[str, float], model: str
    ):
        arm = plant(**params, coulomb_friction=0.0)
        gear = 1 / arm.inverse_gear

        def rates(x: Floats, torque: float) -> Floats:
            motor, torsional = accelerations(ArmState(*x.tolist()), torque, 1.0, arm, MODELS[model])
            return np.array([x[1], motor, x[3], torsional])

        at_angle = np.array([gear * theta_1, 0.0, 0.0, 0.0])
        steps = 1e-6 * np.eye(4)
        jacobian = np.array([(rates(at_angle + d, 0.0) - rates(at_angle - d, 0.0)) / 2e-6 for d in steps]).T
        by_torque = (rates(at_angle, 1e-3) - rates(at_angle, -1e-3)) / 2e-3
        a, b, c = state_space(ArmParams(**params), theta_1, model)
        np.testing.assert_allclose(a, jacobian, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(b[:, 0], by_torque, rtol=1e-9)
        np.testing.assert_array_equal(c, [[1, 0, 0, 0], [0, 1, 0, 0]])

    @pytest.mark.parametrize("theta_1", [-0.01, 1.58, 90.0, math.nan, math.inf])
    def test_angles_outside_the_workspace_are_refused(self, theta_1: float):
        with pytest.raises(ValueError, match=r"theta_1 must lie within 0 and pi/2 rad, got "):
            state_space(ArmParams(), theta_1)

    @pytest.mark.parametrize("theta_1", ["90", None, True])
    def test_angles_that_are_no_numbers_are_refused(self, theta_1: Any):
        with pytest.raises(TypeError, match=r"theta_1 must be a number \[rad\], got "):
            state_space(ArmParams(), theta_1)

    def test_unknown_model_is_refused(self):
        with pytest.raises(ValueError, match="model must be one of 'lumped', 'lagrangian', 'mujoco', got 'full'"):
            state_space(ArmParams(), 0.0, "full")


class TestStiction:
    def ring(self, torsion: float) -> Floats:
        """States of an unforced episode with the joint at 30 degrees and a wound-up belt."""
        env = arm_env({}, at_rest(math.pi / 6, torsion))
        states = [env.state]
        for _ in range(EPISODE_STEPS):
            apply(env, 0.0)
            states.append(env.state)
        return np.array(states)

    @pytest.mark.parametrize("torsion", [-0.085, 0.04, 0.085])
    def test_encoder_is_blind_to_an_arm_that_rings_behind_a_stuck_motor(self, torsion: float):
        states = self.ring(torsion)
        assert np.all(states[:, 0] == states[0, 0]) and np.all(states[:, 1] == 0)
        assert np.ptp(states[:200, 2]) > abs(torsion)

    def test_encoder_reads_the_same_count_all_the_time(self):
        env = arm_env({}, at_rest(math.pi / 6, 0.06), encoder_counts=10_000_000)
        observations = [apply(env, 0.0) for _ in range(EPISODE_STEPS)]
        assert np.ptp([decode(o)["motor_angle"] for o in observations]) == 0
        assert all(decode(o)["motor_speed"] == 0 for o in observations)

    def test_beyond_85_mrad_the_belt_moves_the_motor(self):
        threshold = GEAR * 0.032 / 33
        assert threshold == pytest.approx(0.0853, abs=1e-4)
        for torsion, moves in ((0.999 * threshold, False), (1.001 * threshold, True), (-1.001 * threshold, True)):
            states = self.ring(torsion)
            assert (np.ptp(states[:, 0]) > 0) == moves

    @pytest.mark.parametrize("torque", [0.0319, -0.0319, 0.0321, -0.0321])
    def test_motor_starts_only_beyond_coulomb_friction(self, torque: float):
        env = arm_env({}, at_rest(DEG_45))
        start = env.state[0]
        apply(env, torque)
        assert np.sign(env.state[0] - start) == (0 if abs(torque) < 0.032 else np.sign(torque))
