"""Linear models of the arm, with and without its drive, against SciPy, python-control and the arm itself."""

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from typing import Any

import control
import numpy as np
import pytest
from driven_arms import GEAR, GIVES, MODELS, UPPER_ENDS, apply, arm_env, at_rest
from refusals import refused
from scipy.linalg import expm

from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS, ArmParams, sampled_state_space, state_derivative, state_space
from beltarm_env.simulation import ArmSimulation
from eval.reference.event_located import EventLocatedArm

ANGLES = (0.0, 0.6, math.pi / 2)
DRIVEN = ArmParams(**UPPER_ENDS)
SMOOTH = replace(DRIVEN, coulomb_friction=0.0, kinematic_error=0.0, torque_ripple=0.0, friction_drift=0.0)
FRICTIONLESS = ArmParams(coulomb_friction=0.0)
HAND = replace(FRICTIONLESS, arm_inertia=0.008, arm_inertia_swing=0.072, payload_mass=0.1)
PULLEY = replace(FRICTIONLESS, arm_inertia=0.012, arm_inertia_swing=0.048, gear_ratio=60.0, belt_damping_ratio=0.05)
EACH_MODEL = pytest.mark.parametrize("model", MODELS)


class TestStateSpace:
    @EACH_MODEL
    @pytest.mark.parametrize("p", [SMOOTH, FRICTIONLESS, HAND, PULLEY], ids=["driven", "nominal", "hand", "pulley"])
    def test_is_the_derivative_of_the_derived_equations(self, p: ArmParams, model: str):
        for angle in ANGLES:

            def rates(change: np.ndarray, torque: float, angle: float = angle) -> np.ndarray:
                arm = EventLocatedArm(p, np.array([p.gear_ratio * angle, 0, 0, 0]) + change, model)
                (omega_1, omega_phi, motor, phi), _ = arm.rates(torque, 0.0)
                return np.array([p.gear_ratio * omega_1, p.gear_ratio * motor, omega_1 - omega_phi, motor - phi])

            jacobian = np.array([(rates(d, 0.0) - rates(-d, 0.0)) / 2e-6 for d in 1e-6 * np.eye(4)]).T
            by_torque = (rates(np.zeros(4), 1e-3) - rates(np.zeros(4), -1e-3)) / 2e-3
            a, b, c = state_space(p, angle, model)
            np.testing.assert_allclose(a, jacobian, rtol=1e-5, atol=1e-5)
            np.testing.assert_allclose(b[:, 0], by_torque, rtol=1e-8, atol=1e-8)
            np.testing.assert_array_equal(c, [[1, 0, 0, 0], [0, 1, 0, 0]])

    @EACH_MODEL
    def test_the_current_loop_is_a_fifth_state(self, model: str):
        params = replace(DRIVEN, current_loop_time_constant=0.0007, torque_constant_error=-0.05)
        a, b, c = state_space(params, 0.6, model)
        with_loop, by_command, both = state_space(params, 0.6, model, actuator=True)
        np.testing.assert_array_equal(with_loop[:4], np.hstack([a, b]))
        np.testing.assert_array_equal(both, np.hstack([c, np.zeros((2, 1))]))
        # The same as a lag in series with the arm.
        series = control.ss(a, b, c, np.zeros((2, 1))) * control.tf2ss(control.tf([0.95], [0.0007, 1]))
        whole = control.ss(with_loop, by_command, both, np.zeros((2, 1)))
        for frequency in (3.0, 30.0, 300.0):
            np.testing.assert_allclose(whole(1j * frequency), series(1j * frequency), rtol=1e-9)

    def test_without_a_current_loop_there_is_nothing_to_add(self):
        for lag in (0.0, 1e-300, 9e-8):
            arm = ArmParams(command_latency=0.001, current_loop_time_constant=lag)
            words = ("current_loop_time_constant", repr(lag))
            refused(ValueError, words, lambda arm=arm: state_space(arm, 0.5, actuator=True))
            at_once = sampled_state_space(replace(arm, current_loop_time_constant=0.0), 0.5)
            assert all(map(np.array_equal, sampled_state_space(arm, 0.5), at_once))

    @EACH_MODEL
    def test_effects_that_are_not_linear_or_have_no_mean_are_left_out(self, model: str):
        kept = ("current_loop_time_constant", "command_latency", "torque_constant_error", "belt_stiffening")
        a, b, _ = state_space(DRIVEN, 0.6, model)
        for other in (ArmParams(**{name: getattr(DRIVEN, name) for name in kept}), ArmParams(belt_stiffening=0.25)):
            np.testing.assert_array_equal(state_space(other, 0.6, model)[0], a)
            np.testing.assert_array_equal(state_space(other, 0.6, model)[1], b)
        # The belt has its stiffness about zero torsion. The damping comes from the mean stiffness: without it, a softer
        # arm is the same.
        stiffening = ArmParams(belt_stiffening=0.25, belt_damping_ratio=0.0)
        soft = ArmParams(belt_stiffness=0.75 * 33, belt_damping_ratio=0.0)
        np.testing.assert_array_equal(state_space(stiffening, 0.6, model)[0], state_space(soft, 0.6, model)[0])
        assert all(map(np.array_equal, *(sampled_state_space(p, 0.6) for p in (stiffening, soft))))

    def test_bounds_of_the_joint_angle(self):
        right: list[Any] = [0.0, math.pi / 2, np.float64(0.3), 1, np.int64(0)]
        for angle in right:
            stiffness = -33 * (1 / (6.3e-5 * GEAR**2) + 1 / (0.01 + 0.06 * math.sin(angle) ** 2))
            assert state_space(ArmParams(), angle)[0][3, 2] == pytest.approx(stiffness)
        wrong: list[Any] = [-0.01, 1.58, math.nan, "90", None, True]
        for angle, model_of in product(wrong, (state_space, sampled_state_space)):
            with pytest.raises((TypeError, ValueError), match=r"theta_1.*got "):
                model_of(ArmParams(), angle)


class TestSampled:
    @EACH_MODEL
    @pytest.mark.parametrize(("latency", "lag"), [(0.0, 0.0), (0.3, 2e-4), (1.5, 1e-5), (3.0, 0.01)])
    def test_is_made_of_exponentials(self, latency: float, lag: float, model: str):
        p = replace(DRIVEN, command_latency=latency * CONTROL_PERIOD, current_loop_time_constant=lag)
        a, b, c = sampled_state_space(p, 0.6, model)
        past = math.ceil(latency)
        assert a.shape == (5 + past, 5 + past) and b.shape == (5 + past, 1) and c.shape == (2, 5 + past)
        late = p.command_latency / CONTROL_PERIOD - math.floor(p.command_latency / CONTROL_PERIOD)
        commands = np.random.default_rng(0).uniform(-0.3, 0.3, 12)
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

    def test_ideal_drive_has_no_torque_of_its_own(self):
        a, b, c = sampled_state_space(ArmParams(), 0.6)
        own = control.c2d(control.ss(*state_space(ArmParams(), 0.6), np.zeros((2, 1))), CONTROL_PERIOD, "zoh")
        np.testing.assert_allclose(a[:4, :4], own.A, rtol=1e-10, atol=1e-14)
        np.testing.assert_allclose(b[:4], own.B, rtol=1e-10)
        assert not a[:, 4].any() and not a[4].any() and b[4] == 1 and c.shape == (2, 5)


def system_of(params: ArmParams, model: str = "lumped") -> control.NonlinearIOSystem:
    states = ["theta_a", "omega_a", "theta_s", "omega_s"]
    return control.nlsys(lambda t, x, u, p: state_derivative(x, u[0], params, model), inputs=["torque"], states=states)


class TestStateDerivative:
    @EACH_MODEL
    def test_linearised_it_is_the_linear_model(self, model: str):
        a, b, _ = state_space(FRICTIONLESS, 0.7, model)
        linear = system_of(FRICTIONLESS, model).linearize([0.7 * GEAR, 0, 0, 0], 0)
        np.testing.assert_allclose(linear.A, a, rtol=1e-4, atol=1e-5 * np.abs(a).max())
        np.testing.assert_allclose(linear.B, b, rtol=1e-4, atol=1e-5 * np.abs(b).max())

    def test_simulated_it_moves_as_the_environment_does(self):
        built = ArmParams(static_friction_excess=0.5, torque_ripple=0.005, kinematic_error=2e-4, belt_stiffening=0.3)
        simulation, x = ArmSimulation(built), np.array([30.0, 40.0, 0.004, -0.2])
        start: Any = x
        driven = simulation.at_rest(np.array([30.0]))
        driven[0, :4] = x
        later = simulation.advance(driven, np.array([0.05]))[0, :4]
        times: Any = np.array([0.0, CONTROL_PERIOD])
        finest: Any = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-12}
        response = control.input_output_response(system_of(built), times, 0.05, start, solve_ivp_kwargs=finest)
        np.testing.assert_allclose(response.states[:, -1], later, rtol=1e-4, atol=1e-5)

    def test_friction_holds_a_motor_at_rest_and_opposes_one_that_turns(self):
        params = ArmParams()
        resting, slack = np.zeros(4), 0.5 * params.coulomb_friction
        assert state_derivative(resting, slack, params).tolist() == [0, 0, 0, 0]
        assert state_derivative(resting, 3 * slack, params)[1] == pytest.approx(slack / params.motor_inertia)
        for speed in (-1.0, 1.0):
            braked = -speed * (params.coulomb_friction + params.motor_viscous_friction) / params.motor_inertia
            assert state_derivative([0, speed, 0, 0], 0, params)[1] == pytest.approx(braked, rel=1e-3)

    def test_refusals(self):
        words = ("model", "'lumped', 'lagrangian'", "'full'")
        refused(ValueError, ("x ", "(4,)"), lambda: state_derivative([0, 0, 0], 0, FRICTIONLESS))
        refused(ValueError, words, lambda: state_derivative(np.zeros(4), 0, FRICTIONLESS, "full"))
        refused(ValueError, ("0.005",), lambda: state_derivative(np.zeros(4), 0, ArmParams(**GIVES)))
        assert not state_derivative(np.zeros(4), 0, ArmParams(presliding_deflection=9e-7)).any(), "too little to give"
        refused(ValueError, words, lambda: state_space(DRIVEN, 0, "full"))


# The environment in its linear regime: without Coulomb friction and with constant M2 the arm is linear in any motion.
LINEAR = {"coulomb_friction": 0.0, "arm_inertia_swing": 0.0}
FOLDED = LINEAR | {"arm_inertia": 0.07}  # M2 of the nominal arm at 90 degrees
OTHER = {"gear_ratio": 60.0, "motor_inertia": 8e-5, "motor_viscous_friction": 1e-3, "belt_stiffness": 25.0}
PLANTS = {
    "stretched": LINEAR,
    "folded, undamped": FOLDED | {"belt_damping_ratio": 0.0},
    "all else changed": FOLDED | OTHER | {"arm_inertia": 0.02, "belt_damping_ratio": 0.05},
}
EACH_PLANT = pytest.mark.parametrize("params", PLANTS.values(), ids=PLANTS)


def sampled(p: ArmParams) -> Any:
    """python-control's model of x from sample to sample, from (5a) and (5b) for y = [theta_a, omega_a, phi, phi']."""
    gear, stiffness = p.gear_ratio, p.belt_stiffness
    damping = 2 * p.belt_damping_ratio * math.sqrt(stiffness * (p.arm_inertia + p.arm_inertia_swing))
    belt = np.array([stiffness / gear, damping / gear, -stiffness, -damping])  # tau_b = belt @ y
    motor = (np.array([0, -p.motor_viscous_friction, 0, 0]) - belt / gear) / p.motor_inertia
    rates = np.array([[0, 1, 0, 0], motor, [0, 0, 0, 1], belt / p.arm_inertia])
    x_of_y = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [1 / gear, 0, -1, 0], [0, 1 / gear, 0, -1]])
    a, b = x_of_y @ rates @ np.linalg.inv(x_of_y), x_of_y @ [[0], [1 / p.motor_inertia], [0], [0]]
    return control.sample_system(control.ss(a, b, np.eye(4), 0), CONTROL_PERIOD, "zoh")


def simulate(
    params: dict[str, float], start: np.ndarray, torque: Callable[[int, np.ndarray], float], substeps: int = 20
) -> tuple[np.ndarray, np.ndarray]:
    """States of the environment, shape (EPISODE_STEPS + 1, 4), and torques."""
    env = arm_env(params, start)
    env.set_integration_steps(substeps)
    states, torques = [env.state], []
    for k in range(EPISODE_STEPS):
        torques.append(torque(k, states[-1]))
        assert abs(torques[-1]) <= env.params.torque_limit, "cut at the limit: not linear"
        apply(env, torques[-1])
        states.append(env.state)
    return np.array(states), np.array(torques)


class TestLinearRegime:
    @EACH_PLANT
    def test_random_torques_back_and_forth(self, params: dict[str, float]):
        torques = np.random.default_rng(0).uniform(-0.2, 0.2, EPISODE_STEPS)
        start = at_rest(math.pi / 4, 0.03, gear=params.get("gear_ratio", GEAR))
        states, _ = simulate(params, start, lambda k, _: float(torques[k]))
        assert np.count_nonzero(np.diff(np.sign(states[:, 1]))) > 20, "reversals"
        inputs, whole = np.append(torques, 0.0), sampled(ArmParams(**params))
        response = whole.forced_response(inputs=inputs, initial_state=states[0]).outputs.T
        assert np.all(np.abs(states - response).max(axis=0) < 1e-9 * np.abs(response - states[0]).max(axis=0))

    @pytest.mark.parametrize("arm_inertia", [0.01, 0.07])
    def test_lag_and_loss_of_undamped_ringing(self, arm_inertia: float):
        # RK4's factor for a mode e^{iz} is e^{iz} (1 - i z^5 / 120 - z^6 / 144) to leading orders.
        params = LINEAR | {"motor_viscous_friction": 0.0, "belt_damping_ratio": 0.0, "arm_inertia": arm_inertia}
        states, _ = simulate(params, np.array([0.0, 0.8 * GEAR, 0.05, 0.0]), lambda k, x: 0.0, substeps=1)
        mode = math.sqrt(33 * (1 / (6.3e-5 * GEAR**2) + 1 / arm_inertia))
        z = mode * CONTROL_PERIOD
        error = (states[-1, 2] - 1j * states[-1, 3] / mode) / (0.05 * np.exp(1j * z * EPISODE_STEPS))
        assert -np.angle(error) == pytest.approx(EPISODE_STEPS * z**5 / 120, rel=0.01)
        assert 1 - abs(error) == pytest.approx(EPISODE_STEPS * z**6 / 144, rel=0.01)

    @EACH_PLANT
    def test_cost_of_linear_quadratic_regulation(self, params: dict[str, float]):
        """Of u = -(scales * K) x + noise: by completing the square, v off -K x costs 1/2 v'(R + b'P b) v."""
        q = np.diag([1 / 10, 1 / 100, 1 / 0.03, 1 / 1]) ** 2  # errors of 10 rad, 100 rad/s, 30 mrad and 1 rad/s
        r = np.array([[1 / 0.05**2]])  # are worth 50 mN m
        rest, start = at_rest(math.pi / 4, gear=params.get("gear_ratio", GEAR)), np.array([-8.0, 30.0, 0.03, -1.0])
        model = sampled(ArmParams(**params))
        gain, p, _ = control.dlqr(model.A, model.B, q, r)
        optimum = 0.5 * start @ p @ start
        for scale, noise, least in ((1.0, 0.0, 0.0), ([1.0, 0.8, 1.0, 1.2], 0.0, 1e-4), (1.0, 0.1, 0.05)):
            noises = np.random.default_rng(0).uniform(-noise, noise, EPISODE_STEPS)
            scaled = np.multiply(scale, gain[0])
            states, u = simulate(params, rest + start, lambda k, x, n=noises, g=scaled: float(n[k] - g @ (x - rest)))
            x = states - rest
            to_come = 0.5 * x[-1] @ p @ x[-1]
            cost = 0.5 * np.einsum("ki,ij,kj", x[:-1], q, x[:-1]) + 0.5 * r.item() * u @ u + to_come
            v = u + x[:-1] @ gain[0]
            price = 0.5 * (r + model.B.T @ p @ model.B).item() * v @ v
            assert cost == pytest.approx(optimum + price, rel=1e-9)
            assert least <= price / optimum < max(1e3 * least, 1e-20)
