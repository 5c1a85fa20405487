"""An independent solution of the arm: SciPy integration between events, in coordinates of its own.

Equations (5a), (5b) for [theta_a, omega_a, phi, omega_phi] instead of the torsion, with M2(phi) from the links' masses,
integrated by DOP853 from one instant of stopping, reversing or breaking away to the next, which `solve_ivp` locates.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from beltarm_env import ArmParams


class EventLocatedArm:
    """Reference integration of one arm from a state x = [theta_a, omega_a, theta_s, omega_s]."""

    def __init__(self, params: ArmParams, state: np.ndarray) -> None:
        self.params = params
        theta_a, omega_a, theta_s, omega_s = state
        gear = params.gear_ratio
        self.y = np.array([theta_a, omega_a, theta_a / gear - theta_s, omega_a / gear - omega_s])
        self.mode_changes: list[tuple[str, str]] = []
        self.mode = "?"

    @property
    def state(self) -> np.ndarray:
        theta_a, omega_a, phi, omega_phi = self.y
        gear = self.params.gear_ratio
        return np.array([theta_a, omega_a, theta_a / gear - phi, omega_a / gear - omega_phi])

    def _belt_torque(self, y: np.ndarray) -> float:
        p = self.params
        damping = 2 * p.belt_damping_ratio * np.sqrt(p.belt_stiffness * (p.arm_inertia + p.arm_inertia_swing))
        return p.belt_stiffness * (y[0] / p.gear_ratio - y[2]) + damping * (y[1] / p.gear_ratio - y[3])

    def _rates(self, y: np.ndarray, torque: float, friction: float | None) -> list[float]:
        """Derivatives of y; `friction` is None while the motor sticks."""
        p = self.params
        swing = p.arm_inertia_swing + (2 * p.link_length) ** 2 * p.payload_mass
        m2 = p.arm_inertia + swing * np.sin(y[2]) ** 2
        m2_slope = swing * np.sin(2 * y[2])
        belt = self._belt_torque(y)
        arm = (belt - 0.5 * m2_slope * y[3] ** 2) / m2
        if friction is None:
            return [0.0, 0.0, y[3], arm]
        motor = torque - p.motor_viscous_friction * y[1] - friction - belt / p.gear_ratio
        return [y[1], motor / p.motor_inertia, y[3], arm]

    def advance(self, torque: float, duration: float) -> None:
        """Hold a torque for `duration` seconds."""
        tau_c = self.params.coulomb_friction
        gear = self.params.gear_ratio

        def pull(y: np.ndarray) -> float:
            return torque - self._belt_torque(y) / gear

        time, broke_away = 0.0, 0
        while duration - time > 1e-15:
            if self.y[1] != 0:
                direction = int(np.sign(self.y[1]))
            elif broke_away:
                direction = broke_away
            else:
                direction = int(np.sign(pull(self.y))) if abs(pull(self.y)) > tau_c else 0
            mode = {-1: "backward", 0: "stuck", 1: "forward"}[direction]
            if mode != self.mode:
                self.mode_changes.append((self.mode, mode))
                self.mode = mode
            friction = None if direction == 0 else direction * tau_c

            def stops(t: float, y: np.ndarray, start=time, direction=direction) -> float:
                # Just broken away, the motor has no speed yet: that is not a stop.
                return y[1] if t > start or y[1] != 0 else direction * 1e-300

            def breaks_away(_: float, y: np.ndarray) -> float:
                return abs(pull(y)) - tau_c

            event: Any = breaks_away if direction == 0 else stops
            event.terminal = True
            event.direction = 1 if direction == 0 else -direction
            solution = solve_ivp(
                lambda _, y, friction=friction: self._rates(y, torque, friction),
                (time, duration),
                self.y,
                method="DOP853",
                rtol=1e-12,
                atol=1e-13,
                events=event,
            )
            self.y = solution.y[:, -1]
            time = solution.t[-1]
            broke_away = 0
            if solution.status == 1:
                self.y[1] = 0.0
                broke_away = int(np.sign(pull(self.y))) if direction == 0 else 0


def tip(params: ArmParams, state: np.ndarray) -> np.ndarray:
    """Tip position [m] from the joints' plane geometry, shape (2,): link 1, then link 2, then the hand."""
    theta_1 = state[0] / params.gear_ratio
    phi = theta_1 - state[2]
    l, hand = params.link_length, params.hand_length  # noqa: E741
    line = np.array([np.cos(state[2]), np.sin(state[2])])
    elbow = l * np.array([np.cos(theta_1), np.sin(theta_1)])
    wrist = elbow + l * np.array([np.cos(theta_1 - 2 * phi), np.sin(theta_1 - 2 * phi)])
    return wrist + hand * line
