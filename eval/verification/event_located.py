"""Independent solution of the arm's motion: SciPy integrates between events that it locates.

In the coordinates q = (theta_1, phi), both models are

    M(q) q'' + c(q, q') = (G (tau_m - V_a1 omega_a - tau_f) - tau_b, tau_b),     tau_b = K_s theta_s + D_s omega_s

The lumped arm's M is diag(G^2 M_a1, M2(phi)) and its c is (0, 1/2 M2' phi'^2), eq. (5); the full arm's are derived by
SymPy. DOP853 leads from one instant of stopping, reversing or breaking away to the next.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from beltarm_env import ArmParams

Floats = NDArray[np.float64]
Terms = Callable[[float, float, float, float], tuple[float, float, float, float, float, float]]
"""Of theta_1, phi and their rates: M_11, M_12, M_22, c_1, c_2 and the kinetic energy."""

MODELS = ("lumped", "lagrangian")


def lumped_terms(params: ArmParams) -> Terms:
    """Mass matrix, bias and kinetic energy of the paper's arm."""
    swing = params.arm_inertia_swing + (2 * params.link_length) ** 2 * params.payload_mass
    motor = params.gear_ratio**2 * params.motor_inertia

    def terms(_: float, phi: float, omega_1: float, omega_phi: float) -> tuple[float, ...]:
        m2 = params.arm_inertia + swing * math.sin(phi) ** 2
        m2_slope = swing * math.sin(2 * phi)
        energy = 0.5 * (motor * omega_1**2 + m2 * omega_phi**2)
        return motor, 0.0, m2, 0.0, 0.5 * m2_slope * omega_phi**2, energy

    return terms  # pyright: ignore[reportReturnType]


def full_terms(params: ArmParams) -> Terms:
    """Mass matrix, bias and kinetic energy of the full arm."""
    from eval.verification.symbolic_arm import compiled, masses_of

    function, masses = compiled(), masses_of(params)
    return lambda *motion: function(*motion, *masses)  # pyright: ignore[reportReturnType]


class EventLocatedArm:
    """Reference integration of one arm.

    Args:
        params: Its constants.
        state: x = [theta_a, omega_a, theta_s, omega_s] at the beginning (rad, rad/s).
        model: "lumped" or "lagrangian".
    """

    def __init__(self, params: ArmParams, state: Floats, model: str = "lumped") -> None:
        self.params = params
        self.mode_changes: list[tuple[str, str]] = []
        self.mode = "?"
        self._terms = (lumped_terms if model == "lumped" else full_terms)(params)
        unloaded = params.arm_inertia + params.arm_inertia_swing
        self._damping = 2 * params.belt_damping_ratio * math.sqrt(params.belt_stiffness * unloaded)
        theta_a, omega_a, theta_s, omega_s = state
        theta_1, omega_1 = theta_a / params.gear_ratio, omega_a / params.gear_ratio
        self._y = np.array([theta_1, theta_1 - theta_s, omega_1, omega_1 - omega_s])

    @property
    def state(self) -> Floats:
        """X = [theta_a, omega_a, theta_s, omega_s] (rad, rad/s)."""
        theta_1, phi, omega_1, omega_phi = self._y
        gear = self.params.gear_ratio
        return np.array([gear * theta_1, gear * omega_1, theta_1 - phi, omega_1 - omega_phi])

    @property
    def angles(self) -> Floats:
        """theta_1 and phi [rad]."""
        return self._y[:2].copy()

    @property
    def energy(self) -> float:
        """Kinetic energy and the belt's potential [J]."""
        return self._terms(*self._y.tolist())[5] + 0.5 * self.params.belt_stiffness * float(self.state[2]) ** 2

    def mass_matrix(self) -> Floats:
        """M(q) [kg m^2], shape (2, 2)."""
        m11, m12, m22 = self._terms(*self._y.tolist())[:3]
        return np.array([[m11, m12], [m12, m22]])

    def holding_torque(self, torque: float) -> float:
        """Friction torque that would hold the motor at standstill, against a motor torque [N m]."""
        return self.rates(torque, None)[1]

    def advance(self, torque: float, duration: float) -> None:
        """Hold a torque [N m] for `duration` seconds."""
        time, broke_away = 0.0, 0
        while duration - time > 1e-15:
            direction = self._direction(torque, broke_away)
            mode = {-1: "backward", 0: "stuck", 1: "forward"}[direction]
            if mode != self.mode:
                self.mode_changes.append((self.mode, mode))
                self.mode = mode
            time, changed = self._advance_in_mode(torque, direction, time, duration)
            broke_away = 0
            if changed:
                self._y[2] = 0.0
                broke_away = int(np.sign(self.holding_torque(torque))) if direction == 0 else 0

    @property
    def _holds(self) -> float:
        # Beyond tau_c by rounding: else a torque of exactly tau_c would start and stop the motor for ever.
        return self.params.coulomb_friction * (1 + 1e-12)

    def _direction(self, torque: float, broke_away: int) -> int:
        if self._y[2] != 0:
            return int(np.sign(self._y[2]))
        holding = self.holding_torque(torque)
        return broke_away or (int(np.sign(holding)) if abs(holding) > self._holds else 0)

    def rates(self, torque: float, friction: float | None, y: Floats | None = None) -> tuple[list[float], float]:
        """Derivatives of y = (q, q'), by default the arm's own, and the friction torque [N m].

        `friction` is None while the motor sticks. A stuck motor has theta_1'' = 0, so phi'' follows from the second
        equation alone and the first one says what holds the motor: G tau_f = G tau_m - tau_b - M_12 phi'' - c_1.
        """
        p, (theta_1, phi, omega_1, omega_phi) = self.params, (self._y if y is None else y).tolist()
        m11, m12, m22, c1, c2, _ = self._terms(theta_1, phi, omega_1, omega_phi)
        belt = p.belt_stiffness * (theta_1 - phi) + self._damping * (omega_1 - omega_phi)
        if friction is None:
            arm = (belt - c2) / m22
            return [0.0, omega_phi, 0.0, arm], torque - (belt + m12 * arm + c1) / p.gear_ratio
        viscous = p.motor_viscous_friction * p.gear_ratio * omega_1
        f1, f2 = p.gear_ratio * (torque - viscous - friction) - belt - c1, belt - c2
        determinant = m11 * m22 - m12 * m12
        motor, arm = (m22 * f1 - m12 * f2) / determinant, (m11 * f2 - m12 * f1) / determinant
        return [omega_1, omega_phi, motor, arm], friction

    def _advance_in_mode(self, torque: float, direction: int, start: float, end: float) -> tuple[float, bool]:
        """Integrate until the mode changes, or to the end; return the time reached, and whether the mode changed."""

        def stops(t: float, y: Floats) -> float:
            # Just broken away, the motor has no speed yet: that is not a stop.
            return y[2] if t > start or y[2] != 0 else direction * 1e-300

        def breaks_away(_: float, y: Floats) -> float:
            return abs(self.rates(torque, None, y)[1]) - self._holds

        event: Any = breaks_away if direction == 0 else stops
        event.terminal = True
        event.direction = 1 if direction == 0 else -direction
        friction = None if direction == 0 else direction * self.params.coulomb_friction
        solution = solve_ivp(
            lambda _, y: self.rates(torque, friction, y)[0],
            (start, end),
            self._y,
            method="DOP853",
            rtol=1e-12,
            atol=1e-13,
            events=event,
        )
        self._y = solution.y[:, -1]
        return float(solution.t[-1]), solution.status == 1


def tip(params: ArmParams, state: Floats) -> Floats:
    """Tip position [m] from the joints' plane geometry, shape (2,): link 1, then link 2, then the hand."""
    theta_1 = state[0] / params.gear_ratio
    phi = theta_1 - state[2]
    l, hand = params.link_length, params.hand_length  # noqa: E741
    line = np.array([np.cos(state[2]), np.sin(state[2])])
    elbow = l * np.array([np.cos(theta_1), np.sin(theta_1)])
    wrist = elbow + l * np.array([np.cos(theta_1 - 2 * phi), np.sin(theta_1 - 2 * phi)])
    return wrist + hand * line
