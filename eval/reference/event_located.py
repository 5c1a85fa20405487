"""Independent solution of the arm's motion: SciPy integrates between events that are located.

With theta_1 = theta_a / G + eps(theta_a), the kinetic energy of the links in the coordinates (theta_1, phi) gives

    M_11 theta_1'' + M_12 phi'' + c_1 = Lambda - tau_b,     M_12 theta_1'' + M_22 phi'' + c_2 = tau_b

where Lambda is what the harmonic drive turns link 1 with. The lumped arm has M_22 = M2(phi), c_2 = 1/2 M2' phi'^2 and
nothing else, eq. (5b); the full arm's terms are derived by SymPy. The state integrated is alpha = theta_a / G and phi
with their rates. With h = dtheta_1/dalpha the same energy gives, beside the motor's,

    (G^2 M_a1 + h^2 M_11) alpha'' + h M_12 phi'' + h (c_1 + M_11 h' alpha'^2)
        = G (tau + tau_r - V_a1 omega_a - tau_f) - h tau_b
    h M_12 alpha'' + M_22 phi'' + c_2 + M_12 h' alpha'^2 = tau_b

DOP853 leads from one instant of stopping, reversing or breaking away to the next.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import DOP853
from scipy.optimize import brentq, minimize_scalar

from beltarm_env import ArmParams
from beltarm_env.arrays import Floats
from eval.reference.drive import (
    SHORTEST,
    Actuator,
    belt_energy,
    belt_spring,
    drifted,
    friction_level,
    kinematic_error,
    presliding,
    ripple,
    ripple_energy,
    stribeck,
)

Terms = Callable[[float, float, float, float], tuple[float, float, float, float, float, float]]
"""Of theta_1, phi and their rates: M_11, M_12, M_22, c_1, c_2 and the kinetic energy."""

Torque = Callable[[float], float]
"""Of the time since the beginning of a piece [s]: tau [N m]."""

MODELS = ("lumped", "lagrangian")


def lumped_terms(params: ArmParams) -> Terms:
    """Mass matrix, bias and kinetic energy of what the paper's belt drives."""
    swing = params.arm_inertia_swing + (2 * params.link_length) ** 2 * params.payload_mass

    def terms(_: float, phi: float, __: float, omega_phi: float) -> tuple[float, ...]:
        m2 = params.arm_inertia + swing * math.sin(phi) ** 2
        m2_slope = swing * math.sin(2 * phi)
        return 0.0, 0.0, m2, 0.0, 0.5 * m2_slope * omega_phi**2, 0.5 * m2 * omega_phi**2

    return terms  # pyright: ignore[reportReturnType]


def full_terms(params: ArmParams) -> Terms:
    """Mass matrix, bias and kinetic energy of the full arm's links."""
    from eval.reference.symbolic_arm import compiled, masses_of

    function, masses = compiled(), masses_of(params)._replace(motor=0.0)
    return lambda *motion: function(*motion, *masses)  # pyright: ignore[reportReturnType]


class Equations(NamedTuple):
    """Terms of the equations of motion in alpha and phi at one instant."""

    m11: float
    m12: float
    m22: float
    c1: float
    c2: float
    belt: float  # tau_b [N m]
    slope: float  # h = dtheta_1/dalpha


class EventLocatedArm:
    """Reference integration of one arm.

    `advance` holds the torque of the motor itself; `sample` gives the drive a command.

    Args:
        params: Its constants.
        state: x = [theta_a, omega_a, theta_s, omega_s] at the beginning (rad, rad/s).
        model: "lumped" or "lagrangian".
    """

    def __init__(self, params: ArmParams, state: Floats, model: str = "lumped") -> None:
        self.params = params
        self.mode_changes: list[tuple[str, str]] = []
        self.mode = "?"
        self.samples = 0
        self._terms = (lumped_terms if model == "lumped" else full_terms)(params)
        self._motor = params.gear_ratio**2 * params.motor_inertia
        unloaded = params.arm_inertia + params.arm_inertia_swing
        self._damping = 2 * params.belt_damping_ratio * math.sqrt(params.belt_stiffness * unloaded)
        self._actuator = Actuator(params)
        self._drifted = 1.0  # friction over that at the episode's start
        self._gives = params.presliding_deflection > 0 and params.coulomb_friction > 0
        self._sliding = int(np.sign(state[1])) if self._gives else 0  # of a motor that gives before it slips
        self._unloaded = float(state[0])  # angle at which its spring has no torque [rad]
        theta_a, omega_a, theta_s, omega_s = state
        alpha, alpha_rate = theta_a / params.gear_ratio, omega_a / params.gear_ratio
        self._y = np.array([alpha, alpha - theta_s, alpha_rate, alpha_rate - omega_s])

    @property
    def state(self) -> Floats:
        """X = [theta_a, omega_a, theta_s, omega_s] (rad, rad/s)."""
        alpha, phi, alpha_rate, omega_phi = self._y
        gear = self.params.gear_ratio
        return np.array([gear * alpha, gear * alpha_rate, alpha - phi, alpha_rate - omega_phi])

    @property
    def angles(self) -> Floats:
        """theta_1 and phi [rad]."""
        alpha, phi = self._y[:2].tolist()
        return np.array([alpha + kinematic_error(self.params, self.params.gear_ratio * alpha)[0], phi])

    @property
    def motor_torque(self) -> float:
        """Tau [N m] that the commands given to `sample` have led to."""
        return self._actuator.torque

    @property
    def energy(self) -> float:
        """Kinetic energy, and the potential of belt and ripple [J]."""
        p, (alpha, phi, alpha_rate, omega_phi) = self.params, self._y.tolist()
        angle = p.gear_ratio * alpha
        error, error_slope, _ = kinematic_error(p, angle)
        omega_1 = alpha_rate * (1 + p.gear_ratio * error_slope)
        links = self._terms(alpha + error, phi, omega_1, omega_phi)[5]
        kinetic = 0.5 * self._motor * alpha_rate**2 + links
        return kinetic + belt_energy(p, alpha + error - phi) + ripple_energy(p, angle) + self.spring_energy

    @property
    def spring_energy(self) -> float:
        """Energy in the spring of a motor that gives before it slips [J]; as full as can be while it slides."""
        if not self._gives:
            return 0.0
        spring, _ = presliding(self.params)
        load = self._drifted * self._breakaway(self._y) if self._sliding else self.spring_torque(self._y)[0]
        return load * load / (2 * spring)

    def mass_matrix(self) -> Floats:
        """Of alpha and phi [kg m^2], shape (2, 2)."""
        e = self.equations(self._y)
        return np.array([[e.m11, e.m12], [e.m12, e.m22]])

    def equations(self, y: Floats) -> Equations:
        """Terms of the equations of motion at y = (alpha, phi, alpha', phi')."""
        p, (alpha, phi, alpha_rate, omega_phi) = self.params, y.tolist()
        error, error_slope, error_curvature = kinematic_error(p, p.gear_ratio * alpha)
        slope, bend = 1 + p.gear_ratio * error_slope, p.gear_ratio**2 * error_curvature * alpha_rate**2
        omega_1 = slope * alpha_rate
        m11, m12, m22, c1, c2, _ = self._terms(alpha + error, phi, omega_1, omega_phi)
        belt = belt_spring(p, alpha + error - phi) + self._damping * (omega_1 - omega_phi)
        motor = self._motor + slope * slope * m11
        return Equations(motor, slope * m12, m22, slope * (c1 + m11 * bend), c2 + m12 * bend, belt, slope)

    def holding_torque(self, torque: float) -> float:
        """Friction torque that would hold the motor at standstill, against a motor torque [N m]."""
        return self.rates(torque, None)[1]

    def rates(self, torque: float, friction: float | None, y: Floats | None = None) -> tuple[list[float], float]:
        """Derivatives of y = (alpha, phi, alpha', phi'), by default the arm's own, and the friction torque [N m].

        `friction` is None while the motor sticks. A stuck motor has alpha'' = 0, so phi'' follows from the second
        equation alone and the first one says what holds the motor:
        G tau_f = G (tau + tau_r) - h tau_b - M_12 phi'' - c_1.
        """
        p, y = self.params, self._y if y is None else y
        e = self.equations(y)
        alpha, _, alpha_rate, omega_phi = y.tolist()
        torque += ripple(p, p.gear_ratio * alpha)
        if friction is None:
            arm = (e.belt - e.c2) / e.m22
            return [0.0, omega_phi, 0.0, arm], torque - (e.slope * e.belt + e.m12 * arm + e.c1) / p.gear_ratio
        viscous = self._drifted * p.motor_viscous_friction * p.gear_ratio * alpha_rate
        f1, f2 = p.gear_ratio * (torque - viscous - friction) - e.slope * e.belt - e.c1, e.belt - e.c2
        determinant = e.m11 * e.m22 - e.m12 * e.m12
        motor, arm = (e.m22 * f1 - e.m12 * f2) / determinant, (e.m11 * f2 - e.m12 * f1) / determinant
        return [alpha_rate, omega_phi, motor, arm], friction

    def _breakaway(self, y: Floats) -> float:
        return friction_level(self.params, self.params.gear_ratio * y[0]) * stribeck(self.params, 0.0)

    def dry_friction(self, y: Floats) -> float:
        """Torque against which the motor slides, or up to which it is held at standstill [N m]."""
        p, angle, speed = self.params, self.params.gear_ratio * y[0], self.params.gear_ratio * y[2]
        return self._drifted * friction_level(p, angle) * stribeck(p, speed)

    def spring_torque(self, y: Floats) -> tuple[float, float]:
        """Torque of the spring on which a stuck motor hangs, and of its damper [N m]."""
        spring, damper = presliding(self.params)
        gear = self.params.gear_ratio
        return spring * (gear * y[0] - self._unloaded), damper * gear * y[2]

    def sample(self, command: float) -> None:
        """Let a control period pass after a new command [N m], through latency and current loop."""
        self._drifted = drifted(self.params, self.samples)
        for duration, torque in self._actuator.pieces(command):
            self._pass(torque, duration)
        self.samples += 1

    def advance(self, torque: float, duration: float) -> None:
        """Hold a torque of the motor [N m] for `duration` seconds."""
        self._pass(lambda _: torque, duration)

    def _pass(self, torque: Torque, duration: float) -> None:
        time, broke_away = 0.0, 0
        while duration - time > SHORTEST:
            direction = self._direction(torque(time), broke_away)
            mode = {-1: "backward", 0: "stuck", 1: "forward"}[direction]
            if mode != self.mode:
                self.mode_changes.append((self.mode, mode))
                self.mode = mode
            time, changed = self._pass_in_mode(torque, direction, time, duration)
            broke_away = 0
            if changed and self._gives:
                self._turn(direction)
            elif changed:
                self._y[2] = 0.0
                broke_away = int(np.sign(self.holding_torque(torque(time)))) if direction == 0 else 0

    def _turn(self, direction: int) -> None:
        """Begin to slide, or to hang on the spring where it had slipped."""
        if direction:
            self._y[2], self._sliding = 0.0, 0
            spring, _ = presliding(self.params)
            self._unloaded = self.params.gear_ratio * self._y[0] - direction * self.dry_friction(self._y) / spring
        else:
            self._sliding = int(np.sign(self.spring_torque(self._y)[0]))

    def _holds(self, y: Floats) -> float:
        # Beyond friction by rounding: else a torque of exactly that would start and stop the motor for ever.
        return self.dry_friction(y) * (1 + 1e-12)

    def _direction(self, torque: float, broke_away: int) -> int:
        if self._gives:
            return self._sliding
        if self._y[2] != 0:
            return int(np.sign(self._y[2]))
        holding = self.holding_torque(torque)
        if self.params.coulomb_friction == 0:
            return int(np.sign(holding)) or 1  # no mode changes anything
        return broke_away or (int(np.sign(holding)) if abs(holding) > self._holds(self._y) else 0)

    def _pass_in_mode(self, torque: Torque, direction: int, start: float, end: float) -> tuple[float, bool]:
        """Integrate until the mode changes, or to the end; return the time reached, and whether the mode changed."""

        def rates(t: float, y: Floats) -> list[float]:
            stuck = sum(self.spring_torque(y)) if self._gives else None
            return self.rates(torque(t), direction * self.dry_friction(y) if direction else stuck, y)[0]

        def until_stop(_: float, y: Floats) -> float:
            return direction * y[2]

        def until_breaking_away(t: float, y: Floats) -> float:
            if self._gives:  # the speed does not count: friction at rest
                return self._drifted * self._breakaway(y) - abs(self.spring_torque(y)[0])
            return self._holds(y) - abs(self.rates(torque(t), None, y)[1])

        margin = until_stop if direction else until_breaking_away
        without = self.params.coulomb_friction == 0
        time, self._y, changed = integrate_until(rates, None if without else margin, start, end, self._y)
        return time, changed


def tip(params: ArmParams, state: Floats) -> Floats:
    """Tip position [m] from the joints' plane geometry, shape (2,): link 1, then link 2, then the hand."""
    alpha = state[0] / params.gear_ratio
    phi = alpha - state[2]
    theta_1 = alpha + kinematic_error(params, state[0])[0]
    l, hand = params.link_length, params.hand_length  # noqa: E741
    line = np.array([np.cos(theta_1 - phi), np.sin(theta_1 - phi)])
    elbow = l * np.array([np.cos(theta_1), np.sin(theta_1)])
    wrist = elbow + l * np.array([np.cos(theta_1 - 2 * phi), np.sin(theta_1 - 2 * phi)])
    return wrist + hand * line


# Integration until a margin is used up

_LOOKS = 8
"""Times at which the margin is looked at within each step of the integrator."""


def integrate_until(
    rates: Callable[[float, Floats], list[float]],
    margin: Callable[[float, Floats], float] | None,
    start: float,
    end: float,
    y: Floats,
) -> tuple[float, Floats, bool]:
    """Integrate y' = rates(t, y) until margin(t, y) falls below zero, or to the end; return t, y, and whether it fell.

    Raises:
        ArithmeticError: If the integrator gives up.
    """
    solver = DOP853(rates, start, y, end, rtol=1e-12, atol=1e-13)  # pyright: ignore
    while solver.status == "running":
        message = solver.step()
        if solver.status == "failed":
            raise ArithmeticError(f"DOP853 at {solver.t} s: {message}")
        if margin is None:
            continue
        path: Any = solver.dense_output()
        left = lambda t, path=path: margin(t, path(t))  # noqa: E731
        times = np.linspace(float(solver.t_old), solver.t, _LOOKS + 1)  # pyright: ignore
        values = [margin(t, y) for t, y in zip(times.tolist(), path(times).T, strict=True)]
        crossing = first_crossing(left, times, values)
        if crossing is not None:
            return crossing, path(crossing), True
    return end, solver.y, False


def first_crossing(function: Callable[[float], float], times: Floats, values: list[float]) -> float | None:
    """Locate the first time at which a function, of some values at some times, falls below zero; None if it does not.

    Between the times it may also dip below zero and come back: wherever it comes so close to zero that a parabola
    through three neighbours could, its minimum is looked for.

    A function that begins at zero may rise from there. If it is below zero already at the next time, that time is
    returned: it rose less than can be seen.
    """
    last = len(values) - 1
    for k in range(last + 1):
        before, after = max(k - 1, 0), min(k + 1, last)
        if k > 0 and values[k] < 0:
            return _root(function, times[k - 1], times[k]) if values[k - 1] > 0 else float(times[k])
        middle = min(max(k, 1), last - 1)
        bend = abs(values[middle - 1] - 2 * values[middle] + values[middle + 1])
        if 0 < values[k] <= min(values[before], values[after]) and values[k] < bend:
            dip: Any = minimize_scalar(
                function, bounds=(times[before], times[after]), method="bounded", options={"xatol": 1e-13}
            )
            if dip.fun < 0:
                return _root(function, times[before], dip.x) if values[before] > 0 else float(dip.x)
    return None


def _root(function: Callable[[float], float], low: float, high: float) -> float:
    return float(brentq(function, low, high, xtol=1e-18, rtol=1e-15))  # pyright: ignore
