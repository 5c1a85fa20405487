"""The full arm against the equations that SymPy derives, limits of integration, modes as documented, and kinematics."""

import math
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest
import sympy
from driven_arms import GEAR, MODELS, UPPER_ENDS, at_rest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from beltarm_env import ArmParams, state_space
from beltarm_env.arm import FIELDS, bounds_of
from beltarm_env.physics import drive as drives
from beltarm_env.physics import friction, models, substeps
from beltarm_env.physics.kinematics import WORKSPACE_MARGIN, tip_motion
from beltarm_env.physics.models import FULL_ARM, LUMPED, Model
from beltarm_env.physics.state import ArmState
from beltarm_env.physics.substeps import fastest_rate, integration_limits
from beltarm_env.physics.trigonometry import exponential, polar_angle, sin_cos, sine_cosine, wrapped
from beltarm_env.task.ranges import IDEAL_RANGES, TRAIN_RANGES, range_bounds
from eval.reference.event_located import EventLocatedArm, tip
from eval.reference.symbolic_arm import derive

DEG_90, TURN = math.pi / 2, 2 * math.pi
SPEEDS = st.floats(-10, 10)
ARMS = st.builds(ArmParams, st.floats(1, 200), st.floats(0.05, 1), st.just(0.0) | st.floats(0, 0.5))
PHASES = {"kinematic_error_phase": 0.7, "friction_variation_phase": 1.9, "torque_ripple_phase": 2.5}
UNEVEN = [
    {"payload_mass": 0.2},
    {"arm_inertia": 0.008, "arm_inertia_swing": 0.072, "payload_mass": 0.1},  # a hand beside the rod
    {"arm_inertia": 0.012, "arm_inertia_swing": 0.048, "gear_ratio": 60.0, "link_length": 0.3},  # a pulley beside it
]


class TestEquations:
    def test_mass_matrix_and_coriolis_terms_as_documented(self):
        equations = derive()
        (_, phi), (omega_1, omega_phi) = equations.angles, equations.rates
        motor, l, rod, end, pulley = equations.masses  # noqa: E741
        m0, swing, link = rod * l**2 / 3 + pulley, 2 * rod * l**2 + 4 * l**2 * end, rod * l**2
        square = sympy.cos(phi) ** 2
        matrix = sympy.Matrix([[motor + m0 + swing * square, link - 2 * m0 - swing * square], [0, 0]])
        matrix[1, 0], matrix[1, 1] = matrix[0, 1], 4 * m0 + swing - 2 * link
        assert sympy.simplify(equations.mass_matrix - matrix) == sympy.zeros(2)
        turning = swing * sympy.sin(2 * phi)
        bias = sympy.Matrix([-turning * omega_phi * (omega_1 - omega_phi), turning * omega_1**2 / 2])
        assert sympy.simplify(equations.bias - bias) == sympy.zeros(2, 1)

    @pytest.mark.parametrize("model", [LUMPED, FULL_ARM], ids=["lumped", "lagrangian"])
    @examples(60)
    @given(
        ranges=st.fixed_dictionaries({name: st.floats(*pair) for name, pair in IDEAL_RANGES.items()}),
        drive=st.sampled_from([{}, UPPER_ENDS | PHASES]),
        state=st.tuples(st.floats(0, GEAR * 1.5), st.floats(-200, 200), st.floats(-0.1, 0.1), st.floats(-5, 5)),
        torque=st.floats(-0.3, 0.3),
        direction=st.sampled_from([-1.0, 0.0, 1.0]),
    )
    def test_are_those_of_the_event_located_solution(
        self, model: Model, ranges: Any, drive: Any, state: tuple[float, ...], torque: float, direction: float
    ):
        params = ArmParams(**drive, **ranges)
        plant, drive_there = params.plant(), drives.real_drive_of(params.row())
        moving = models.Arm(plant, drive_there, model)
        x = ArmState(state[0], direction * abs(state[1]), state[2], state[3])
        at = drives.angles_of(x, plant, drive_there)
        arm = EventLocatedArm(params, np.array(x), "lumped" if model is LUMPED else "lagrangian")
        level = arm.dry_friction(arm._y)
        (_, _, alpha, phi), holding = arm.rates(torque, direction * level if direction else None)
        accelerations = models.accelerations_at(x, at, torque, direction, moving)[:2]
        assert accelerations == pytest.approx((GEAR * alpha, alpha - phi), rel=1e-9, abs=1e-8)
        if direction == 0:
            pull = models.driving_torque_at(x, at, torque, moving)
            assert pull == pytest.approx(holding, rel=1e-9, abs=1e-12)
            assert friction.breakaway_torque(at, plant, drive_there) == pytest.approx(level, rel=1e-12)


class TestIntegrationLimits:
    @pytest.mark.parametrize("params", UNEVEN)
    def test_fastest_rate_is_the_largest_eigenvalue(self, params: dict[str, float]):
        arm = ArmParams(**{**params, "belt_damping_ratio": 0.0, "motor_viscous_friction": 0.0})
        for name, model in (("lumped", LUMPED), ("lagrangian", FULL_ARM)):
            ends = [np.abs(np.linalg.eigvals(state_space(arm, angle, name)[0])).max() for angle in (0.0, DEG_90)]
            assert fastest_rate(arm.plant(), model, 0.0) == pytest.approx(max(ends), rel=1e-9)
        stiff = replace(arm, belt_stiffness=3e4)
        steps = substeps.integration_substeps(stiff.plant(), FULL_ARM)
        angles = np.linspace(0, DEG_90, 7)
        fastest = max(abs(np.linalg.eigvals(state_space(stiff, angle, "lagrangian")[0])).max() for angle in angles)
        assert 0.11 < fastest * 0.0015 / (steps - 1)
        assert fastest * 0.0015 / steps <= 0.1201

    @pytest.mark.parametrize("model", [LUMPED, FULL_ARM])
    def test_every_arm_of_ranges_that_are_accepted_can_be_integrated(self, model: Model):
        rng, accepted = np.random.default_rng(0), 0
        upper = asdict(ArmParams(**{name: high for name, (_, high) in TRAIN_RANGES.items()}))
        varied = [name for name in FIELDS if not name.endswith(("_phase", "_order", "_limit"))]
        for _ in range(700):
            ranges = {}
            for name in rng.choice(varied, 4, replace=False):
                bound = bounds_of(name)
                ends = np.sort(upper[name] * 10 ** rng.uniform(-3, 3, 2))
                ranges[name] = tuple(np.clip(ends, bound.low + 1e-12 * bound.above, bound.high))
            bounds = range_bounds(ranges)
            try:
                substeps.check_integrable(substeps.fastest_arms(bounds), model)
            except ValueError:
                continue
            accepted += 1
            shares = rng.random((8, len(FIELDS))).round(rng.integers(2))  # ends as often as what lies between
            for row in bounds[0] + shares * (bounds[1] - bounds[0]):
                assert max(integration_limits(row, model)) <= 1 + 1e-9, ranges
        assert accepted > 40


DOCUMENTED = [
    ("lumped", 0, 57.4, 58.0, 0.225),
    ("lumped", 45, 28.7, 29.9, 0.279),
    ("lumped", 90, 21.7, 23.2, 0.237),
    ("lagrangian", 0, 28.7, 28.8, -0.079),
    ("lagrangian", 45, 28.7, 29.0, 0.156),
    ("lagrangian", 90, 28.7, 30.5, 0.325),
]


class TestModes:
    @pytest.mark.parametrize(("model", "degrees", "stuck", "free", "damped"), DOCUMENTED)
    def test_as_documented(self, model: str, degrees: float, stuck: float, free: float, damped: float):
        lossless = ArmParams(belt_damping_ratio=0.0, motor_viscous_friction=0.0)
        angle = math.radians(degrees)
        arm = EventLocatedArm(lossless, at_rest(angle), model)
        assert math.sqrt(33 / arm.mass_matrix()[1, 1]) == pytest.approx(stuck, abs=0.06)
        poles = np.linalg.eigvals(state_space(lossless, angle, model)[0])
        assert poles.imag.max() == pytest.approx(free, abs=0.06)
        # A - bK of the paper's loop (7), (9), (11) without the belt's damping: the least damped of its pairs
        a, b, _ = state_space(ArmParams(belt_damping_ratio=0.0), angle, model)
        m, v = lossless.motor_inertia, ArmParams().motor_viscous_friction
        poles = np.linalg.eigvals(a - b @ np.array([[25 * m, 20 * m - v, 0.0, 0.15]]))
        pairs = poles[poles.imag > 1e-6]
        assert (-pairs.real / np.abs(pairs)).min() == pytest.approx(damped, abs=6e-4)

    def test_at_24_degrees_the_motor_does_not_move_the_belt(self):
        angle = math.asin(math.sqrt(1 / 6))
        assert math.degrees(angle) == pytest.approx(24.1, abs=0.05)
        by_torque = [state_space(ArmParams(), angle + d, MODELS[1])[1][3, 0] for d in (-0.1, 0.0, 0.1)]
        assert by_torque[0] < 0 < by_torque[2]
        assert by_torque[1] == pytest.approx(0.0, abs=1e-9)


@examples(100)
@given(ARMS, st.floats(-WORKSPACE_MARGIN, DEG_90 + WORKSPACE_MARGIN), st.floats(-0.3, 0.3), SPEEDS, SPEEDS)
def test_motion_of_the_tip_is_that_of_the_linkage(
    params: ArmParams, joint: float, torsion: float, speed: float, torsion_speed: float
):
    state = np.array([params.gear_ratio * joint, params.gear_ratio * speed, torsion, torsion_speed])
    step = 1e-5 * np.array([state[1], 0, state[3], 0])
    velocity = (tip(params, state + step) - tip(params, state - step)) / 2e-5
    motion = tip_motion(ArmState(*state.tolist()), params.plant(), None)
    np.testing.assert_allclose(motion[:2], tip(params, state), atol=1e-14)
    np.testing.assert_allclose(motion[2:], velocity, atol=1e-5)


class TestTrigonometry:
    def test_sin_cos(self):
        angles = np.linspace(-2, 2, 20_001)
        series = np.array([sin_cos(angle) for angle in angles])
        assert np.abs(series - np.column_stack([np.sin(angles), np.cos(angles)])).max() <= 1e-15
        for angle in (0.0, 1e-200, 1e-9, 1e-4, *angles[10_000::100]):
            sine, cosine = sin_cos(angle)
            assert sin_cos(-angle) == (-sine, cosine)
            assert angle > 1e-3 or (sine, cosine) == pytest.approx((math.sin(angle), math.cos(angle)), rel=4e-16, abs=0)

    def test_of_any_angle(self):
        for angle in np.append(np.linspace(-30, 30, 2001), [1234.5, -2000.0, -9e5, 3e5]):
            rounding = 1e-15 + 2.3e-16 * abs(angle)  # of whole turns
            assert sine_cosine(float(angle)) == pytest.approx((math.sin(angle), math.cos(angle)), abs=rounding)
            if abs(angle) < 1e4:
                assert wrapped(float(angle)) == pytest.approx(math.remainder(angle, TURN), abs=1e-12)

    def test_polar_angle(self):
        for radius in (1e-200, 1.0, 3e7):
            for angle in np.linspace(0, TURN, 721)[:-1]:
                x, y = radius * math.cos(angle), radius * math.sin(angle)
                assert polar_angle(x, y) == pytest.approx(math.atan2(y, x) % TURN, rel=4e-16, abs=1e-15)
        for x, y, quarters in ((1, 0, 0), (1, 1, 0.5), (0, 1, 1), (-1, 0, 2), (-1, -1, 2.5), (0, -1, 3), (0, 0, 0)):
            assert polar_angle(float(x), float(y)) == pytest.approx(quarters * DEG_90, rel=4e-16, abs=0)

    def test_exponential(self):
        for x in np.append(np.linspace(-700, 700, 1001), np.linspace(-1, 1, 101)):
            assert exponential(float(x)) == pytest.approx(math.exp(x), rel=1e-15, abs=0)
        assert exponential(0.0) == 1.0
        for x in (700.5, 1e4, math.inf):
            assert exponential(x) == exponential(700.0) and exponential(-x) == exponential(-700.0)
