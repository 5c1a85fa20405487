"""The event-located solution of the arm behind its drive, against what is known of it without solving it."""

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy
from driven_arms import UPPER_ENDS, drawn_arms, driven_arm, push
from scipy.integrate import quad

from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS, ArmParams
from beltarm_env.arrays import Floats
from eval.reference.crossing import first_crossing
from eval.reference.drive import Actuator, belt_energy, belt_spring, ripple, ripple_energy
from eval.reference.event_located import EventLocatedArm, tip
from eval.reference.symbolic_arm import derive, masses_of

GEAR = 88.0
MODELS = ("lumped", "lagrangian")
LOSSLESS = {"coulomb_friction": 0.0, "motor_viscous_friction": 0.0, "belt_damping_ratio": 0.0}
CONSERVATIVE = {
    **LOSSLESS,
    **{"torque_ripple": 0.006, "torque_ripple_order": 7, "torque_ripple_phase": 1.0},
    **{"kinematic_error": 0.0005, "kinematic_error_phase": 2.0, "belt_stiffening": 0.25},
}


# Its parts


def test_the_belts_energy_is_the_integral_of_its_torque():
    params = ArmParams(belt_stiffening=0.25)
    for torsion in (-0.06, 0.002, 0.01, 0.08):
        assert belt_energy(params, torsion) == pytest.approx(quad(lambda t: belt_spring(params, t), 0, torsion)[0])
    assert belt_spring(params, 0.01) == pytest.approx(33 * 0.01), "mean stiffness at theta_0"
    assert belt_spring(params, 1e-6) == pytest.approx(33 * 0.75e-6, rel=1e-6)
    assert belt_spring(params, 10.0) == pytest.approx(33 * 12.5, rel=1e-5)


def test_the_ripples_energy_is_minus_the_integral_of_its_torque():
    params = ArmParams(torque_ripple=0.006, torque_ripple_order=5, torque_ripple_phase=1.0)
    for angle in (-3.0, 0.1, 70.0):
        slope = (ripple_energy(params, angle + 1e-5) - ripple_energy(params, angle - 1e-5)) / 2e-5
        assert slope == pytest.approx(-ripple(params, angle), abs=1e-9)


@pytest.mark.parametrize("latency", [0.0, 0.4, 1.0, 1.5, 2.7, 3.0])
def test_a_command_acts_after_the_latency(latency: float):
    actuator = Actuator(ArmParams(command_latency=latency * CONTROL_PERIOD, torque_constant_error=0.08))
    time, seen = 0.0, 0
    for k in range(8):
        for duration, torque in actuator.pieces(0.1 * (k + 1)):
            middle = (time + 0.5 * duration) / CONTROL_PERIOD - latency  # when its command was given, in samples
            given = 0.1 * (math.floor(middle) + 1) if middle > 0 else 0.0
            assert torque(0.5 * duration) == pytest.approx(1.08 * given, abs=1e-15)
            time, seen = time + duration, seen + 1
        assert time == pytest.approx((k + 1) * CONTROL_PERIOD, rel=1e-12)
    assert seen == (8 if latency == int(latency) else 16)


def test_the_current_loop_is_of_first_order():
    actuator = Actuator(ArmParams(current_loop_time_constant=0.001, command_latency=0.5 * CONTROL_PERIOD))
    list(actuator.pieces(0.2))
    assert actuator.torque == pytest.approx(0.2 * (1 - math.exp(-0.75)), rel=1e-14)
    list(actuator.pieces(0.0))
    left = 0.2 * (1 - math.exp(-1.5))
    assert actuator.torque == pytest.approx(left * math.exp(-0.75), rel=1e-14)


@pytest.mark.parametrize("model", MODELS)
def test_equations_follow_from_the_energy(model: str):
    """Lagrange's equations in (alpha, phi), with theta_1 = alpha + e sin(2 G alpha + phi_e) put into the energy."""
    params = ArmParams(kinematic_error=0.001, kinematic_error_phase=0.7, payload_mass=0.1, arm_inertia_swing=0.08)
    matrix, bias = lagrange(model, params)
    rng = np.random.default_rng(0)
    for _ in range(50):
        alpha, phi, alpha_rate, phi_rate = rng.uniform([-0.5, -0.5, -3, -3], [2, 2, 3, 3])
        x = np.array([GEAR * alpha, GEAR * alpha_rate, alpha - phi, alpha_rate - phi_rate])
        arm = EventLocatedArm(params, x, model)
        found = arm.equations(np.array([alpha, phi, alpha_rate, phi_rate]))
        np.testing.assert_allclose(arm.mass_matrix(), matrix(alpha, phi, alpha_rate, phi_rate), rtol=1e-11)
        np.testing.assert_allclose([found.c1, found.c2], bias(alpha, phi, alpha_rate, phi_rate), atol=1e-10)


@cache
def lagrange(model: str, params: ArmParams) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Mass matrix and bias as functions of alpha, phi and their rates."""
    q = alpha, phi = sympy.symbols("alpha phi", real=True)
    u = alpha_rate, phi_rate = sympy.symbols("alpha_rate phi_rate", real=True)
    theta_1 = alpha + params.kinematic_error * sympy.sin(2 * GEAR * alpha + params.kinematic_error_phase)
    if model == "lumped":
        swing = params.arm_inertia_swing + (2 * params.link_length) ** 2 * params.payload_mass
        links = (params.arm_inertia + swing * sympy.sin(phi) ** 2) * phi_rate**2 / 2
    else:
        derived = derive()
        put = dict(zip(derived.masses, masses_of(params)._replace(motor=0.0), strict=True))
        motion = (theta_1, phi, theta_1.diff(alpha) * alpha_rate, phi_rate)
        put |= dict(zip((*derived.angles, *derived.rates), motion, strict=True))
        links = derived.kinetic_energy.subs(put, simultaneous=True)
    energy = sympy.Matrix([params.motor_inertia * GEAR**2 * alpha_rate**2 / 2 + links])
    momentum = energy.jacobian(u)
    bias = momentum.jacobian(q) * sympy.Matrix(u) - energy.jacobian(q).T
    arguments = (*q, *u)
    return sympy.lambdify(arguments, momentum.jacobian(u), "numpy"), sympy.lambdify(arguments, list(bias), "numpy")


@pytest.mark.parametrize("model", MODELS)
def test_motion_follows_from_the_equations_of_links_and_motor(model: str):
    """The motor's equation with the harmonic drive's torque Lambda on link 1, from which g Lambda goes back."""
    params = ArmParams(**{**UPPER_ENDS, "kinematic_error": 0.0005, "kinematic_error_phase": 0.7})
    rng = np.random.default_rng(1)
    for _ in range(50):
        joint, speed, torsion, torsion_rate, torque, friction = rng.uniform(-1, 1, 6) * [1, 80, 0.05, 2, 0.3, 0.1]
        x = np.array([GEAR * (0.7 + 0.5 * joint), speed, torsion, torsion_rate])
        arm = driven_arm(params, x, model)
        (_, _, alpha, phi), _ = arm.rates(torque, friction)
        phase = 2 * x[0] + 0.7
        g, bend = 1 / GEAR + 0.001 * math.cos(phase), -0.002 * math.sin(phase)
        link = g * GEAR * alpha + bend * speed**2  # theta_1''
        stretched = torsion + 0.0005 * math.sin(phase)
        rate = torsion_rate + 0.001 * math.cos(phase) * speed
        damping = 2 * 0.01 * math.sqrt(33 * 0.07)
        belt = 33 * (0.75 + 0.5 * stretched**2 / (stretched**2 + 1e-4)) * stretched + damping * rate
        theta_1, phi_angle = arm.angles
        terms = arm._terms(theta_1, phi_angle, g * speed, speed / GEAR - torsion_rate)
        through = terms[0] * link + terms[1] * phi + terms[3] + belt
        ripple_torque = params.torque_ripple * math.sin(params.torque_ripple_order * x[0] + params.torque_ripple_phase)
        motor = torque + ripple_torque - 3.5e-4 * speed - friction - g * through
        assert 6.3e-5 * GEAR * alpha == pytest.approx(motor, abs=1e-12)
        assert terms[1] * link + terms[2] * phi + terms[4] == pytest.approx(belt, abs=1e-11)
        assert theta_1 - phi_angle == pytest.approx(stretched, abs=1e-15)


def test_the_tip_turns_with_the_belts_torsion():
    params = ArmParams(kinematic_error=0.0005, kinematic_error_phase=0.7)
    state = np.array([60.0, 0.0, 0.02, 0.0])
    torsion, phi = 0.02 + 0.0005 * math.sin(120.7), 60 / GEAR - 0.02
    reach = 0.5 * math.cos(phi) + 0.1
    expected = [reach * math.cos(torsion), reach * math.sin(torsion)]
    np.testing.assert_allclose(tip(params, state), expected, atol=1e-15)


def test_the_motor_breaks_away_beyond_static_friction_and_then_slides_more_easily():
    params = ArmParams(static_friction_excess=0.5, friction_variation=0.25, friction_variation_phase=1.0)
    start = np.array([60.0, 0.0, 0.0, 0.0])
    level = 0.032 * (1 + 0.25 * math.sin(121.0))
    for share, moves in ((1.4999, False), (1.5001, True)):
        arm = EventLocatedArm(params, start)
        arm.advance(share * level, 0.05)
        assert (arm.state[0] > 60) == moves
    sliding = EventLocatedArm(params, start + np.array([0, 3, 0, 0]))
    assert sliding.dry_friction(np.array([60 / GEAR, 0, 3 / GEAR, 0])) == pytest.approx(1.25 * level)


def test_friction_drifts_from_sample_to_sample():
    arm = EventLocatedArm(ArmParams(friction_drift=0.15), np.array([60.0, 0.0, 0.0, 0.0]))
    levels = []
    for _ in range(EPISODE_STEPS):
        arm.sample(0.0)
        levels.append(arm.dry_friction(arm._y))
    assert levels[0] == pytest.approx(0.032 * (1 + 0.15 * 0.5 / 1200), rel=1e-14)
    assert np.mean(levels) == pytest.approx(0.032 * 1.075, rel=1e-14)
    assert levels[-1] == pytest.approx(0.032 * (1 + 0.15 * 1199.5 / 1200), rel=1e-14)


def crossing(function: Callable[[float], float], times: Floats) -> float | None:
    return first_crossing(function, times, [function(t) for t in times.tolist()])


@pytest.mark.parametrize(("depth", "crosses"), [(-1e-9, True), (1e-9, False)])
def test_a_dip_between_two_looks_is_found(depth: float, crosses: bool):
    times = np.linspace(0, 1, 9)
    for lowest in (0.02, 0.31, 0.5, 0.55, 0.97):
        found = crossing(lambda t, at=lowest: (t - at) ** 2 + depth, times)
        assert (found is not None) == crosses
        if found is not None:
            assert found == pytest.approx(lowest - math.sqrt(1e-9), abs=1e-9)


def test_a_function_that_rises_from_zero_crosses_where_it_comes_back():
    times = np.linspace(0, 1, 9)
    assert crossing(lambda t: t, times) is None
    assert crossing(lambda t: t * (0.7 - t), times) == pytest.approx(0.7, rel=1e-12)
    assert crossing(lambda t: t * (1e-9 - t), times) == times[1]


# What moves


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("params", [{}, {"payload_mass": 0.2, "coulomb_friction": 0.05}, {"coulomb_friction": 0.0}])
def test_ideal_drive_holds_the_command(params: dict[str, float], model: str):
    arms = [EventLocatedArm(ArmParams(**params), np.array([60.0, 0.0, 0.02, 0.0]), model) for _ in range(2)]
    for k in range(400):
        arms[0].sample(push(k))
        arms[1].advance(push(k), CONTROL_PERIOD)
        np.testing.assert_array_equal(arms[0].state, arms[1].state)
        assert arms[0].motor_torque == push(k)
    assert arms[0].mode_changes == arms[1].mode_changes


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("more", [{}, {"kinematic_error": 0.005}, {"belt_stiffening": 0.9}, {"payload_mass": 0.2}])
def test_energy_is_conserved_without_losses(more: dict[str, float], model: str):
    arm = EventLocatedArm(ArmParams(**{**CONSERVATIVE, **more}), np.array([0.5 * GEAR, 30.0, 0.06, -1.0]), model)
    before, angles = arm.energy, []
    for _ in range(600):
        arm.sample(0.0)
        angles.append(arm.state[0])
        assert arm.energy == pytest.approx(before, rel=2e-10)
    assert np.ptp(angles) > 2 * math.pi, "more than a turn of the motor"


@pytest.mark.parametrize("model", MODELS)
def test_only_the_factor_g_on_the_motor_conserves_energy(model: str):
    """With 1 / G in its place the energy drifts: what the last test can see."""
    params = ArmParams(**CONSERVATIVE)

    class Careless(EventLocatedArm):
        def rates(self, torque: float, friction: float | None, y: Any = None) -> tuple[list[float], float]:
            e = self.equations(self._y if y is None else y)
            return super().rates(torque + (e.slope - 1) * e.belt / GEAR, friction, y)

    arm = Careless(params, np.array([0.5 * GEAR, 30.0, 0.06, -1.0]), model)
    before = arm.energy
    for _ in range(600):
        arm.sample(0.0)
    assert abs(arm.energy / before - 1) > 1e-4


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("stribeck_speed", [1.0, 10.0])
def test_losses_never_give_energy(stribeck_speed: float, model: str):
    params = ArmParams(**{**UPPER_ENDS, "stribeck_speed": stribeck_speed})
    arm = EventLocatedArm(params, np.array([0.5 * GEAR, 30.0, 0.06, -1.0]), model)
    energies = [arm.energy]
    for _ in range(800):
        arm.sample(0.0)
        energies.append(arm.energy)
    assert np.diff(energies).max() < 1e-13
    lowest = -params.torque_ripple / params.torque_ripple_order
    assert energies[-1] - lowest < 0.5 * (energies[0] - lowest)
    assert arm.mode == "stuck"


@pytest.mark.parametrize("model", MODELS)
def test_work_of_the_drive_is_what_is_stored_and_lost(model: str):
    """Energy less the motor's work falls by what friction and belt take, integrated beside it on a fine grid."""
    params = ArmParams(**UPPER_ENDS)
    arm = driven_arm(params, np.array([60.0, 0.0, 0.0, 0.0]), model)
    stored, balance = arm.energy, 0.0
    for k in range(500):
        arm._drifted = 1 + 0.15 * (k + 0.5) / 1200
        for duration, torque in arm._actuator.pieces(push(k)):
            for j in range(8):
                before, first = arm.state, arm._y.copy()
                share = duration / 8
                arm._pass(lambda t, j=j, share=share, torque=torque: torque(t + j * share), share)
                turned = arm.state[0] - before[0]
                mean = np.mean([torque((j + s) * share) for s in (0.0, 1.0)])
                speeds, ys = (before[1], arm.state[1]), (first, arm._y)
                friction = [arm.dry_friction(y) * abs(w) for y, w in zip(ys, speeds, strict=True)]
                viscous = [arm._drifted * 3.5e-4 * w * w for w in speeds]
                rates = [arm.equations(y).slope * y[2] - y[3] for y in ys]
                belt = [arm._damping * r * r for r in rates]
                balance += mean * turned - share * np.mean(np.array(friction) + viscous + belt)
    assert arm.energy - stored == pytest.approx(balance, abs=2e-5)
    assert sum(mode == "stuck" for _, mode in arm.mode_changes) >= 3


@pytest.mark.parametrize("number", range(4))
def test_many_small_steps_of_the_equations_as_written_lead_there(number: int):
    params = ArmParams(**drawn_arms(4, seed=8)[number])
    start = np.array([GEAR * 0.7, 0.0, 0.02, 0.0])
    arm = driven_arm(params, start, "lumped")
    commands = [push(k) for k in range(300)]
    for command in commands:
        arm.sample(command)
    assert sum(mode == "stuck" for _, mode in arm.mode_changes) >= 1
    distances = []
    for steps in (10, 100):
        there = stepped(params, start, commands, steps)
        distances.append(np.linalg.norm(tip(params, arm.state) - tip(params, there)))
    assert distances[1] < 3e-8
    assert distances[1] < 0.2 * distances[0]


def stepped(p: ArmParams, state: np.ndarray, commands: list[float], steps: int) -> np.ndarray:
    """State of the lumped arm after some commands, in steps of Runge and Kutta that know of no events.

    A step at whose beginning the motor rests and is held leaves it at rest; one in which it would reverse ends at rest.
    """
    dt, swing = CONTROL_PERIOD / steps, p.arm_inertia_swing + 4 * p.link_length**2 * p.payload_mass
    damping = 2 * p.belt_damping_ratio * math.sqrt(p.belt_stiffness * (p.arm_inertia + p.arm_inertia_swing))

    def pull(x: np.ndarray) -> tuple[float, float, float]:
        angle, speed, phi, phi_rate, torque = x.tolist()
        phase = 2 * angle + p.kinematic_error_phase
        g = 1 / p.gear_ratio + 2 * p.kinematic_error * math.cos(phase)
        torsion = angle / p.gear_ratio + p.kinematic_error * math.sin(phase) - phi
        share = torsion**2 / (torsion**2 + p.belt_stiffening_torsion**2)
        stiffness = p.belt_stiffness * (1 - p.belt_stiffening + 2 * p.belt_stiffening * share)
        belt = stiffness * torsion + damping * (g * speed - phi_rate)
        own = p.torque_ripple * math.sin(p.torque_ripple_order * angle + p.torque_ripple_phase)
        level = p.coulomb_friction * (1 + p.friction_variation * math.sin(2 * angle + p.friction_variation_phase))
        return torque + own - g * belt, level, belt

    def rates(x: np.ndarray, direction: float, drift: float, target: float) -> np.ndarray:
        _, speed, phi, phi_rate, torque = x.tolist()
        drive, level, belt = pull(x)
        excess = p.static_friction_excess / (1 + (speed / p.stribeck_speed) ** 2)
        slides = drive - drift * (p.motor_viscous_friction * speed + direction * level * (1 + excess))
        m2 = p.arm_inertia + swing * math.sin(phi) ** 2
        arm = (belt - 0.5 * swing * math.sin(2 * phi) * phi_rate**2) / m2
        motor = slides / p.motor_inertia if direction else 0.0
        return np.array([speed, motor, phi_rate, arm, (target - torque) / p.current_loop_time_constant])

    x = np.array([state[0], state[1], state[0] / GEAR - state[2], state[1] / GEAR - state[3], 0.0])
    late = p.command_latency / CONTROL_PERIOD
    for j in range(len(commands) * steps):
        drift = 1 + p.friction_drift * (j // steps + 0.5) * CONTROL_PERIOD / 1.8
        given = math.floor((j + 0.5) / steps - late)
        target = (1 + p.torque_constant_error) * (commands[given] if given >= 0 else 0.0)
        direction = np.sign(x[1])
        if direction == 0:
            drive, level, _ = pull(x)
            direction = np.sign(drive) if abs(drive) > drift * level * (1 + p.static_friction_excess) else 0.0
        first = rates(x, direction, drift, target)
        second = rates(x + 0.5 * dt * first, direction, drift, target)
        third = rates(x + 0.5 * dt * second, direction, drift, target)
        fourth = rates(x + dt * third, direction, drift, target)
        x = x + dt / 6 * (first + 2 * second + 2 * third + fourth)
        if direction * x[1] < 0:
            x[1] = 0.0
    return np.array([x[0], x[1], x[0] / GEAR - x[2], x[1] / GEAR - x[3]])
