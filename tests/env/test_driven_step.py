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
from beltarm_env.physics.driven.events import Margin
from beltarm_env.physics.driven.torque import shares_of_two, torques_of_two
from beltarm_env.physics.models import FULL_ARM, LUMPED, Model
from beltarm_env.physics.state import ArmState
from beltarm_env.task.ranges import IDEAL_RANGES
from eval.reference.event_located import EventLocatedArm

PHASES = {"kinematic_error_phase": 0.7, "friction_variation_phase": 1.9, "torque_ripple_phase": 2.5}


@pytest.mark.parametrize("model", [LUMPED, FULL_ARM], ids=["lumped", "lagrangian"])
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


@pytest.mark.parametrize(("arrival", "lag"), [(0.0, 0.0), (9e-4, 0.0), (1e-4, 2e-4), (CONTROL_PERIOD, 1e-2)])
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


def test_exits_of_many_margins_are_those_that_scipy_finds():
    def value(m: Margin, u: float) -> float:
        return m.c0 + u * (m.c1 + u * (m.c2 + u * m.c3)) + m.amplitude * math.exp(-m.exponent * u)

    rng, grid, crossing = np.random.default_rng(0), np.linspace(0, 1, 201), list[Margin]()
    while len(crossing) < LANES:
        m = Margin(*map(float, rng.normal(size=5)), exponent=float(rng.uniform(0, 6)))
        if value(m, 0) > 0 and np.sum(np.diff(np.sign([value(m, u) for u in grid]))) == -2:
            crossing.append(m)
    work = np.zeros(EXIT_ROWS * LANES)
    for lane, margin in enumerate(crossing):
        store_margin(work, 0, lane, margin)
    find_exits(work, LANES)
    expected = [brentq(lambda u, m=m: value(m, u), 0, 1, xtol=1e-14) for m in crossing]
    assert work[EXIT * LANES :][:LANES] == pytest.approx(expected, abs=1e-12)
