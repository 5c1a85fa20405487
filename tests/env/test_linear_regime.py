"""The environment against independent solutions in its linear regime.

Without Coulomb friction and with constant M2 (`arm_inertia_swing=0`) the arm is linear through any motion: what it does
is known from the matrix exponential, from python-control's responses, and from the Riccati equation of an LQR.
"""

import math
from collections.abc import Callable
from typing import Any

import control
import numpy as np
import pytest
from driven_arms import GEAR, apply
from numpy.typing import NDArray
from scipy.linalg import expm

from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS, ArmParams, BeltArmEnv

Floats = NDArray[np.float64]
Params = dict[str, float]
Feedback = Callable[[int, Floats], float]  # sample and state to torque [N m]

DEG_45, DEG_90 = math.pi / 4, math.pi / 2
FINE = 20  # integration steps per sample: the error of one step per sample, 5e-5 over an episode, over 20^4
LINEAR = {"coulomb_friction": 0.0, "arm_inertia_swing": 0.0}
FOLDED = LINEAR | {"arm_inertia": 0.07}  # M2 of the nominal arm at 90 degrees
OTHER = {"gear_ratio": 60.0, "motor_inertia": 8e-5, "motor_viscous_friction": 1e-3, "belt_stiffness": 25.0}
PLANTS = {
    "stretched": LINEAR,
    "folded, undamped": FOLDED | {"belt_damping_ratio": 0.0},
    "all else changed": FOLDED | OTHER | {"arm_inertia": 0.02, "belt_damping_ratio": 0.05},
}
each_plant = pytest.mark.parametrize("params", PLANTS.values(), ids=PLANTS)


def matrices(params: ArmParams, phi: float = 0.0) -> tuple[Floats, Floats]:
    """A and b for x, from (5a) and (5b) linearised at phi and written for y = [theta_a, omega_a, phi, phi']."""
    gear, stiffness = params.gear_ratio, params.belt_stiffness
    damping = 2 * params.belt_damping_ratio * math.sqrt(stiffness * (params.arm_inertia + params.arm_inertia_swing))
    swing = params.arm_inertia_swing + (2 * params.link_length) ** 2 * params.payload_mass
    belt = np.array([stiffness / gear, damping / gear, -stiffness, -damping])  # tau_b = belt @ y
    motor = (np.array([0, -params.motor_viscous_friction, 0, 0]) - belt / gear) / params.motor_inertia
    arm = belt / (params.arm_inertia + swing * math.sin(phi) ** 2)
    rates = np.array([[0, 1, 0, 0], motor, [0, 0, 0, 1], arm])
    x_of_y = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [1 / gear, 0, -1, 0], [0, 1 / gear, 0, -1]])
    return x_of_y @ rates @ np.linalg.inv(x_of_y), x_of_y @ [[0], [1 / params.motor_inertia], [0], [0]]


def held(a: Floats, b: Floats) -> Floats:
    """Generator of [x, u] over one control period, u held: its exponential is the exact solution."""
    return CONTROL_PERIOD * np.block([[a, b], [np.zeros((1, 5))]])


def exactly(a: Floats, b: Floats, start: Floats, torques: Floats) -> Floats:
    step = expm(held(a, b))[:4]
    states = [start]
    for torque in torques:
        states.append(step @ np.append(states[-1], torque))
    return np.array(states)


def sampled(params: Params) -> Any:
    """python-control's model of the arm from one sample to the next, a StateSpace whose output is the state."""
    a, b = matrices(ArmParams(**params))
    return control.sample_system(control.ss(a, b, np.eye(4), 0), CONTROL_PERIOD, "zoh")


def simulate(
    params: Params, start: Floats, torque: Feedback, substeps: int = FINE, steps: int = EPISODE_STEPS, **options: Any
) -> tuple[Floats, Floats]:
    """States of the environment, shape (steps + 1, 4), and torques, shape (steps,)."""
    env = BeltArmEnv()
    env.reset(seed=0, options={"params": params, "state": start, **options})
    env.set_integration_steps(substeps)
    states, torques = [env.state], []
    for k in range(steps):
        torques.append(torque(k, states[-1]))
        assert abs(torques[-1]) <= env.params.torque_limit, "cut at the limit: not linear"
        apply(env, torques[-1])
        states.append(env.state)
    return np.array(states), np.array(torques)


def replay(torques: Floats) -> Feedback:
    return lambda k, _: float(torques[k])


def at_45_degrees(params: Params, torsion: float = 0.0, torsion_speed: float = 0.0) -> Floats:
    return np.array([params.get("gear_ratio", GEAR) * DEG_45, 0.0, torsion, torsion_speed])


def peak(states: Floats) -> Floats:
    """Largest absolute value of each state."""
    return np.abs(states).max(axis=0)


class TestAgainstTheMatrixExponential:
    @each_plant
    def test_random_torques_back_and_forth(self, params: Params):
        torques = np.random.default_rng(0).uniform(-0.2, 0.2, EPISODE_STEPS)
        start = at_45_degrees(params, 0.03)
        states, _ = simulate(params, start, replay(torques))
        exact = exactly(*matrices(ArmParams(**params)), start, torques)
        assert np.count_nonzero(np.diff(np.sign(exact[:, 1]))) > 20, "reversals"
        assert np.all(peak(states - exact) < 1e-9 * peak(exact - start))

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


class TestAgainstPythonControl:
    """Eq. (11) without Coulomb friction, on the true state and with Table 2's gains, is u = r - K x."""

    def check_closed_loop(self, params: Params, start: Floats, references: Floats, **options: Any) -> None:
        """Compare a whole episode; references are angle, speed, acceleration at the joint, shape (steps, 3)."""
        arm = ArmParams(**params)
        gain = np.array([arm.motor_inertia * 25, arm.motor_inertia * 20 - arm.motor_viscous_friction, 0.0, 0.15])
        demand = arm.motor_inertia * arm.gear_ratio * references @ [25, 20, 1]
        states, _ = simulate(params, start, lambda k, x: float(demand[k] - gain @ x), **options)
        loop = sampled(params).feedback(control.ss([], [], [], gain[None], CONTROL_PERIOD))
        response = loop.forced_response(inputs=np.append(demand, 0.0), initial_state=start).outputs.T
        assert np.all(peak(states - response) < 1e-9 * peak(response - start))

    @each_plant
    def test_trapezoidal_move(self, params: Params):
        env = BeltArmEnv()
        move = {"start": 0.2, "goal": 1.3, "duration": 0.8, "ramp_time": 0.2}
        env.reset(options={"params": params, "move": move})
        references = np.array([env.reference(k * CONTROL_PERIOD) for k in range(EPISODE_STEPS)])
        self.check_closed_loop(params, env.state, references, move=move)

    # Resonance at 23.15 rad/s, anti-resonance sqrt(K_s / M2) at 21.71 rad/s: 180.9 and 192.9 samples per period.
    @pytest.mark.parametrize("period", [165, 181, 193])
    def test_sine_at_the_motor(self, period: int):
        params = FOLDED | {"belt_damping_ratio": 0.05}
        angles = 2 * math.pi * np.arange(12 * EPISODE_STEPS).reshape(12, -1) / period
        states = at_45_degrees(params)[None]
        for episode in angles:  # 21.6 s in all: transients decay by e^-26
            states, _ = simulate(params, states[-1], replay(0.03 * np.sin(episode)))
        count = EPISODE_STEPS // period * period
        phasor = 2 / count * np.exp(-1j * angles[-1, -count:]) @ states[-1 - count : -1] / -0.03j
        expected = sampled(params).frequency_response([2 * math.pi / period / CONTROL_PERIOD]).complex[:, 0, 0]
        np.testing.assert_allclose(phasor[1:], expected[1:], rtol=1e-9)


class TestAgainstTheRiccatiEquation:
    """Regulation to 45 degrees by u = -K x, with x counted from there: the cost to go from x is 1/2 x'P x."""

    Q = np.diag([1 / 10, 1 / 100, 1 / 0.03, 1 / 1]) ** 2  # errors of 10 rad, 100 rad/s, 30 mrad and 1 rad/s
    R = np.array([[1 / 0.05**2]])  # are worth 50 mN m
    START = np.array([-8.0, 30.0, 0.03, -1.0])
    NO_NOISE = np.zeros(EPISODE_STEPS)

    def check_cost(self, params: Params, start: Floats, scales: Floats, noise: Floats) -> tuple[float, float]:
        """The cost of u = -(scales * K) x + noise: by completing the square, v off -K x costs 1/2 v'(R + b'P b) v.

        Returns that price, and the cost still to come after the episode, over the optimum.
        """
        model, rest = sampled(params), at_45_degrees(params)
        gain, p, _ = control.dlqr(model.A, model.B, self.Q, self.R)
        states, u = simulate(params, rest + start, lambda k, x: float(noise[k] - scales * gain[0] @ (x - rest)))
        x = states - rest
        to_come = 0.5 * x[-1] @ p @ x[-1]
        cost = 0.5 * np.einsum("ki,ij,kj", x[:-1], self.Q, x[:-1]) + 0.5 * self.R.item() * u @ u + to_come
        optimum = 0.5 * start @ p @ start
        v = u + x[:-1] @ gain[0]
        price = 0.5 * (self.R + model.B.T @ p @ model.B).item() * v @ v
        assert cost == pytest.approx(optimum + price, rel=1e-9)
        return price / optimum, to_come / optimum

    @each_plant
    def test_cost_of_the_optimal_gain(self, params: Params):
        price, to_come = self.check_cost(params, self.START, np.ones(4), self.NO_NOISE)
        assert price < 1e-20
        assert to_come < 1e-6, "converged"

    @pytest.mark.parametrize("entry", range(4))
    def test_another_gain_costs_more(self, entry: int):
        scales = np.where(np.arange(4) == entry, 1.2, 1.0)
        price, _ = self.check_cost(LINEAR, self.START, scales, self.NO_NOISE)
        assert price > 1e-4

    def test_noise_costs_more(self):
        noise = np.random.default_rng(0).uniform(-0.1, 0.1, EPISODE_STEPS)
        assert self.check_cost(LINEAR, self.START, np.ones(4), noise)[0] > 0.1
