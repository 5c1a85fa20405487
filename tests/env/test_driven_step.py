"""Pieces of the integration behind a drive as it is built, each against a closed form."""

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from driven_arms import driven_arm
from scipy.integrate import quad
from scipy.linalg import expm
from scipy.optimize import brentq

from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arm import Plant
from beltarm_env.kernels.exits import EXIT, EXIT_ROWS, find_exits, store_margin
from beltarm_env.kernels.layout import LANES
from beltarm_env.physics.drive import (
    Drive,
    angles_near,
    angles_of,
    belt_stiffness,
    built_drive,
    coupling,
    decay,
    drive_of,
    turned,
)
from beltarm_env.physics.driven.events import Margin, dips, leaves_mode, lowest_point
from beltarm_env.physics.driven.step import driven_step, fit_of, needed_rate, step_length
from beltarm_env.physics.driven.torque import Lag, response, shares_of_two, torques_of_lag, torques_of_two
from beltarm_env.physics.friction import friction_torque
from beltarm_env.physics.models import (
    FULL_ARM,
    LUMPED,
    Model,
    acceleration_per_torque,
    accelerations_at,
    driving_torque_at,
    driving_torque_rate_at,
)
from beltarm_env.physics.state import ArmState
from beltarm_env.physics.trigonometry import wrapped
from beltarm_env.task.ranges import DRIVE_RANGES

PARAMS = ArmParams(**{name: high for name, (_, high) in DRIVE_RANGES.items()})
PLANT, DRIVE = PARAMS.plant(), drive_of(PARAMS.row())


@pytest.mark.parametrize("ratio", [0.0, 1e-9, 0.3, 1.0, 7.5, 8.0, 20.0, 39.0])
def test_decay_is_an_exponential(ratio: float):
    assert decay(ratio) == pytest.approx(math.exp(-ratio), rel=1e-14 if ratio <= 8 else 1e-9, abs=0)


def test_decay_of_a_long_time_is_nothing():
    assert 0 <= decay(1e9) < 1e-17


@pytest.mark.parametrize("angle", [0.0, 3.0, -3.0, 7.0, 1234.5, -2000.0])
def test_wrapped_leaves_out_whole_turns(angle: float):
    assert abs(wrapped(angle)) <= math.pi + 1e-12
    assert math.cos(wrapped(angle)) == pytest.approx(math.cos(angle), abs=1e-12)
    assert math.sin(wrapped(angle)) == pytest.approx(math.sin(angle), abs=1e-12)


def test_angles_turn_with_the_motor():
    x = ArmState(61.0, 100.0, 0.02, 0.5)
    for turn in (0.0, 0.05, -0.1):
        there = angles_of(ArmState(61.0 + turn, 100.0, 0.02 + turn / 88, 0.5), PLANT, DRIVE)
        np.testing.assert_allclose(turned(angles_of(x, PLANT, DRIVE), turn, DRIVE), there, atol=1e-12)


def test_angles_nearby_are_right_to_the_fourth_order():
    x, errors = ArmState(61.0, 100.0, 0.02, 0.5), []
    for motor in (0.004, 0.002):
        moved = angles_of(ArmState(61.0 + motor, 100.0, 0.02, 0.5), PLANT, DRIVE)
        near = angles_near(angles_of(x, PLANT, DRIVE), motor / 88, motor, DRIVE)
        errors.append(np.abs(np.array(near) - np.array(moved)).max())
    assert errors[0] < (12 * 0.004) ** 4 / 24
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.1)


def test_belt_stiffness_is_the_mean_at_its_knee_and_the_tangent_a_derivative():
    def torque(torsion: float) -> float:
        return belt_stiffness(torsion**2 / (torsion**2 + DRIVE.knee), PLANT, DRIVE)[0] * torsion

    assert torque(0.01) == pytest.approx(33 * 0.01)
    assert torque(1e-6) == pytest.approx(33 * 0.75 * 1e-6)
    for torsion in (0.0, 0.004, 0.02, -0.03):
        _, tangent = belt_stiffness(torsion**2 / (torsion**2 + DRIVE.knee), PLANT, DRIVE)
        assert tangent == pytest.approx((torque(torsion + 1e-6) - torque(torsion - 1e-6)) / 2e-6, rel=1e-6)


@pytest.mark.parametrize("time", [1e-4, 1e-3])
def test_a_step_over_many_time_constants_is_as_exact_as_many_short_ones(time: float):
    def after(steps: int) -> ArmState:
        x, torque = ArmState(61.0, 60.0, 0.01, 0.3), -0.05
        for _ in range(steps):
            dt = 7.5e-4 / steps
            torques = torques_of_lag(Lag(0.05, torque - 0.05, time, 1 / time), dt)
            x = driven_step(x, angles_of(x, PLANT, DRIVE), torques, 1.0, dt, PLANT, DRIVE, LUMPED).state
            torque = torques.end
        assert torque == pytest.approx(0.05 - 0.1 * math.exp(-7.5e-4 / time), rel=1e-12)
        return x

    assert np.abs(np.array(after(1)) - np.array(after(64)))[1] < 2e-5  # rad/s, of 60


@pytest.mark.parametrize("ratio", [1e-9, 0.01, 0.7, 0.99, 1.01, 3.0, 15.0, 1000.0])
def test_moments_of_a_lag(ratio: float):
    found = response(CONTROL_PERIOD, CONTROL_PERIOD / ratio, ratio / CONTROL_PERIOD)
    nodes, weights = np.polynomial.legendre.leggauss(200)
    u = 0.5 * (nodes + 1)
    at, weights = u**4, 0.5 * weights * 4 * u**3  # dense at the beginning, where a short lag acts
    for k, moment in enumerate(found[:4], start=1):
        expected = np.sum(weights * (1 - at) ** (k - 1) / math.factorial(k - 1) * -np.expm1(-ratio * at))
        assert moment == pytest.approx(expected, rel=1e-10)
    assert found.end == pytest.approx(-math.expm1(-ratio), rel=1e-12)


@pytest.mark.parametrize("lag", [0.0, 2e-4, 1e-2])
@pytest.mark.parametrize("arrival", [0.0, 1e-4, 9e-4, CONTROL_PERIOD])
def test_stages_take_a_linear_arm_where_the_torque_takes_it(arrival: float, lag: float):
    # The exact step by the exponential of arm, lag and command together, of a belt as fast as one step allows.
    a = np.array([[-3.0, 40.0], [-60.0, -2.0]])
    b, rate = np.array([1.0, 0.5]), (1 / lag if lag > 0 else 0.0)
    x, now, before, after = np.array([0.3, -0.2]), -1.0, 2.0, -3.0
    now = now if lag > 0 else before
    taus = torques_of_two(now, before, after, *shares_of_two(arrival, lag, rate))
    slopes, at = [], x
    for tau, share in zip(taus[:4], (0.5, 0.5, 1.0, 0.0), strict=True):
        slopes.append(a @ at + b * tau)
        at = x + share * CONTROL_PERIOD * slopes[-1]
    found = x + CONTROL_PERIOD / 6 * (slopes[0] + 2 * slopes[1] + 2 * slopes[2] + slopes[3])
    z = np.array([*x, now])
    for target, duration in ((before, arrival), (after, CONTROL_PERIOD - arrival)):
        whole = np.zeros((4, 4))
        whole[:2, :2], whole[:2, 2], whole[2, 2:] = a, b, (-rate, rate)
        z[2] = z[2] if lag > 0 else target
        z = (expm(whole * duration) @ np.array([*z, target]))[:3]
    np.testing.assert_allclose(found, z[:2], atol=1e-8)
    assert taus.end == pytest.approx(z[2] if lag > 0 else (after if arrival < CONTROL_PERIOD else before), abs=1e-12)


@pytest.mark.parametrize("lag", [0.0, 2e-4, 0.01])
@pytest.mark.parametrize("share", [0.0, 0.2, 0.5, 0.8, 1.0])
def test_half_is_the_double_integral_of_the_torque_to_the_middle(share: float, lag: float):
    now, before, after = (-1.0 if lag else 2.0), 2.0, -3.0
    arrival, middle, rate = share * CONTROL_PERIOD, 0.5 * CONTROL_PERIOD, (1 / lag if lag else 0.0)

    def torque(time: float) -> float:
        old = before + (now - before) * math.exp(-rate * min(time, arrival)) if lag else before
        if time < arrival:
            return old
        return after + (old - after) * math.exp(-rate * (time - arrival)) if lag else after

    found = torques_of_two(now, before, after, *shares_of_two(arrival, lag, rate)).half
    parts = (0.0, min(arrival, middle), middle)
    twice = sum(quad(lambda t: (middle - t) * torque(t), *ends, epsabs=1e-16)[0] for ends in pairwise(parts))
    assert found == pytest.approx(twice / CONTROL_PERIOD**2, abs=1e-9)
    if share == 1.0:
        assert torques_of_lag(Lag(before, now - before, lag, rate), CONTROL_PERIOD).half == pytest.approx(
            found, rel=1e-12
        )


@pytest.mark.parametrize("w", [0.0, 0.1, 0.5, 1.0, 1.6])
def test_a_fitted_step_has_the_first_two_moments_of_a_sine(w: float):
    fit = fit_of(w)
    first, middle, last = fit.ends * np.exp(-1j * w), fit.middle, fit.ends * np.exp(1j * w)
    s = np.linspace(0, 1, 20_001)
    sine = np.exp(1j * w * (2 * s - 1))
    assert abs((first + 4 * middle + last) / 6 - np.trapezoid(sine, s)) < 3e-4 * w**10 + 1e-8
    assert abs((first + 2 * middle) / 6 - np.trapezoid((1 - s) * sine, s)) < 3e-4 * w**10 + 1e-8


def test_a_fit_is_the_series_of_its_closed_form():
    """Coefficients of a series by Cauchy's integral, around the unit circle."""
    circle = np.exp(2j * np.pi * np.arange(64) / 64)

    def closed_form(w: complex) -> tuple[complex, complex, complex]:
        s = np.sin(w) / w
        a = 3 * (np.sin(w) - w * np.cos(w)) / (w * w * np.sin(w))
        m = (3 * s - a * np.cos(w)) / 2
        d = (6 * (s * s / 4 - (a * np.cos(2 * w) + 2 * m * np.cos(w)) / 12) / (w * a * m * np.sin(w)) - 1 / 2) / 2
        return a, m, (d - 1 / 4) / 2

    found = np.fft.fft(np.array([fit_of(w) for w in circle]), axis=0)[:11] / 64
    expected = np.fft.fft(np.array([closed_form(w) for w in circle]), axis=0)[:11] / 64
    expected[9:, 2] = 0  # where the series of the lead ends
    assert np.abs(found - expected).max() < 1e-13


def test_ripple_neither_drives_nor_brakes_in_the_mean_over_its_phase():
    ripple = ArmParams(torque_ripple=0.006, torque_ripple_order=12, coulomb_friction=0.0, motor_viscous_friction=0.0)
    ripple = replace(ripple, belt_stiffness=1e-6, belt_damping_ratio=0.0)
    plant, drive = ripple.plant(), drive_of(ripple.row())

    def energy(x: ArmState) -> float:
        kinetic = 0.5 * ripple.motor_inertia * x.motor_speed**2
        return kinetic + 0.006 / 12 * math.cos(12 * x.motor_angle)

    gained, torques = [], torques_of_lag(Lag(0.0, 0.0, 0.0, 0.0), CONTROL_PERIOD)
    for phase in np.arange(48) / 48 * 2 * math.pi / 12:
        x = ArmState(phase, 80.0, phase / 88, 80.0 / 88)
        y = driven_step(x, angles_of(x, plant, drive), torques, 1.0, CONTROL_PERIOD, plant, drive, LUMPED).state
        gained.append(energy(y) - energy(x))
    assert np.abs(gained).max() > 1e-8  # J: per step it may err
    assert abs(np.mean(gained)) < 1e-11


@pytest.mark.parametrize("model", [LUMPED, FULL_ARM])
def test_the_vibration_of_an_arm_whose_motor_rests_is_right_to_the_fifth_order(model: Model):
    params = ArmParams(payload_mass=0.3)
    plant, drive = params.plant(), drive_of(params.row())
    start = ArmState(88 * 0.7, 0.0, 1e-4, 0.01)

    def torsion(steps: int) -> float:
        x, dt = start, 0.004 / steps
        for _ in range(steps):
            torques = torques_of_lag(Lag(0.0, 0.0, 0.0, 0.0), dt)
            x = driven_step(x, angles_of(x, plant, drive), torques, 0.0, dt, plant, drive, model).state
        return x.torsion - start.torsion

    assert torsion(1) == pytest.approx(torsion(64), rel=2e-9)


def exits_of(margins: list[Margin]) -> np.ndarray:
    work = np.zeros(EXIT_ROWS * LANES)
    for lane, margin in enumerate(margins):
        store_margin(work, 0, lane, margin)
    find_exits(work, len(margins))
    return work[EXIT * LANES :][: len(margins)]


def test_where_margins_fall_below_zero():
    dips = Margin(1.0, -6.0, 6.0, 0.0, 0.0, 0.0)  # 1 - 6 u + 6 u^2: below zero between 0.211 and 0.789
    stays = Margin(2.0, -6.0, 6.0, 0.0, 0.0, 0.0)  # lowest 0.5
    falls = Margin(-0.5, 0.0, 0.0, 0.0, 1.0, 4.0)  # e^(-4 u) - 0.5
    assert leaves_mode(dips, 1.0)
    assert leaves_mode(falls, math.exp(-4))
    expected = [0.5 - math.sqrt(3) / 6, 1.0, math.log(2) / 4]
    assert exits_of([dips, stays, falls]) == pytest.approx(expected, rel=1e-9)


def test_a_margin_whose_tangents_stay_above_zero_is_not_left():
    falls_and_rises = Margin(0.0, 1.0, 0.0, 0.0, 2.0, 6.0)  # u + 2 e^(-6 u), lowest 0.58
    assert not leaves_mode(falls_and_rises, math.exp(-6))


def test_where_convex_margins_are_lowest():
    rng = np.random.default_rng(1)
    found = 0
    for _ in range(500):
        amplitude, exponent = float(rng.uniform(0, 2)), float(rng.uniform(0.1, 6))
        m = Margin(float(rng.normal()), float(rng.normal(-1, 2)), float(rng.uniform(0, 4)), 0.0, amplitude, exponent)

        def slope(u: float, m: Margin = m) -> float:
            return m.c1 + 2 * m.c2 * u - m.exponent * m.amplitude * math.exp(-m.exponent * u)

        def value(u: float, m: Margin = m) -> float:
            return m.c0 + u * (m.c1 + u * m.c2) + m.amplitude * math.exp(-m.exponent * u)

        if not slope(0) < 0 < slope(1):
            continue
        lowest: Any = brentq(slope, 0, 1, xtol=1e-14)
        found += 1
        assert dips(m) == (value(1) >= 0)
        assert value(lowest_point(m)) == pytest.approx(value(lowest), abs=1e-6)
        if value(lowest) < -1e-9:
            assert leaves_mode(m, math.exp(-exponent))
    assert found > 100


def test_exits_of_many_margins_are_those_that_scipy_finds():
    rng = np.random.default_rng(0)
    margins = [Margin(*map(float, rng.normal(size=5)), exponent=float(rng.uniform(0, 6))) for _ in range(2000)]

    def at(m: Margin, u: float) -> float:
        return m.c0 + u * (m.c1 + u * (m.c2 + u * m.c3)) + m.amplitude * math.exp(-m.exponent * u)

    grid = np.linspace(0, 1, 201)
    crossing = [m for m in margins if np.sum(np.diff(np.sign([at(m, u) for u in grid]))) == -2 and at(m, 0) > 0]
    crossing = crossing[:LANES]
    assert len(crossing) == LANES
    expected = [brentq(lambda u, m=m: at(m, u), 0, 1, xtol=1e-14) for m in crossing]
    assert exits_of(crossing) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("model", [LUMPED, FULL_ARM])
@pytest.mark.parametrize("direction", [-1.0, 1.0])
def test_the_acceleration_per_torque_is_that_of_the_equations_of_motion(direction: float, model: Model):
    # A motor that breaks away accelerates by nothing else at first: an error here would end its sliding at once.
    for phase in np.linspace(0, 6, 13):
        drive = drive_of(replace(PARAMS, kinematic_error_phase=float(phase)).row())
        x = ArmState(70.0, 0.0, 0.01, 0.2)
        angles = angles_of(x, PLANT, drive)
        with_torque, without = (accelerations_at(x, angles, t, direction, PLANT, model, drive)[0] for t in (1.0, 0.0))
        by_torque = acceleration_per_torque(angles, PLANT, drive, model)
        assert by_torque == pytest.approx(with_torque - without, rel=1e-11)


@pytest.mark.parametrize("model", [LUMPED, FULL_ARM])
def test_accelerations_are_those_of_equations_written_otherwise(model: Model):
    name = "lumped" if model is LUMPED else "lagrangian"
    for params in (PARAMS, ArmParams()):
        plant, drive = params.plant(), built_drive(params.row())
        for x in (ArmState(70.0, 30.0, 0.01, -0.2), ArmState(12.3, -4.0, -0.03, 0.5)):
            at = angles_of(x, plant, drive)
            for direction in (-1.0, 1.0):
                factor = coupling(x, at, plant, drive).friction
                arm = driven_arm(params, np.array(x), name)
                (_, _, alpha, phi), _ = arm.rates(0.1, friction_torque(direction, factor, plant, drive))
                found = accelerations_at(x, at, 0.1, direction, plant, model, drive)
                assert found == pytest.approx((88 * alpha, alpha - phi), rel=1e-9)
            assert accelerations_at(x, at, 0.1, 0.0, plant, model, drive)[0] == 0.0, "it sticks"


@pytest.mark.parametrize("model", [LUMPED, FULL_ARM])
def test_the_pull_on_a_motor_at_rest_changes_at_its_rate(model: Model):
    for params in (PARAMS, ArmParams()):
        plant, drive = params.plant(), built_drive(params.row())

        def pull(time: float, plant: Plant = plant, drive: Drive | None = drive) -> float:
            x = ArmState(70.0, 0.0, 0.01 - 0.2 * time + 20 * time * time, -0.2 + 40 * time)
            return driving_torque_at(x, angles_of(x, plant, drive), 0.05, plant, model, drive)

        x = ArmState(70.0, 0.0, 0.01, -0.2)
        rate = driving_torque_rate_at(x, angles_of(x, plant, drive), 40.0, plant, model, drive)
        assert rate == pytest.approx((pull(1e-6) - pull(-1e-6)) / 2e-6, rel=1e-6)


def test_steps_divide_what_remains():
    assert step_length(1.5e-3, 0.0, 1.0) == (1.5e-3, 1.0)
    assert step_length(1.5e-3, 1000.0, 1.0) == (0.75e-3, 2.0)
    assert step_length(0.75e-3, 0.0, 4.0) == (0.375e-3, 2.0)
    assert step_length(1.5e-3, 1000.0, 2.0) == (0.375e-3, 4.0)


RIPPLE = {"torque_ripple": 0.0005, "torque_ripple_order": 12}
STRONG = {"torque_ripple": 0.02, "torque_ripple_order": 12}
FALLING = {"static_friction_excess": 0.5, "stribeck_speed": 2.0}


@pytest.mark.parametrize(
    ("speed", "effects", "expected"),
    [
        (200.0, {"kinematic_error": 1e-4}, 400.0),  # one radian of twice the angle
        (-200.0, {"kinematic_error": 1e-4}, 400.0),
        (5.0, {"kinematic_error": 1e-4}, 10.0),
        (200.0, RIPPLE, 0.3 * 12 * 200),
        (200.0, {**RIPPLE, "torque_ripple_order": 4}, 400.0),
        (9.9, RIPPLE, 2 / CONTROL_PERIOD),
        (10.1, RIPPLE, 0.3 * 12 * 10.1),
        (-9.9, {**FALLING, "static_friction_excess": 1e-9}, 2 / CONTROL_PERIOD),
        (39.0, RIPPLE, 0.3 * 12 * 39),
        (39.0, STRONG, 2 / CONTROL_PERIOD),
        (41.0, STRONG, 0.3 * 12 * 41),
        # 1000 rad/s^2, and 0.063 N m on 6.3e-5 kg m^2, are 2000 rad/s^2: in a step a sixth of omega_a + 2 rad/s.
        (150.0, FALLING, 300.0),
        (20.0, FALLING, 2000 / (22 / 6)),
    ],
)
def test_steps_resolve_what_turns_and_what_falls(speed: float, effects: dict[str, float], expected: float):
    arm, x = ArmParams(**effects), ArmState(70.0, speed, 0.01, 0.2)
    for motor in (-1000.0, 1000.0):
        needed = needed_rate(x, motor, 0.063, math.copysign(1.0, speed), arm.plant(), drive_of(arm.row()))
        assert needed == pytest.approx(expected, rel=1e-12)
    assert needed_rate(x, 1000.0, 0.063, 0.0, arm.plant(), drive_of(arm.row())) == 0.0, "at rest nothing turns"
