"""What controllers know of their arm: simulation, linear models, friction, flat motions."""

import math
from dataclasses import asdict, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples
from refusals import refused
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from baselines.models import friction as dry
from baselines.models.flatness import CORNERS, flat_point, link_motion, write_corners
from baselines.models.linear import ANGLES, at_angle, linear_arm, linear_arm_of, turning_load
from baselines.models.rigid_arm import rigid_torque
from baselines.optimal.adaptive import AdaptiveController
from baselines.planning.plan import Problem, Weights, set_step
from baselines.servo.flat import FlatController, FlatGains, joint_motion
from beltarm_env import CONTROL_PERIOD, ArmParams, BeltArmVectorEnv, state_space
from beltarm_env.arm import params_table
from beltarm_env.arrays import Floats
from beltarm_env.physics.models import MODELS
from beltarm_env.rollout import rollout
from beltarm_env.simulation import ArmSimulation
from beltarm_env.task.ranges import design_model
from beltarm_env.task.reference import TRAPEZOID, MoveShape, Reference, reference_at

GEAR = 88.0
NOMINAL = ArmParams()


@pytest.mark.parametrize(("model", "randomization"), [("lumped", "train"), ("lagrangian", "ideal")])
def test_simulation_is_the_environment_bit_for_bit(model: Any, randomization: Any):
    rng = np.random.default_rng(0)
    env = BeltArmVectorEnv(150, autoreset_mode="Disabled", model=model, randomization=randomization)
    latency = np.concatenate([CONTROL_PERIOD * np.arange(4.0), rng.uniform(0, 3 * CONTROL_PERIOD, 146)])
    drives = {} if randomization == "ideal" else {"friction_drift": 0.0, "command_latency": latency}
    env.reset(seed=5_000_000, options={"params": drives})
    simulation = ArmSimulation(env.params, model=model)
    states = simulation.at_rest(env.state[:, 0])
    states[:, :4] = env.state
    for _ in range(80):
        action = rng.uniform(-0.6, 0.6, (150, 1)).astype(np.float32)
        env.step(action)
        before = states.copy()
        following = simulation.advance(states, 0.3 * action[:, 0].astype(np.float64))
        np.testing.assert_array_equal(states, before, "what was given is left alone")
        states = following
    np.testing.assert_array_equal(states[:, :4], env.state)


def test_what_does_not_fit_is_refused():
    simulation = ArmSimulation([ArmParams()] * 2)
    for words, call in (
        (("(1, 4)",), lambda: simulation.advance(np.zeros((1, 4)), np.zeros(2))),
        (("torques", "nan"), lambda: simulation.advance(np.zeros((2, 4)), np.full(2, math.nan))),
        (("samples", "-1"), lambda: simulation.ahead(np.zeros((2, 4)), np.zeros(2), np.array([0.0, -1.0]))),
        (("136 arms", "137"), lambda: simulation.set_table(params_table([ArmParams()] * 137))),
        (("'lumped', 'lagrangian'", "'mujoco'"), lambda: ArmSimulation(ArmParams(), model="mujoco")),
        (("'lumped', 'lagrangian'", "'mujoco'"), lambda: AdaptiveController(model="mujoco")),
        (("fastest rate is 1.84e+03", "less than 333"), lambda: linear_arm(ArmParams(belt_stiffness=3.3e4))),
    ):
        refused(ValueError, words, call)


def test_linear_models_are_the_exponential_of_the_continuous_one_and_interpolated():
    for arm in (ArmParams(), ArmParams(payload_mass=0.3, belt_stiffness=40.0, belt_damping_ratio=0.02)):
        tables = linear_arm(arm)
        for k in (0, 17, 45):
            (a, b, _), held = state_space(arm, float(ANGLES[k])), np.zeros((6, 6))
            held[:4, :4], held[:4, 4:5], held[3, 5] = a, b, 1.0
            stepped = expm(CONTROL_PERIOD * held)
            np.testing.assert_allclose(tables.transition[k], stepped[:4, :4], rtol=1e-11, atol=1e-13)
            np.testing.assert_allclose(tables.by_torque[k], stepped[:4, 4], rtol=1e-11)
            np.testing.assert_allclose(tables.by_acceleration[k], stepped[:4, 5], rtol=1e-9, atol=1e-13)
    table = linear_arm(ArmParams()).by_torque
    between = at_angle(table, np.array([0.5 * (ANGLES[3] + ANGLES[4]), -0.2, 1.8]))
    np.testing.assert_allclose(between, [0.5 * (table[3] + table[4]), table[0], table[-1]])


@pytest.mark.parametrize("model", ["lumped", "lagrangian"])
def test_a_plans_step_is_the_simulations_along_a_moving_reference(model: str):
    """With the torque by which turning pulls at the arm, within a tenth of it; of either model."""
    arm = ArmParams(coulomb_friction=0.0, payload_mass=0.2)
    simulation, linear = ArmSimulation(arm, model=model), linear_arm_of(arm.row(), MODELS[model])
    problem = Problem(MoveShape(0.0, 1.0, 1.0, 0.2), arm.plant(), 0.3, linear, Weights(), 667)
    for angle, speed, torque in ((0.5, 1.5, 0.0), (1.2, -2.0, 0.1), (0.8, 2.0, -0.2)):
        a, b, d, after = np.empty((4, 4)), np.empty(4), np.empty(4), angle + speed * CONTROL_PERIOD
        set_step(problem, Reference(angle, speed, 0.0), Reference(after, speed, 0.0), a, b, d)
        x = simulation.advance(np.array([[GEAR * angle, GEAR * speed, 0.0, 0.0]]), np.array([torque]))[0]
        m2, turning = turning_load(angle, speed, arm.plant())
        pull = at_angle(linear.by_acceleration, np.array([angle]))[0] * turning / m2
        actual, expected = d + b * torque, x - [GEAR * after, GEAR * speed, 0.0, 0.0]
        np.testing.assert_allclose(actual[:2], expected[:2], rtol=1e-3)
        assert (abs(actual - expected)[2:] < abs(pull[2:]) / 10).all()


@pytest.mark.parametrize("angle", [0.0, 0.7, math.pi / 2])
def test_computed_torque_makes_the_rigid_arm_accelerate_as_wanted(angle: float):
    # Lagrange for T = (G^2 M_a1 + M2) theta_1'^2 / 2, with dM2/dtheta_1 by differencing.
    speed, acceleration, h = 2.0, 7.0, 1e-5
    m2 = [0.01 + 0.06 * math.sin(angle + step) ** 2 for step in (-h, 0, h)]
    joint_torque = (88**2 * 6.3e-5 + m2[1]) * acceleration + 0.5 * (m2[2] - m2[0]) / (2 * h) * speed**2
    actual = rigid_torque(Reference(angle, speed, acceleration), NOMINAL.plant())
    np.testing.assert_allclose(88 * actual, joint_torque, rtol=1e-8)


class TestFriction:
    def test_level_falls_from_breakaway_to_coulomb_friction_and_the_direction_goes_through_zero(self):
        friction = dry.dry_friction(ArmParams(static_friction_excess=0.4, stribeck_speed=5.0).row())
        actual = [dry.friction_level(friction, speed) for speed in (0.0, 5.0, -5.0, 1e6)]
        np.testing.assert_allclose(actual, [0.032 * 1.4, 0.032 * 1.2, 0.032 * 1.2, 0.032])
        motions = (0.0, 0.0), (0.0, 0.01), (0.0, -9.0), (0.5, 0.0), (9.0, -0.01), (0.5, -0.01), (-9.0, 0.0)
        of = dry.SmoothCompensation(dry.dry_friction(ArmParams(coulomb_friction=1.0).row()), 1.0, 1.0, 0.02)
        actual = [dry.smooth_friction(of, speed, torque) for speed, torque in motions]
        np.testing.assert_allclose(actual, [0, 0.5, -1, 0.5, 1, 0, -1])

    def test_direction_is_commanded_while_moving_and_pushed_at_rest(self):
        of = dry.Compensation(dry.dry_friction(ArmParams().row()), 1.0, 0.01)
        for speed, acceleration, push, expected in (
            *((2.0, 0.0, -9.0, 1), (-0.1, 0.0, 9.0, -1), (0.0, 5.0, -9.0, 1), (0.0, 0.0, 9.0, 1)),
            *((0.0, 0.0, -0.005, -0.5), (1e-16, 0.0, 0.0, 0)),  # which rests, but for rounding
        ):
            _, actual = dry.compensated(Reference(0.0, speed, acceleration), push, GEAR, of)
            assert actual == pytest.approx(expected, rel=1e-7)


UNDAMPED = ArmParams(belt_damping_ratio=0.0)
MOVES = st.builds(
    lambda start, length, duration, share: np.array([start, start + length, duration, share * duration]),
    *(st.floats(*within) for within in ((0.0, 0.6), (0.26, 0.97), (0.5, 1.2), (0.15, 0.35))),
)


def smoothed(move: Floats, params: ArmParams, first: float, others: float) -> Floats:
    corners = np.empty(CORNERS)
    write_corners(MoveShape(*move), params.plant(), first, others, corners)
    return corners


def links(corners: Floats, times: Floats) -> Floats:
    """Angle of the link and its first three derivatives at some times, shape (n, 4)."""
    return np.array([link_motion(corners, time, 1.0)[:4] for time in times])


@given(MOVES, st.floats(0.02, 2.0), st.floats(0.02, 2.0))
@examples(40)
def test_a_smoothed_move_begins_and_arrives_as_the_task_and_meets_it_between(move: Floats, first: float, others: float):
    corners = smoothed(move, UNDAMPED, first, others)
    start, goal, duration, ramp = move
    onsets, spreads, ends = corners[1:5], corners[5:9], corners[1:5] + corners[5:9]
    assert onsets[0] == 0.0 and (onsets >= 0).all() and spreads[0] <= 0.5 * ramp + 1e-12
    assert spreads.max() <= ramp and ends[3] <= duration + 0.5 * ramp + 1e-12
    link = links(corners, np.array([0.0, ends[3], 1.8]))
    np.testing.assert_allclose(link[:, 0], [start, goal, goal], atol=1e-12)
    np.testing.assert_allclose(link[:, 1:4], 0.0, atol=1e-9)
    cruising = np.linspace(max(ends[1], ramp), min(onsets[2], duration - ramp), 5)
    if cruising[0] < cruising[-1]:
        task = [reference_at(TRAPEZOID, MoveShape(*move), t)[:2] for t in cruising]
        np.testing.assert_allclose(links(corners, cruising)[:, :2], task, atol=1e-12)


def integrate(corners: Floats, p: ArmParams) -> tuple[Floats, Floats]:
    """Times, and states of (5a), (5b) under the flat torque without Coulomb friction: the equations written anew."""
    swing = p.arm_inertia_swing + (2 * p.link_length) ** 2 * p.payload_mass
    damping = 2 * p.belt_damping_ratio * math.sqrt(p.belt_stiffness * (p.arm_inertia + p.arm_inertia_swing))

    def rates(time: float, y: Floats) -> list[float]:
        theta, phi, theta_rate, phi_rate = y
        torque = flat_point(corners, time, p.plant()).torque
        belt = p.belt_stiffness * (theta - phi) + damping * (theta_rate - phi_rate)
        viscous = p.motor_viscous_friction * GEAR * theta_rate
        motor = (torque - viscous - belt / GEAR) / (p.motor_inertia * GEAR)
        m2, half_slope = p.arm_inertia + swing * math.sin(phi) ** 2, swing * math.sin(phi) * math.cos(phi)
        return [theta_rate, phi_rate, motor, (belt - half_slope * phi_rate**2) / m2]

    first = flat_point(corners, 0.0, p.plant())
    y = np.array([first[0] / GEAR, first[0] / GEAR - first[2], first[1] / GEAR, first[1] / GEAR - first[3]])
    knots = np.unique(corners[1:5] + np.outer([0.0, 0.5, 1.0], corners[5:9]))  # where the fourth derivative jumps
    times, states = [0.0], [y]
    for begin, end in pairwise([*knots, 1.5]):
        if end - begin < 1e-9:
            continue
        instants = np.linspace(begin, np.nextafter(end, begin), 8)
        run = solve_ivp(rates, (begin, instants[-1]), states[-1], "DOP853", instants[1:], rtol=1e-11, atol=1e-12)
        times += [*instants[1:]]
        states += [*run.y.T]
    y = np.array(states)
    return np.array(times), np.column_stack([GEAR * y[:, 0], GEAR * y[:, 2], y[:, 0] - y[:, 1], y[:, 2] - y[:, 3]])


@pytest.mark.parametrize(("move", "payload"), [((0.2, 1.4, 0.9, 0.25), 0.0), ((1.5, 0.1, 1.0, 0.2), 0.3)])
def test_flat_torque_drives_the_undamped_arm_along_the_smoothed_move(move: Any, payload: float):
    params = ArmParams(belt_damping_ratio=0.0, payload_mass=payload)
    corners = smoothed(move, params, 0.3, 0.7)
    times, states = integrate(corners, params)
    planned = np.array([flat_point(corners, time, params.plant())[:4] for time in times])
    np.testing.assert_allclose(states, planned, atol=1e-7)
    np.testing.assert_allclose(states[:, 0] / GEAR - states[:, 2], links(corners, times)[:, 0], atol=1e-9)
    assert np.abs(planned[:, 2]).max() > 0.01, "the belt gives way"


KNOWN = replace(design_model(), coulomb_friction=0.0, belt_stiffening=0.0)
MOVE = {"start": 0.2, "goal": 1.4, "duration": 0.9, "ramp_time": 0.25}


def test_a_known_arm_follows_the_flat_motion_with_hardly_any_feedback():
    weak = FlatGains(angle=10.0, speed=5.0, integral=0.01, friction=0.0)
    corners = smoothed(np.array([*MOVE.values()]), KNOWN, weak.first_spread, weak.spread)

    def error(believed: ArmParams) -> float:
        """Largest error of the motor from the flat motion on an arm that is known in all but its friction [rad]."""
        options = {"params": asdict(KNOWN), "move": MOVE}
        run = rollout(FlatController(weak, believed), 1, options=options, encoder_counts=10_000_000)
        wanted = [joint_motion(corners, time, KNOWN.plant()).angle for time in run.time]
        return np.abs(run.state[:, 0, 0] - 88 * np.array(wanted)).max()

    assert error(KNOWN) < 0.05  # of 106 rad
    late = replace(KNOWN, command_latency=KNOWN.command_latency + CONTROL_PERIOD)
    assert error(late) > 3 * error(KNOWN)
