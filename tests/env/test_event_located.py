"""The event-located solutions and LuGre friction of `eval/reference`, against what is known without solving them."""

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy
from driven_arms import GEAR, LOSSLESS, MODELS, UPPER_ENDS, at_rest, full_arm_at, push, stops

from beltarm_env import CONTROL_PERIOD, ArmParams, BeltArmVectorEnv
from eval.reference.event_located import EventLocatedArm, tip
from eval.reference.lugre import LuGreArms
from eval.reference.symbolic_arm import derive, masses_of

CONSERVATIVE = {
    **LOSSLESS,
    **{"torque_ripple": 0.006, "torque_ripple_order": 7, "torque_ripple_phase": 1.0},
    **{"kinematic_error": 0.005, "kinematic_error_phase": 2.0, "belt_stiffening": 0.9, "payload_mass": 0.2},
}
EACH_MODEL = pytest.mark.parametrize("model", MODELS)


class TestEquations:
    @EACH_MODEL
    def test_follow_from_the_energy(self, model: str):
        """Lagrange's equations in (alpha, phi), with theta_1 = alpha + e sin(2 G alpha + phi_e) put into the energy."""
        params = ArmParams(kinematic_error=0.001, kinematic_error_phase=0.7, payload_mass=0.1, arm_inertia_swing=0.08)
        matrix, bias = lagrange(model, params)
        rng = np.random.default_rng(0)
        for _ in range(50):
            alpha, phi, alpha_rate, phi_rate = rng.uniform([-0.5, -0.5, -3, -3], [2, 2, 3, 3])
            x = np.array([GEAR * alpha, GEAR * alpha_rate, alpha - phi, alpha_rate - phi_rate])
            arm = EventLocatedArm(params, x, model)
            terms = arm.equations(np.array([alpha, phi, alpha_rate, phi_rate]))
            np.testing.assert_allclose(arm.mass_matrix(), matrix(alpha, phi, alpha_rate, phi_rate), rtol=1e-11)
            np.testing.assert_allclose([terms.c1, terms.c2], bias(alpha, phi, alpha_rate, phi_rate), atol=1e-10)

    def test_masses_of_the_parameters(self):
        for swing in (0.02, 0.06, 0.2):
            params = ArmParams(arm_inertia_swing=swing, payload_mass=0.3, link_length=0.3)
            for phi in (0.0, 0.4, math.pi / 2):
                total = GEAR**2 * 6.3e-5 + 0.01 + (swing + 4 * 0.3**2 * 0.3) * math.sin(phi) ** 2
                assert full_arm_at(params, 0.1, phi).mass_matrix().sum() == pytest.approx(total, rel=1e-12)
        nominal = masses_of(ArmParams())
        assert (nominal.rod, nominal.end, nominal.pulley) == pytest.approx((0.48, 0.0, 0.0)), "a uniform rod alone"

    def test_the_tip_turns_with_the_belts_torsion(self):
        params = ArmParams(kinematic_error=0.0005, kinematic_error_phase=0.7)
        torsion, phi = 0.02 + 0.0005 * math.sin(120.7), 60 / GEAR - 0.02
        reach = 0.5 * math.cos(phi) + 0.1
        expected = [reach * math.cos(torsion), reach * math.sin(torsion)]
        np.testing.assert_allclose(tip(params, np.array([60.0, 0.0, 0.02, 0.0])), expected, atol=1e-15)


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


class TestMotion:
    @EACH_MODEL
    def test_energy_is_conserved_without_losses(self, model: str):
        arm = EventLocatedArm(ArmParams(**CONSERVATIVE), np.array([0.5 * GEAR, 30.0, 0.06, -1.0]), model)
        before, angles = arm.energy, []
        for _ in range(400):
            arm.sample(0.0)
            angles.append(arm.state[0])
            assert arm.energy == pytest.approx(before, rel=2e-10)
        assert np.ptp(angles) > 2 * math.pi, "more than a turn of the motor"

    def test_work_of_the_drive_is_stored_and_lost(self):
        """Energy less the motor's work falls by what friction and belt take, integrated beside it on a fine grid."""
        arm = EventLocatedArm(ArmParams(**UPPER_ENDS), np.array([60.0, 0.0, 0.0, 0.0]), "lagrangian")
        stored, balance = arm.energy, 0.0
        for k in range(200):
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
        assert stops(arm) >= 2

    def test_a_stiff_belt_moves_like_a_rigid_one(self):
        # Rigid and unforced but for the motor: 1/2 (I_1 + M0 + S sin^2(phi)) phi'^2 = G tau_m (phi - phi_0).
        params = ArmParams(**LOSSLESS | {"belt_stiffness": 3e5, "belt_damping_ratio": 1.0})
        arm = EventLocatedArm(params, np.zeros(4), "lagrangian")
        arm.advance(0.2, 0.3)
        (theta_1, phi), (omega_1, _) = arm.angles, arm.rates(0.2, 0.0)[0][:2]
        inertia = params.motor_inertia * GEAR**2 + 0.01 + 0.06 * math.sin(phi) ** 2
        assert theta_1 > 0.5
        assert omega_1 == pytest.approx(math.sqrt(2 * GEAR * 0.2 * theta_1 / inertia), rel=1e-3)

    @pytest.mark.parametrize(("share", "mode"), [(0.99, "stuck"), (1.01, "backward")])
    def test_what_holds_a_stuck_motor(self, share: float, mode: str):
        # At rest with link 2 folded onto link 1 (phi = 90 deg): its own inertia, a rod's 4/3 m2 l^2 for phi, couples to
        # the motor by 1/3 m2 l^2. The motor feels the belt's torque and a quarter more.
        torsion = share * GEAR * 0.032 / (1.25 * 33.0)
        arm = EventLocatedArm(ArmParams(), at_rest(math.pi / 2 + torsion, torsion), "lagrangian")
        assert arm.holding_torque(0.0) == pytest.approx(-share * 0.032, rel=1e-12)
        arm.advance(0.0, CONTROL_PERIOD / 10)
        assert [new for _, new in arm.mode_changes] == [mode]
        assert (arm.state[1] < 0) == (mode == "backward")


def lugre_motion(deflection: float | None, samples: int = 200, steps: int = 60) -> np.ndarray:
    """States of three arms of the training ranges that are pushed back and forth, shape (samples, 3, 4)."""
    env = BeltArmVectorEnv(3, randomization="train", autoreset_mode="Disabled")
    if deflection is not None:
        env._batch.engine = LuGreArms(env._batch, deflection, steps)
    env.reset(seed=4_200_900)
    states = np.empty((samples, 3, 4))
    for k in range(samples):
        env.step(np.full((3, 1), push(k) / 0.3, np.float32))
        states[k] = env.state
    return states


class TestLuGre:
    def test_located_friction_is_the_limit_of_a_stiff_bristle(self):
        located = lugre_motion(None)
        assert np.ptp(located[:, :, 0], axis=0).min() > 1 and (located[100:, :, 1] == 0).any(), "moves and sticks"
        apart = [np.abs(lugre_motion(deflection) - located)[:, :, 0].max() for deflection in (3e-3, 3e-4, 3e-5)]
        assert apart[1] < 0.5 * apart[0] and apart[2] < 0.5 * apart[1]
        assert apart[2] < 0.01 * np.ptp(located[:, :, 0], axis=0).max()

    def test_bristle_gives_way_by_its_deflection(self):
        env = BeltArmVectorEnv(1, autoreset_mode="Disabled")
        env._batch.engine = LuGreArms(env._batch, 2e-3)
        env.reset(seed=0, options={"params": {"belt_stiffness": 1e-3, "motor_viscous_friction": 0.0}})
        start, params = env.state[0, 0], env.params[0]
        pull = 0.5 * params.coulomb_friction / params.torque_limit
        for k in range(300):
            env.step(np.full((1, 1), pull * min(k / 200, 1.0), np.float32))
        # dz/dtheta_a = 1 - z / z_max on the way: the bristle is at z_max / 2 when the motor has turned by z_max ln 2
        assert env.state[0, 0] - start == pytest.approx(2e-3 * np.log(2), rel=0.01)
