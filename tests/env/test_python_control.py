"""The arm as a system of python-control."""

from typing import Any

import control
import numpy as np
import pytest

import beltarm_env
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.simulation import ArmSimulation

STATES = ["theta_a", "omega_a", "theta_s", "omega_s"]
SMOOTH = ArmParams(coulomb_friction=0.0)
FINEST: Any = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-12}


def response_of(params: ArmParams, torque: float, start: Any, count: int) -> np.ndarray:
    """States by python-control, shape (count + 1, 4), with the torque held over as many control periods."""
    times: Any = np.arange(count + 1) * CONTROL_PERIOD
    held: Any = np.full((1, count + 1), torque)
    return control.input_output_response(arm_of(params), times, held, start, solve_ivp_kwargs=FINEST).states.T


def arm_of(params: ArmParams, model: str = "lumped") -> control.NonlinearIOSystem:
    return control.nlsys(
        lambda t, x, u, p: beltarm_env.state_derivative(x, u[0], params, model), inputs=["torque"], states=STATES
    )


@pytest.mark.parametrize("model", ["lumped", "lagrangian"])
@pytest.mark.parametrize("angle", [0.0, 0.7, np.pi / 2])
def test_linearised_it_is_the_linear_model(angle: float, model: str):
    a, b, _ = beltarm_env.state_space(SMOOTH, angle, model)
    linear = arm_of(SMOOTH, model).linearize([angle * SMOOTH.gear_ratio, 0, 0, 0], 0)
    np.testing.assert_allclose(linear.A, a, rtol=1e-4, atol=1e-5 * np.abs(a).max())
    np.testing.assert_allclose(linear.B, b, rtol=1e-4, atol=1e-5 * np.abs(b).max())


def test_simulated_it_moves_as_the_environment_does():
    simulation, start, torque, count = ArmSimulation(SMOOTH), np.array([20.0, 0, 0, 0]), np.array([0.05]), 60
    states = [start[None]]
    for _ in range(count):
        states.append(simulation.advance(states[-1], torque))
    np.testing.assert_allclose(
        response_of(SMOOTH, torque[0], start, count), np.concatenate(states), rtol=1e-6, atol=1e-6
    )


def test_friction_holds_a_motor_at_rest_and_opposes_one_that_turns():
    params = ArmParams()
    at_rest, slack = np.zeros(4), 0.5 * params.coulomb_friction
    assert beltarm_env.state_derivative(at_rest, slack, params).tolist() == [0, 0, 0, 0]
    assert beltarm_env.state_derivative(at_rest, 3 * slack, params)[1] == pytest.approx(slack / params.motor_inertia)
    for speed in (-1.0, 1.0):
        braked = -speed * (params.coulomb_friction + params.motor_viscous_friction) / params.motor_inertia
        assert beltarm_env.state_derivative([0, speed, 0, 0], 0, params)[1] == pytest.approx(braked, rel=1e-3)


def test_the_slope_is_that_of_a_short_motion_behind_a_drive_as_it_is_built():
    params = ArmParams(static_friction_excess=0.5, torque_ripple=0.005, kinematic_error=2e-4, belt_stiffening=0.3)
    x, torque = np.array([30.0, 40.0, 0.004, -0.2]), 0.05
    simulation = ArmSimulation(params)
    states = simulation.at_rest(np.array([30.0]))
    states[0, :4] = x
    later = simulation.advance(states, np.array([torque]))[0, :4]
    np.testing.assert_allclose(response_of(params, torque, x, 1)[-1], later, rtol=1e-4, atol=1e-5)


def test_what_it_cannot_take_is_named():
    with pytest.raises(ValueError, match=r"x must have shape \(4,\)"):
        beltarm_env.state_derivative([0, 0, 0], 0, SMOOTH)
    with pytest.raises(ValueError, match="model must be one of 'lumped'"):
        beltarm_env.state_derivative(np.zeros(4), 0, SMOOTH, "rigid")
