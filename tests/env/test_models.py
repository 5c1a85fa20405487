"""The full arm in the kernels, against the equations that SymPy derives and solutions that do not share its code."""

import math
from dataclasses import asdict, replace
from itertools import pairwise, product
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import sympy
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from properties import examples
from scipy.linalg import expm

from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS, ArmParams, BeltArmEnv, BeltArmVectorEnv, state_space
from beltarm_env.arm import FIELDS, Plant, bounds_of, plant_of
from beltarm_env.physics import full_arm as lagrangian
from beltarm_env.physics.models import (
    FULL_ARM,
    LUMPED,
    Model,
    accelerations,
    driving_torque,
    driving_torque_rate,
)
from beltarm_env.physics.state import ArmState
from beltarm_env.physics.substeps import (
    check_integrable,
    check_ranges_integrable,
    fastest_arms,
    fastest_rate,
    integration_limits,
    integration_substeps,
)
from beltarm_env.task.ranges import IDEAL_RANGES, TRAIN_RANGES, range_bounds
from eval.reference.event_located import EventLocatedArm, tip
from eval.reference.symbolic_arm import derive
from eval.studies.physics import measure_convergence

Floats = NDArray[np.float64]

GEAR = 88.0
DEG_45, DEG_90 = math.pi / 4, math.pi / 2
UNEVEN = [
    {},
    {"payload_mass": 0.2},
    {"arm_inertia": 0.008, "arm_inertia_swing": 0.072, "payload_mass": 0.1},  # a hand beside the rod
    {"arm_inertia": 0.012, "arm_inertia_swing": 0.048, "gear_ratio": 60.0, "link_length": 0.3},  # a pulley beside it
]

arms = st.fixed_dictionaries({name: st.floats(*pair) for name, pair in IDEAL_RANGES.items()})
states = st.tuples(st.floats(0, GEAR * 1.5), st.floats(-200, 200), st.floats(-0.1, 0.1), st.floats(-5, 5))


def plant(params: ArmParams) -> Plant:
    return params.plant()


def full_arm(params: dict[str, float], state: Floats, **settings: Any) -> BeltArmEnv:
    env = BeltArmEnv(model="lagrangian", **settings)
    env.reset(seed=0, options={"params": params, "state": state})
    return env


def at_rest(joint: float, torsion: float = 0.0, gear: float = GEAR) -> Floats:
    return np.array([gear * joint, 0.0, torsion, 0.0])


class TestEquations:
    def test_mass_matrix_and_coriolis_terms_as_documented(self):
        equations = derive()
        (_, phi), (omega_1, omega_phi) = equations.angles, equations.rates
        motor, l, rod, end, pulley = equations.masses  # noqa: E741
        m0, swing, link = rod * l**2 / 3 + pulley, 2 * rod * l**2 + 4 * l**2 * end, rod * l**2
        square = sympy.cos(phi) ** 2
        stated = sympy.Matrix([[motor + m0 + swing * square, link - 2 * m0 - swing * square], [0, 0]])
        stated[1, 0], stated[1, 1] = stated[0, 1], 4 * m0 + swing - 2 * link
        assert sympy.simplify(equations.mass_matrix - stated) == sympy.zeros(2)
        turning = swing * sympy.sin(2 * phi)
        bias = sympy.Matrix([-turning * omega_phi * (omega_1 - omega_phi), turning * omega_1**2 / 2])
        assert sympy.simplify(equations.bias - bias) == sympy.zeros(2, 1)

    @examples(100)
    @given(arms, states, st.floats(-0.3, 0.3), st.sampled_from([-1, 0, 1]))
    def test_accelerations(self, params: dict[str, float], state: tuple[float, ...], torque: float, direction: int):
        params_ = ArmParams(**params)
        x = ArmState(state[0], direction * abs(state[1]), state[2], state[3])
        rates, friction = EventLocatedArm(params_, np.array(x), "lagrangian").rates(
            torque, direction * params_.coulomb_friction if direction else None
        )
        motor, torsional = accelerations(x, torque, direction, plant(params_), FULL_ARM)
        assert motor == pytest.approx(GEAR * rates[2], rel=1e-9, abs=1e-8)
        assert torsional == pytest.approx(rates[2] - rates[3], rel=1e-9, abs=1e-8)
        if direction == 0:
            assert driving_torque(x, torque, plant(params_), FULL_ARM) == pytest.approx(friction, rel=1e-9, abs=1e-12)

    @examples(100)
    @given(arms, states, st.floats(-0.3, 0.3))
    def test_rate_of_the_torque_on_a_stuck_motor(
        self, params: dict[str, float], state: tuple[float, ...], torque: float
    ):
        coefficients = plant(ArmParams(**params))
        x = ArmState(state[0], 0.0, state[2], state[3])
        _, torsional = accelerations(x, torque, 0.0, coefficients, FULL_ARM)
        h = 1e-6
        later, earlier = (
            ArmState(x[0], 0.0, x[2] + s * h * x[3], x[3] + s * h * torsional)  # the slope is all that counts
            for s in (1, -1)
        )
        difference = driving_torque(later, torque, coefficients, FULL_ARM)
        difference -= driving_torque(earlier, torque, coefficients, FULL_ARM)
        rate = driving_torque_rate(x, torsional, coefficients, FULL_ARM)
        assert rate == pytest.approx(difference / (2 * h), rel=1e-6, abs=1e-6)

    @examples(100)
    @given(arms, st.floats(0, DEG_90))
    def test_rigid_belt_gives_the_inertia_of_the_lumped_arm(self, params: dict[str, float], angle: float):
        p = ArmParams(**params)
        arm = plant(p)
        w11, w12, w22 = lagrangian.inverse_inertia(math.cos(angle), arm)
        total = np.linalg.inv(np.array([[w11, w12], [w12, w22]])).sum()
        swing = p.arm_inertia_swing + (2 * p.link_length) ** 2 * p.payload_mass
        lumped = GEAR**2 * p.motor_inertia + p.arm_inertia + swing * math.sin(angle) ** 2
        assert total == pytest.approx(lumped, rel=1e-10)


def test_equations_of_the_lumped_arm_follow_from_its_energy():
    # d/dt dT/dphi' - dT/dphi for T = 1/2 M2(phi) phi'^2: M2 phi'' + 1/2 M2' phi'^2, eq. (5b) completed.
    t, m0, swing = sympy.symbols("t M_0 S", positive=True)
    phi = sympy.Function("phi")(t)
    m2 = m0 + swing * sympy.sin(phi) ** 2
    rate = sympy.diff(phi, t)
    energy = m2 * rate**2 / 2
    left = sympy.diff(sympy.diff(energy, rate), t) - sympy.diff(energy, phi)
    stated = m2 * sympy.diff(phi, t, 2) + swing * sympy.sin(phi) * sympy.cos(phi) * rate**2
    assert sympy.simplify(left - stated) == 0


class TestLinearModel:
    @pytest.mark.parametrize("angle", [0.0, 0.4, DEG_45, DEG_90])
    @pytest.mark.parametrize("params", UNEVEN)
    def test_is_the_derivative_of_the_derived_equations(self, params: dict[str, float], angle: float):
        p = ArmParams(**params, coulomb_friction=0.0)

        def rates(change: Floats, torque: float) -> Floats:
            arm = EventLocatedArm(p, at_rest(angle, gear=p.gear_ratio) + change, "lagrangian")
            (omega_1, omega_phi, motor, phi), _ = arm.rates(torque, 0.0)
            return np.array([p.gear_ratio * omega_1, p.gear_ratio * motor, omega_1 - omega_phi, motor - phi])

        zero = np.zeros(4)
        jacobian = np.array([(rates(d, 0.0) - rates(-d, 0.0)) / 2e-6 for d in 1e-6 * np.eye(4)]).T
        by_torque = (rates(zero, 1e-3) - rates(zero, -1e-3)) / 2e-3
        a, b, _ = state_space(p, angle, "lagrangian")
        np.testing.assert_allclose(a, jacobian, rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(b[:, 0], by_torque, rtol=1e-8, atol=1e-8)

    @pytest.mark.parametrize("angle", [0.3, DEG_45])
    def test_small_motions_of_the_full_arm_follow_it(self, angle: float):
        a, b, _ = state_space(ArmParams(), angle, "lagrangian")
        held = np.zeros((5, 5))
        held[:4, :4], held[:4, 4:] = a, b
        step = expm(CONTROL_PERIOD * held)[:4]
        distances = []
        for amplitude in (1e-3, 5e-4):
            env = full_arm({"coulomb_friction": 0.0}, at_rest(angle, amplitude))
            x = np.array([0.0, 0.0, amplitude, 0.0])
            worst = 0.0
            for k in range(300):
                torque = amplitude * math.sin(k / 20)
                env.step(np.array([torque / 0.3]))
                x = step @ np.append(x, torque)
                worst = max(worst, float(np.abs(env.state - at_rest(angle) - x)[2:].max()))
            distances.append(worst)
        assert distances[0] < 2e-2 * 1e-3
        assert math.log2(distances[0] / distances[1]) == pytest.approx(2.0, abs=0.2)


class TestMotion:
    @pytest.mark.parametrize("params", UNEVEN)
    @pytest.mark.parametrize("torque", [(0.046, 3), (0.06, 5)])
    def test_stick_slip_against_event_located_integration(self, params: dict[str, float], torque: tuple[float, float]):
        amplitude, frequency = torque
        env = full_arm(params, at_rest(DEG_45, gear=params.get("gear_ratio", GEAR)))
        arm = EventLocatedArm(env.params, env.state, "lagrangian")
        worst = 0.0
        for k in range(600):
            demand = amplitude * math.sin(2 * math.pi * frequency * k * CONTROL_PERIOD)
            assert not env.step(np.array([demand / 0.3]))[2]
            arm.advance(demand, CONTROL_PERIOD)
            worst = max(worst, float(np.linalg.norm(tip(env.params, env.state) - tip(arm.params, arm.state))))
        slides = [mode for _, mode in arm.mode_changes if mode != "stuck"]
        assert sum(mode == "stuck" for _, mode in arm.mode_changes) >= 3
        assert sum(before != after for before, after in pairwise(slides)) >= 3
        assert worst < 1e-6

    @pytest.mark.parametrize("regime", ["smooth", "stick-slip"])
    @pytest.mark.parametrize("model", ["lumped", "lagrangian"])
    def test_fourth_order(self, model: str, regime: str):
        result = measure_convergence(model, regime, 400)
        np.testing.assert_allclose(result.orders[:2], 4.0, atol=0.1)
        assert result.errors[0] < 1e-7
        assert result.stops >= 3 if regime == "stick-slip" else result.stops == 0

    @pytest.mark.parametrize("params", UNEVEN)
    def test_energy_is_conserved_without_losses(self, params: dict[str, float]):
        lossless = {"coulomb_friction": 0.0, "motor_viscous_friction": 0.0, "belt_damping_ratio": 0.0}
        env = full_arm({**params, **lossless}, at_rest(DEG_45, 0.1, params.get("gear_ratio", GEAR)))
        before = EventLocatedArm(env.params, env.state, "lagrangian").energy
        for _ in range(EPISODE_STEPS):
            env.step(np.zeros(1, np.float32))
        after = EventLocatedArm(env.params, env.state, "lagrangian").energy
        assert after == pytest.approx(before, rel=1e-5)

    def test_stiff_belt_moves_both_models_alike(self):
        stiff = {"belt_stiffness": 3e4, "belt_damping_ratio": 0.3, "coulomb_friction": 0.0}
        ends = []
        for model in ("lumped", "lagrangian"):
            env = BeltArmEnv(model=model)
            env.reset(options={"params": stiff, "state": at_rest(0.1)})
            for _ in range(250):
                env.step(np.array([0.5]))
            ends.append(env.state[0] / GEAR)
        assert ends[0] > 0.6
        assert ends[0] == pytest.approx(ends[1], rel=1e-3)


class TestEnvironment:
    def test_batch_is_bit_for_bit_as_many_single_arms(self):
        settings: dict[str, Any] = {"model": "lagrangian", "randomization": "train", "sensors": "full"}
        batch = gym.make_vec("BeltArm-v0", num_envs=5, **settings)
        singles = [gym.make("BeltArm-v0", **settings) for _ in range(5)]
        batch.reset(seed=11)
        for arm, env in enumerate(singles):
            env.reset(seed=11 + arm)
        actions = np.random.default_rng(0).uniform(-0.4, 0.4, (200, 5, 1)).repeat(3, axis=0)
        for action in actions.astype(np.float32):
            observations, rewards, terminated, _, _ = batch.step(action)
            assert not terminated.any(), "an arm left the workspace: not compared to the end"
            for arm, env in enumerate(singles):
                observation, reward, *_ = env.step(action[arm])
                np.testing.assert_array_equal(observations[arm], observation)
                assert rewards[arm] == reward

    def test_moves_otherwise_than_the_lumped_arm(self):
        ends = []
        for model in ("lumped", "lagrangian"):
            env = BeltArmVectorEnv(3, model=model)
            env.reset(seed=0)
            for _ in range(300):
                env.step(np.full((3, 1), 0.5, np.float32))
            ends.append(env.state)
        assert (np.abs(ends[0] - ends[1])[:, 2] > 1e-3).all()

    @pytest.mark.parametrize("params", UNEVEN)
    def test_fastest_mode_asks_for_steps_enough(self, params: dict[str, float]):
        p = ArmParams(**{**params, "belt_stiffness": 3e4, "belt_damping_ratio": 0.0})
        steps = integration_substeps(plant(p), FULL_ARM)
        angles = np.linspace(0, DEG_90, 7)
        fastest = max(abs(np.linalg.eigvals(state_space(p, float(angle), "lagrangian")[0])).max() for angle in angles)
        assert 0.11 < fastest * CONTROL_PERIOD / (steps - 1)
        assert fastest * CONTROL_PERIOD / steps <= 0.1201

    @examples(60)
    @given(
        st.tuples(st.floats(1e-4, 0.05), st.floats(1e-4, 0.05)).map(sorted),
        st.tuples(st.floats(0, 0.3), st.floats(0, 0.3)).map(sorted),
        st.sampled_from([LUMPED, FULL_ARM]),
        st.lists(st.floats(0, 1), min_size=2 * 8, max_size=2 * 8),
    )
    def test_no_arm_of_a_range_is_faster_than_those_that_are_checked(
        self, inertia: list[float], swing: list[float], model: Model, shares: list[float]
    ):
        ranges = {"arm_inertia": tuple(inertia), "arm_inertia_swing": tuple(swing), "belt_damping_ratio": (0.0, 3.0)}
        checked = max(fastest_rate(plant_of(row), model) for row in fastest_arms(range_bounds(ranges)))  # pyright: ignore[reportArgumentType]
        for share, other in zip(shares[::2], shares[1::2], strict=True):
            m0, s = inertia[0] + share * (inertia[1] - inertia[0]), swing[0] + other * (swing[1] - swing[0])
            drawn = plant(ArmParams(arm_inertia=m0, arm_inertia_swing=s, belt_damping_ratio=3.0))
            assert fastest_rate(drawn, model) <= checked * (1 + 1e-9)

    @pytest.mark.parametrize("model", [LUMPED, FULL_ARM])
    def test_every_arm_of_ranges_that_are_accepted_can_be_integrated(self, model: Model):
        rng, accepted = np.random.default_rng(0), 0
        upper = asdict(ArmParams(**{name: high for name, (_, high) in TRAIN_RANGES.items()}))
        varied = [name for name in FIELDS if not name.endswith(("_phase", "_order", "_limit"))]
        for _ in range(1500):
            ranges = {}
            for name in rng.choice(varied, 4, replace=False):
                bound = bounds_of(name)
                ends = np.sort(upper[name] * 10 ** rng.uniform(-3, 3, 2))
                ranges[name] = tuple(np.clip(ends, bound.low + 1e-12 * bound.above, bound.high))
            bounds = range_bounds(ranges)
            try:
                check_ranges_integrable(bounds, model)
            except ValueError:
                continue
            accepted += 1
            shares = rng.random((8, len(FIELDS))).round(rng.integers(2))  # ends as often as what lies between
            for row in bounds[0] + shares * (bounds[1] - bounds[0]):
                assert max(integration_limits(row, model)) <= 1 + 1e-9, ranges
        assert accepted > 100

    @pytest.mark.parametrize("params", UNEVEN)
    def test_fastest_rate_is_the_largest_eigenvalue(self, params: dict[str, float]):
        p = ArmParams(**{**params, "belt_damping_ratio": 0.0, "motor_viscous_friction": 0.0})
        for name, model in (("lumped", LUMPED), ("lagrangian", FULL_ARM)):
            ends = [np.abs(np.linalg.eigvals(state_space(p, angle, name)[0])).max() for angle in (0.0, DEG_90)]
            assert fastest_rate(plant(p), model) == pytest.approx(max(ends), rel=1e-9)

    @pytest.mark.parametrize(
        ("inertia", "swing", "fastest"),
        [((0.01, 0.02), (0.03, 0.09), (0.01, 0.06)), ((0.01, 0.05), (0.15, 0.2), (0.025, 0.15))],
    )
    def test_within_ranges_the_full_arm_is_fastest_where_link_2_is_a_rod(
        self, inertia: tuple[float, float], swing: tuple[float, float], fastest: tuple[float, float]
    ):
        def rate(inertia: float, swing: float) -> float:
            arm = ArmParams(arm_inertia=inertia, arm_inertia_swing=swing, belt_damping_ratio=0.0)
            return fastest_rate(plant(arm), FULL_ARM)

        assert rate(*fastest) > 1.001 * max(rate(*corner) for corner in product(inertia, swing))
        ranges = {"arm_inertia": inertia, "arm_inertia_swing": swing, "belt_damping_ratio": (0.0, 0.0)}
        checked = [fastest_rate(plant_of(row), FULL_ARM) for row in fastest_arms(range_bounds(ranges))]
        assert max(checked) == pytest.approx(rate(*fastest), rel=1e-12)

    def test_limits_by_hand(self):
        arm = ArmParams(
            **{"belt_damping_ratio": 0.0, "belt_stiffness": 3300.0, "belt_stiffening": 0.4, "kinematic_error": 0.002},
            **{"coulomb_friction": 0.03, "friction_variation": 0.2, "static_friction_excess": 0.5},
            **{"torque_limit": 0.3, "torque_constant_error": 0.1, "torque_ripple": 0.006, "stribeck_speed": 0.1},
        )
        rate, slack, steps = integration_limits(arm.row(), LUMPED)
        # The steepest belt is 1.5 times as stiff; motor and arm, stretched, swing against each other.
        mobility = 1 / (6.3e-5 * GEAR**2) + 1 / arm.arm_inertia
        assert rate == pytest.approx(math.sqrt(1.5 * 3300 * mobility) / (400 * 0.12 / 0.0015))
        assert slack == pytest.approx(2.2 * 0.002 * 88)
        # From full torque to the opposite, with friction and ripple: 0.66 + 0.054 + 0.006 N m.
        assert steps == pytest.approx(12 * 0.0015 * 0.72 / 6.3e-5 / 0.1 / 15_000)
        assert integration_limits(replace(arm, static_friction_excess=0.0).row(), LUMPED)[2] == 0.0

    def test_a_motor_in_thick_oil_is_fast_too(self):
        oily = plant(ArmParams(motor_viscous_friction=0.63))
        assert fastest_rate(oily, LUMPED) == pytest.approx(0.63 / 6.3e-5)
        assert integration_substeps(oily, LUMPED) == math.ceil(1e4 * 0.0015 / 0.12)
        assert integration_substeps(plant(ArmParams()), LUMPED) == 1.0

    def test_the_largest_kinematic_error_is_the_one_that_the_refusal_names(self):
        largest = ArmParams(kinematic_error=1 / 2.2 / 64, gear_ratio=64.0)
        check_integrable(largest.row()[None], LUMPED)
        with pytest.raises(ValueError, match=r"with gear_ratio 64 at most 0\.0071 can be integrated"):
            check_integrable(replace(largest, kinematic_error=0.00711).row()[None], LUMPED)

    def test_too_stiff_an_arm_is_refused(self):
        with pytest.raises(ValueError, match=r"fastest rate is .* lower belt_stiffness"):
            BeltArmEnv(model="lagrangian").reset(options={"params": {"belt_stiffness": 1e9}})

    @pytest.mark.parametrize("steps", [0, 401, 2.0, True])
    def test_integration_steps_out_of_range_are_refused(self, steps: Any):
        env = full_arm({}, at_rest(0.5))
        with pytest.raises(ValueError, match=r"steps must be a whole number from 1 to 400, got "):
            env.set_integration_steps(steps)


def slowest_pair(a: Floats) -> complex:
    (pole,) = [pole for pole in np.linalg.eigvals(a) if pole.imag > 1e-6]
    return complex(pole)


class TestWhatTheDocumentationSays:
    """The table of modes in docs/science/physics.md."""

    @pytest.mark.parametrize(
        ("model", "degrees", "stuck", "free", "damping"),
        [
            ("lumped", 0, 57.4, 58.0, 0.225),
            ("lumped", 45, 28.7, 29.9, 0.279),
            ("lumped", 90, 21.7, 23.2, 0.237),
            ("lagrangian", 0, 28.7, 28.8, -0.079),
            ("lagrangian", 45, 28.7, 29.0, 0.156),
            ("lagrangian", 90, 28.7, 30.5, 0.325),
        ],
    )
    def test_modes(self, model: str, degrees: float, stuck: float, free: float, damping: float):
        lossless = ArmParams(belt_damping_ratio=0.0, motor_viscous_friction=0.0)
        angle = math.radians(degrees)
        arm = EventLocatedArm(lossless, at_rest(angle), model)
        assert math.sqrt(33 / arm.mass_matrix()[1, 1]) == pytest.approx(stuck, abs=0.06)
        assert slowest_pair(state_space(lossless, angle, model)[0]).imag == pytest.approx(free, abs=0.06)
        p = ArmParams(belt_damping_ratio=0.0)
        a, b, _ = state_space(p, angle, model)
        m, v = p.motor_inertia, p.motor_viscous_friction
        pole = slowest_pair(a - b @ np.array([[25 * m, 20 * m - v, 0.0, 0.15]]))
        assert -pole.real / abs(pole) == pytest.approx(damping, abs=6e-4)

    def test_at_24_degrees_the_motor_does_not_move_the_belt(self):
        angle = math.asin(math.sqrt(1 / 6))
        assert math.degrees(angle) == pytest.approx(24.1, abs=0.05)
        by_torque = [state_space(ArmParams(), angle + d, "lagrangian")[1][3, 0] for d in (-0.1, 0.0, 0.1)]
        assert by_torque[0] < 0 < by_torque[2]
        assert by_torque[1] == pytest.approx(0.0, abs=1e-9)
