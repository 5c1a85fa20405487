"""Pieces of the integration behind a drive as it is built: equations, torques over a step, and exits from a mode."""

import math

import numpy as np
import pytest
from driven_arms import GEAR, UPPER_ENDS
from hypothesis import given
from hypothesis import strategies as st
from properties import examples
from scipy.linalg import expm
from scipy.optimize import brentq

from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.kernels.exits import EXIT, EXIT_ROWS, find_exits, store_margin
from beltarm_env.kernels.layout import LANES
from beltarm_env.physics import drive as drives
from beltarm_env.physics import friction, models
from beltarm_env.physics.drive import angles_of
from beltarm_env.physics.driven.events import Margin, leaves_mode
from beltarm_env.physics.driven.step import fit_of
from beltarm_env.physics.driven.torque import shares_of_two, torques_of_two
from beltarm_env.physics.models import FULL_ARM, LUMPED, Model
from beltarm_env.physics.state import ArmState
from beltarm_env.task.ranges import IDEAL_RANGES
from eval.reference.event_located import EventLocatedArm

PHASES = {"kinematic_error_phase": 0.7, "friction_variation_phase": 1.9, "torque_ripple_phase": 2.5}
PARAMS = ArmParams(**{**UPPER_ENDS, **PHASES})
PLANT, DRIVE = PARAMS.plant(), drives.drive_of(PARAMS.row())
EACH_MODEL = pytest.mark.parametrize("model", [LUMPED, FULL_ARM])


@pytest.mark.parametrize("angle", [0.0, 33.3, 110.0])
def test_an_arm_at_rest_has_no_torque_in_its_belt(angle: float):
    x = drives.resting(angle, PLANT, DRIVE)
    assert (x.motor_angle, x.motor_speed, x.torsion_speed) == (angle, 0.0, 0.0)
    assert drives.belt_motion(x, PLANT, DRIVE) == pytest.approx((0.0, 0.0), abs=1e-16)
    assert abs(x.torsion) > 1e-6, "the kinematic error is taken up"


@EACH_MODEL
@examples(60)
@given(
    st.booleans(),
    st.fixed_dictionaries({name: st.floats(*pair) for name, pair in IDEAL_RANGES.items()}),
    st.tuples(st.floats(0, GEAR * 1.5), st.floats(-200, 200), st.floats(-0.1, 0.1), st.floats(-5, 5)),
    st.floats(-0.3, 0.3),
    st.sampled_from([-1.0, 0.0, 1.0]),
)
def test_equations_are_those_of_the_event_located_solution(
    model: Model, built: bool, ranges: dict[str, float], state: tuple[float, ...], torque: float, direction: float
):
    params = ArmParams(**(UPPER_ENDS | PHASES if built else {}), **ranges)
    plant, drive = params.plant(), drives.built_drive(params.row())
    x = ArmState(state[0], direction * abs(state[1]), state[2], state[3])
    at = angles_of(x, plant, drive)
    arm = EventLocatedArm(params, np.array(x), "lumped" if model is LUMPED else "lagrangian")
    level = arm.dry_friction(arm._y)
    (_, _, alpha, phi), holding = arm.rates(torque, direction * level if direction else None)
    accelerations = models.accelerations_at(x, at, torque, direction, plant, model, drive)
    assert accelerations == pytest.approx((GEAR * alpha, alpha - phi), rel=1e-9, abs=1e-8)
    if direction == 0:
        pull = models.driving_torque_at(x, at, torque, plant, model, drive)
        assert pull == pytest.approx(holding, rel=1e-9, abs=1e-12)
        assert friction.breakaway_torque(at, plant, drive) == pytest.approx(level, rel=1e-12)


def test_decay_is_an_exponential():
    for ratio in (0.0, 1e-9, 0.3, 1.0, 7.5, 8.0, 20.0, 39.0):
        assert drives.decay(ratio) == pytest.approx(math.exp(-ratio), rel=1e-14 if ratio <= 8 else 1e-9, abs=0)
    assert 0 <= drives.decay(1e9) < 1e-17


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


@pytest.mark.parametrize("w", [0.0, 0.1, 0.5, 1.0, 1.6])
def test_a_fitted_step_has_the_first_two_moments_of_a_sine(w: float):
    fit = fit_of(w)
    first, middle, last = fit.ends * np.exp(-1j * w), fit.middle, fit.ends * np.exp(1j * w)
    s = np.linspace(0, 1, 20_001)
    sine = np.exp(1j * w * (2 * s - 1))
    assert abs((first + 4 * middle + last) / 6 - np.trapezoid(sine, s)) < 3e-4 * w**10 + 1e-8
    assert abs((first + 2 * middle) / 6 - np.trapezoid((1 - s) * sine, s)) < 3e-4 * w**10 + 1e-8


def exits_of(margins: list[Margin]) -> np.ndarray:
    work = np.zeros(EXIT_ROWS * LANES)
    for lane, margin in enumerate(margins):
        store_margin(work, 0, lane, margin)
    find_exits(work, len(margins))
    return work[EXIT * LANES :][: len(margins)]


def value(m: Margin, u: float) -> float:
    return m.c0 + u * (m.c1 + u * (m.c2 + u * m.c3)) + m.amplitude * math.exp(-m.exponent * u)


def test_a_margin_that_falls_below_zero_within_a_step_is_left():
    rng, count = np.random.default_rng(1), 0
    for _ in range(400):
        c0, c1, c2, amplitude, exponent = rng.normal([0, -1, 2, 1, 3], [1, 2, 1, 0.5, 1.5]).tolist()
        m = Margin(c0, c1, abs(c2), 0.0, abs(amplitude), abs(exponent))
        lowest = min(value(m, u) for u in np.linspace(0, 1, 101))
        if value(m, 0) > 0 > lowest:
            assert leaves_mode(m, math.exp(-m.exponent))
            count += 1
    assert count > 50
    stays = Margin(0.0, 1.0, 0.0, 0.0, 2.0, 6.0)  # u + 2 e^(-6 u), lowest 0.58: its tangents stay above zero
    assert not leaves_mode(stays, math.exp(-6))


def test_exits_of_many_margins_are_those_that_scipy_finds():
    rng = np.random.default_rng(0)
    margins = [Margin(*map(float, rng.normal(size=5)), exponent=float(rng.uniform(0, 6))) for _ in range(2000)]

    grid = np.linspace(0, 1, 201)
    crossing = [m for m in margins if np.sum(np.diff(np.sign([value(m, u) for u in grid]))) == -2 and value(m, 0) > 0]
    crossing = crossing[:LANES]
    assert len(crossing) == LANES
    expected = [brentq(lambda u, m=m: value(m, u), 0, 1, xtol=1e-14) for m in crossing]
    assert exits_of(crossing) == pytest.approx(expected, abs=1e-12)
