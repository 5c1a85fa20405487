"""The reference solution of the full arm, against what is known of it without solving it."""

import math

import numpy as np
import pytest
import sympy
from full_arms import full_arm, full_arm_at, some_params

from beltarm_env import CONTROL_PERIOD, ArmParams
from eval.reference.event_located import tip
from eval.reference.symbolic_arm import Masses, compiled, derive, masses_of

GEAR = 88.0
LOSSLESS = {"coulomb_friction": 0.0, "motor_viscous_friction": 0.0, "belt_damping_ratio": 0.0}


# What the parameters mean


@pytest.mark.parametrize("rest", ["hand", "pulley"])
def test_a_rigid_belt_gives_the_inertia_of_the_parameters(rest: str):
    m0, s, l, payload, motor = sympy.symbols("M_0 S l m_p I_1", positive=True)  # noqa: E741
    if rest == "hand":  # S > 6 M_0
        masses = Masses(motor, l, 3 * m0 / l**2, (s - 6 * m0) / (4 * l**2) + payload, 0)
    else:
        masses = Masses(motor, l, s / (2 * l**2), payload, m0 - s / 6)
    equations = derive()
    theta_1, phi = equations.angles
    turning = sympy.Matrix([1, 1])  # theta_1' = phi'
    inertia = (turning.T * equations.mass_matrix * turning)[0].subs(dict(zip(equations.masses, masses, strict=True)))
    stated = motor + m0 + (s + 4 * l**2 * payload) * sympy.sin(phi) ** 2
    assert sympy.simplify(inertia - stated) == 0
    assert theta_1 not in inertia.free_symbols


@pytest.mark.parametrize("swing", [0.02, 0.06, 0.2])
def test_masses_of_the_parameters(swing: float):
    params = ArmParams(arm_inertia_swing=swing, payload_mass=0.3, link_length=0.3)
    for phi in (0.0, 0.4, math.pi / 2):
        stated = GEAR**2 * 6.3e-5 + 0.01 + (swing + 4 * 0.3**2 * 0.3) * math.sin(phi) ** 2
        assert full_arm_at(params, 0.1, phi).mass_matrix().sum() == pytest.approx(stated, rel=1e-12)


def test_nominal_link_2_is_a_uniform_rod_alone():
    masses = masses_of(ArmParams())
    assert masses.rod == pytest.approx(0.48)
    assert masses.end == pytest.approx(0.0, abs=1e-15) and masses.pulley == pytest.approx(0.0, abs=1e-15)


def test_mass_matrix_is_positive_definite():
    rng = np.random.default_rng(0)
    for _ in range(300):
        eigenvalues = np.linalg.eigvalsh(
            full_arm_at(some_params(rng), *rng.uniform(-math.pi, math.pi, 2)).mass_matrix()
        )
        assert eigenvalues.min() > 0


def test_kinetic_energy_of_moving_parts():
    # Link 2's kinetic energy from two points that stand for a uniform rod: at its middle +- l / sqrt(12), half the mass
    # each. Their speeds by finite differences of the positions.
    params, rng = ArmParams(arm_inertia_swing=0.09, payload_mass=0.2), np.random.default_rng(1)
    masses = masses_of(params)

    def points(q: np.ndarray) -> np.ndarray:
        joint_2, along = np.exp(1j * q[0]), np.exp(1j * (q[0] - 2 * q[1]))
        spread = np.array([0.5 - 12**-0.5, 0.5 + 12**-0.5, 1.0])
        return masses.link * (joint_2 + spread * along)

    for _ in range(20):
        q, u = rng.uniform(-1, 1, 2), rng.uniform(-2, 2, 2)
        speeds = np.abs(points(q + 1e-6 * u) - points(q - 1e-6 * u)) / 2e-6
        expected = 0.5 * (masses.motor * u[0] ** 2 + speeds**2 @ [masses.rod / 2, masses.rod / 2, masses.end])
        assert compiled()(*q, *u, *masses)[5] == pytest.approx(expected, rel=1e-8)


# What moves


def test_energy_is_conserved_without_losses():
    arm = full_arm(ArmParams(**LOSSLESS, payload_mass=0.1), np.array([0.5 * GEAR, 0.4 * GEAR, 0.05, -1.0]))
    before = arm.energy
    for _ in range(300):
        arm.advance(0.0, CONTROL_PERIOD)
        assert arm.energy == pytest.approx(before, rel=1e-10)
    assert abs(arm.state[0] / GEAR - 0.5) > 0.1


@pytest.mark.parametrize(("viscous", "tolerance"), [(0.0, 1e-12), (3.5e-4, 2e-7)])
def test_power_balances_and_friction_never_creates_energy(viscous: float, tolerance: float):
    params = ArmParams(belt_damping_ratio=0.0, motor_viscous_friction=viscous)
    arm = full_arm(params, np.array([0.7 * GEAR, 0.0, 0.03, 0.0]))
    slid = 0.0
    for k in range(800):
        torque = 0.06 * math.sin(8 * math.pi * k * CONTROL_PERIOD)
        before, start, changes = arm.energy, arm.state, len(arm.mode_changes)
        arm.advance(torque, CONTROL_PERIOD)
        turned = arm.state[0] - start[0]
        loss = torque * turned - (arm.energy - before)
        assert loss >= -1e-12
        if len(arm.mode_changes) == changes:  # tau_c |turned| + V_a1 int omega_a^2 dt, by the trapezium rule
            squares = 0.5 * (start[1] ** 2 + arm.state[1] ** 2) * CONTROL_PERIOD
            assert loss == pytest.approx(0.032 * abs(turned) + viscous * squares, abs=tolerance)
        slid += abs(turned)
    assert slid > 1.0
    assert sum(new == "stuck" for _, new in arm.mode_changes) >= 4


def test_damping_of_the_belt_takes_energy():
    params = ArmParams(coulomb_friction=0.0, motor_viscous_friction=0.0)
    arm = full_arm(params, np.array([0.7 * GEAR, 0.0, 0.05, 0.0]))
    energies = []
    for _ in range(400):
        energies.append(arm.energy)
        arm.advance(0.0, CONTROL_PERIOD)
    assert np.all(np.diff(energies) <= 1e-14) and energies[-1] < 0.8 * energies[0]


def test_a_stiff_belt_moves_like_a_rigid_one():
    # Rigid and unforced but for the motor: 1/2 (I_1 + M0 + S sin^2(phi)) phi'^2 = G tau_m (phi - phi_0).
    params = ArmParams(coulomb_friction=0.0, motor_viscous_friction=0.0, belt_stiffness=3e5, belt_damping_ratio=1.0)
    arm = full_arm(params, np.zeros(4))
    arm.advance(0.2, 0.3)
    (theta_1, phi), (omega_1, _) = arm.angles, arm.rates(0.2, 0.0)[0][:2]
    inertia = params.motor_inertia * GEAR**2 + 0.01 + 0.06 * math.sin(phi) ** 2
    assert theta_1 > 0.5
    assert omega_1 == pytest.approx(math.sqrt(2 * GEAR * 0.2 * theta_1 / inertia), rel=1e-3)


@pytest.mark.parametrize(("share", "mode"), [(0.99, "stuck"), (1.01, "backward")])
def test_what_holds_a_stuck_motor(share: float, mode: str):
    # At rest with link 2 folded onto link 1 (phi = 90 deg): its own inertia, a rod's 4/3 m2 l^2 for phi, couples to the
    # motor by 1/3 m2 l^2. The motor feels the belt's torque and a quarter more.
    torsion = share * GEAR * 0.032 / (1.25 * 33.0)
    arm = full_arm(ArmParams(), np.array([GEAR * (math.pi / 2 + torsion), 0.0, torsion, 0.0]))
    assert arm.holding_torque(0.0) == pytest.approx(-share * 0.032, rel=1e-12)
    arm.advance(0.0, CONTROL_PERIOD / 10)
    assert [new for _, new in arm.mode_changes] == [mode]
    assert (arm.state[1] < 0) == (mode == "backward")


@pytest.mark.parametrize("sign", [-1, 1])
def test_breaking_away_goes_on_the_way_it_is_pushed(sign: int):
    # The torque rises until the motor goes: at that instant friction is tau_c either way, so nothing jumps.
    arm = full_arm(ArmParams(), np.array([0.7 * GEAR, 0.0, 0.0, 0.0]))
    for k in range(40):  # of exactly tau_c too
        arm.advance(sign * 0.001 * k, CONTROL_PERIOD)
    assert [mode for _, mode in arm.mode_changes] == ["stuck", "forward" if sign > 0 else "backward"]
    assert sign * arm.state[1] > 0.01


def test_tip_at_rest_is_that_of_the_lumped_arm():
    state = np.array([0.6 * GEAR, 0.0, 0.02, 0.0])
    arm = full_arm(ArmParams(), state)
    assert np.allclose(tip(arm.params, arm.state), tip(ArmParams(), state), atol=1e-15)
