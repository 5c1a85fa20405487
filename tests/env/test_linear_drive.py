"""Linear models of the arm with its drive, against SciPy, python-control and the arm itself."""

import math
from dataclasses import replace

import control
import numpy as np
import pytest
from driven_arms import UPPER_ENDS, push
from scipy.linalg import expm

from beltarm_env import CONTROL_PERIOD, ArmParams, sampled_state_space, state_space
from beltarm_env.arm import params_table
from beltarm_env.physics.linear import sample_models
from eval.reference.event_located import EventLocatedArm

GEAR = 88.0
MODELS = ("lumped", "lagrangian")
ANGLES = (0.0, 0.6, math.pi / 2)
DRIVEN = ArmParams(**UPPER_ENDS)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("angle", ANGLES)
def test_the_current_loop_is_a_fifth_state(angle: float, model: str):
    params = replace(DRIVEN, current_loop_time_constant=0.0007, torque_constant_error=-0.05)
    a, b, c = state_space(params, angle, model)
    with_loop, by_command, both = state_space(params, angle, model, actuator=True)
    np.testing.assert_array_equal(with_loop[:4], np.hstack([a, b]))
    np.testing.assert_allclose(with_loop[4], [0, 0, 0, 0, -1 / 0.0007], rtol=1e-15)
    np.testing.assert_allclose(by_command[:, 0], [0, 0, 0, 0, 0.95 / 0.0007], rtol=1e-15)
    np.testing.assert_array_equal(both, np.hstack([c, np.zeros((2, 1))]))
    # The same as a lag in series with the arm.
    lag = control.tf([0.95], [0.0007, 1])
    series = control.ss(a, b, c, np.zeros((2, 1))) * control.tf2ss(lag)
    frequencies = np.array([3.0, 30.0, 300.0])
    whole = control.ss(with_loop, by_command, both, np.zeros((2, 1)))
    for frequency in frequencies:
        np.testing.assert_allclose(whole(1j * frequency), series(1j * frequency), rtol=1e-9)


def test_without_a_current_loop_there_is_nothing_to_add():
    for lag in (0.0, 1e-300, 9e-8):
        arm = ArmParams(command_latency=0.001, current_loop_time_constant=lag)
        with pytest.raises(
            ValueError, match=rf"actuator=True needs a current_loop_time_constant .* 1e-07 s, got {lag!r}"
        ):
            state_space(arm, 0.5, actuator=True)
        at_once = sampled_state_space(replace(arm, current_loop_time_constant=0.0), 0.5)
        assert all(map(np.array_equal, sampled_state_space(arm, 0.5), at_once))


@pytest.mark.parametrize("model", MODELS)
def test_effects_that_are_not_linear_or_have_no_mean_are_left_out(model: str):
    kept = ("current_loop_time_constant", "command_latency", "torque_constant_error", "belt_stiffening")
    a, b, _ = state_space(DRIVEN, 0.6, model)
    without = {name: getattr(DRIVEN, name) for name in kept}
    for other in (ArmParams(**without), ArmParams(belt_stiffening=0.25)):
        np.testing.assert_array_equal(state_space(other, 0.6, model)[0], a)
        np.testing.assert_array_equal(state_space(other, 0.6, model)[1], b)


@pytest.mark.parametrize("model", MODELS)
def test_the_belt_has_its_stiffness_about_zero_torsion(model: str):
    # The damping comes from the mean stiffness: without it, a softer arm is the same.
    stiffening = ArmParams(belt_stiffening=0.25, belt_damping_ratio=0.0)
    soft = ArmParams(belt_stiffness=0.75 * 33, belt_damping_ratio=0.0)
    np.testing.assert_array_equal(state_space(stiffening, 0.6, model)[0], state_space(soft, 0.6, model)[0])
    angles = np.array(ANGLES)
    for one, other in zip(*(sample_models(params_table([p]), angles, 0.0015) for p in (stiffening, soft)), strict=True):
        np.testing.assert_array_equal(one, other)


def test_models_from_sample_to_sample_are_blocks_of_an_exponential():
    arms = [ArmParams(), ArmParams(belt_stiffness=20.0, payload_mass=0.2, belt_damping_ratio=0.03, gear_ratio=60.0)]
    models = sample_models(params_table(arms), np.array(ANGLES), 0.0015)
    for i, arm in enumerate(arms):
        for k, angle in enumerate(ANGLES):
            held = np.zeros((6, 6))  # x, and what is held: the torque, and an acceleration of the torsion
            held[:4, :4], held[:4, 4:5], _ = state_space(arm, angle)
            held[3, 5] = 1.0
            exact = expm(0.0015 * held)
            for found, block in zip(models, (exact[:4, :4], exact[:4, 4], exact[:4, 5]), strict=True):
                np.testing.assert_allclose(found[i, k], block, rtol=1e-12, atol=1e-17)


@pytest.mark.parametrize("angle", [0.0, math.pi / 2, np.float64(0.3), 1, np.int64(0)])
def test_angles_of_the_workspace_and_of_any_type_of_number(angle: float):
    a, _, _ = state_space(ArmParams(), angle)
    assert a[3, 2] == pytest.approx(-33 * (1 / (6.3e-5 * GEAR**2) + 1 / inertia(float(angle))))


def inertia(angle: float) -> float:
    """M2 of the nominal arm [kg m^2]."""
    nominal = ArmParams()
    return nominal.arm_inertia + nominal.arm_inertia_swing * math.sin(angle) ** 2


@pytest.mark.parametrize("model", MODELS)
def test_is_the_derivative_of_the_derived_equations(model: str):
    p = replace(DRIVEN, coulomb_friction=0.0, kinematic_error=0.0, torque_ripple=0.0)

    def rates(change: np.ndarray) -> np.ndarray:
        arm = EventLocatedArm(p, np.array([GEAR * 0.6, 0, 0, 0]) + change, model)
        (omega_1, omega_phi, motor, phi), _ = arm.rates(0.0, 0.0)
        return np.array([GEAR * omega_1, GEAR * motor, omega_1 - omega_phi, motor - phi])

    jacobian = np.array([(rates(d) - rates(-d)) / 2e-6 for d in 1e-6 * np.eye(4)]).T
    np.testing.assert_allclose(state_space(p, 0.6, model)[0], jacobian, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("lag", [0.0, 1e-5, 2e-4, 1e-3, 0.01])
@pytest.mark.parametrize("latency", [0.0, 0.3, 1.0, 1.5, 2.0, 2.9, 3.0])
def test_sampled_model_is_made_of_exponentials(latency: float, lag: float, model: str):
    p = replace(DRIVEN, command_latency=latency * CONTROL_PERIOD, current_loop_time_constant=lag)
    a, b, c = sampled_state_space(p, 0.6, model)
    past = math.ceil(latency)
    assert a.shape == (5 + past, 5 + past) and b.shape == (5 + past, 1) and c.shape == (2, 5 + past)
    late = p.command_latency / CONTROL_PERIOD - math.floor(p.command_latency / CONTROL_PERIOD)
    rng = np.random.default_rng(0)
    commands = rng.uniform(-0.3, 0.3, 12)
    z, x, torque = np.zeros(5 + past), np.zeros(4), 0.0
    arm, by_torque, _ = state_space(p, 0.6, model)
    for k, command in enumerate(commands):
        for duration, age in ((late, math.floor(latency) + 1), (1 - late, math.floor(latency))):
            target = 1.10 * (commands[k - age] if k >= age else 0.0)
            held = np.zeros((6, 6))  # x, tau, target
            held[:4, :4] = arm
            held[:4, 4 if lag else 5] = by_torque[:, 0]
            if lag:
                held[4, 4:] = [-1 / lag, 1 / lag]
            ended = expm(duration * CONTROL_PERIOD * held) @ np.array([*x, torque, target])
            x, torque = ended[:4], float(ended[4]) if lag else target
        z = a @ z + b[:, 0] * command
        np.testing.assert_allclose(z[:4], x, rtol=1e-10, atol=1e-14)
        assert z[4] == pytest.approx(torque, rel=1e-11)
        np.testing.assert_array_equal(z[5:], [commands[k - j] if k >= j else 0.0 for j in range(past)])


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("whole", [0, 1, 3])
def test_sampled_model_is_that_of_python_control(whole: int, model: str):
    p = replace(DRIVEN, command_latency=whole * CONTROL_PERIOD)
    continuous = control.ss(*state_space(p, 0.6, model, actuator=True), np.zeros((2, 1)))
    there = control.c2d(continuous, CONTROL_PERIOD, "zoh")
    here = control.ss(*sampled_state_space(p, 0.6, model), np.zeros((2, 1)), CONTROL_PERIOD)
    for rate in (0.01, 0.3, 2.0):
        point = np.exp(1j * rate)
        np.testing.assert_allclose(here(point), there(point) / point**whole, rtol=1e-8)


@pytest.mark.parametrize("model", MODELS)
def test_with_the_ideal_drive_it_is_the_arms_own(model: str):
    a, b, c = sampled_state_space(ArmParams(), 0.6, model)
    own = control.c2d(control.ss(*state_space(ArmParams(), 0.6, model), np.zeros((2, 1))), CONTROL_PERIOD, "zoh")
    np.testing.assert_allclose(a[:4, :4], own.A, rtol=1e-10, atol=1e-14)
    np.testing.assert_allclose(b[:4], own.B, rtol=1e-10)
    np.testing.assert_array_equal(a[:, 4], 0)
    np.testing.assert_array_equal(a[4], 0)
    assert b[4] == 1 and c.shape == (2, 5)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("drive", [{}, {"current_loop_time_constant": 0.0}, {"command_latency": 0.0}])
def test_small_motions_of_the_driven_arm_follow_it(drive: dict[str, float], model: str):
    p = replace(DRIVEN, coulomb_friction=0.0, kinematic_error=0.0, torque_ripple=0.0, friction_drift=0.0, **drive)
    a, b, _ = sampled_state_space(p, 0.6, model)
    distances = []
    for amplitude in (1e-2, 5e-3):
        arm = EventLocatedArm(p, np.array([GEAR * 0.6, 0, 0, 0]), model)
        z = np.zeros(len(a))
        for k in range(100):
            arm.sample(amplitude * push(k))
            z = a @ z + b[:, 0] * amplitude * push(k)
        distances.append(np.abs(arm.state - [GEAR * 0.6, 0, 0, 0] - z[:4]).max() / np.abs(z[:4]).max())
    assert distances[0] < 1e-3
    assert distances[1] < 0.6 * distances[0]


@pytest.mark.parametrize("angle", [-0.1, 1.6, math.nan])
def test_joint_angles_outside_are_refused(angle: float):
    with pytest.raises(ValueError, match="theta_1 must lie within 0 and pi/2 rad, got "):
        sampled_state_space(ArmParams(), angle)
