"""The full arm against the equations that SymPy derives, limits of integration, and the modes as documented."""

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
from beltarm_env.physics.models import FULL_ARM, LUMPED, Model
from beltarm_env.physics.state import ArmState
from beltarm_env.physics.substeps import fastest_rate, integration_limits
from beltarm_env.task.ranges import IDEAL_RANGES, TRAIN_RANGES, range_bounds
from eval.reference.event_located import EventLocatedArm
from eval.reference.symbolic_arm import derive

DEG_90 = math.pi / 2
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
                substeps.check_ranges_integrable(bounds, model)
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
