"""The real drive, for the event-located solution: each effect as a function, and the commands on their way.

Written from the equations, apart from `beltarm_env.physics`, which it checks. Angles and speeds are the motor's.
"""

import math
from collections.abc import Callable, Iterator

from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS, ArmParams

SHORTEST = 1e-15
"""Pieces of time that are skipped: rounding of the latency's share of a sample [s]."""


def kinematic_error(params: ArmParams, angle: float) -> tuple[float, float, float]:
    """Error of joint 1, eps = e sin(2 theta_a + phi_e) [rad], and its first and second derivative by theta_a."""
    e, phase = params.kinematic_error, 2 * angle + params.kinematic_error_phase
    return e * math.sin(phase), 2 * e * math.cos(phase), -4 * e * math.sin(phase)


def ripple(params: ArmParams, angle: float) -> float:
    """Torque c sin(n theta_a + phi_c) that the motor adds by itself [N m]."""
    return params.torque_ripple * math.sin(params.torque_ripple_order * angle + params.torque_ripple_phase)


def ripple_energy(params: ArmParams, angle: float) -> float:
    """Potential c / n cos(n theta_a + phi_c) of the ripple [J]: minus its derivative is the torque."""
    order = params.torque_ripple_order
    return params.torque_ripple / order * math.cos(order * angle + params.torque_ripple_phase)


def belt_spring(params: ArmParams, torsion: float) -> float:
    """Torque K_s (1 - b + 2 b th^2 / (th^2 + th_0^2)) th of the belt without its damping [N m]."""
    b, square = params.belt_stiffening, torsion * torsion
    return params.belt_stiffness * (1 - b + 2 * b * square / (square + params.belt_stiffening_torsion**2)) * torsion


def belt_energy(params: ArmParams, torsion: float) -> float:
    """Integral of `belt_spring` from 0, K_s ((1 + b) th^2 / 2 - b th_0^2 ln(1 + th^2 / th_0^2)) [J]."""
    b, square = params.belt_stiffening, torsion * torsion
    mean = params.belt_stiffening_torsion**2
    return params.belt_stiffness * (0.5 * (1 + b) * square - b * mean * math.log1p(square / mean))


def drifted(params: ArmParams, sample: int) -> float:
    """Friction over that at the episode's start, in the middle of a sample that begins `sample` periods after it."""
    return 1 + params.friction_drift * (sample + 0.5) / EPISODE_STEPS


def friction_level(params: ArmParams, angle: float) -> float:
    """Coulomb friction tau_c (1 + r sin(2 theta_a + phi_r)) at an angle, without drift [N m]."""
    phase = 2 * angle + params.friction_variation_phase
    return params.coulomb_friction * (1 + params.friction_variation * math.sin(phase))


def stribeck(params: ArmParams, speed: float) -> float:
    """Dry friction of a sliding motor over Coulomb friction, 1 + s / (1 + (omega_a / omega_s)^2); 1 + s at rest."""
    return 1 + params.static_friction_excess / (1 + (speed / params.stribeck_speed) ** 2)


def presliding(params: ArmParams) -> tuple[float, float]:
    """Stiffness [N m/rad] and damping [N m s/rad] of a motor that gives before it slips: half of critical damping."""
    stiffness = params.coulomb_friction / params.presliding_deflection
    return stiffness, math.sqrt(stiffness * params.motor_inertia)


class Actuator:
    """Commands on their way to the motor, and its torque.

    A command that is given at a sample acts T_c = (m + f) T later, so within a sample the target of the current loop is
    (1 + k) times the command of m + 1 samples ago, and from f T on of m samples ago. The loop follows by
    T_i dtau/dt = target - tau.
    """

    def __init__(self, params: ArmParams) -> None:
        self.torque = 0.0
        """tau [N m] at the end of the last piece."""
        self._lag = params.current_loop_time_constant
        self._gain = 1 + params.torque_constant_error
        late = params.command_latency / CONTROL_PERIOD
        whole = math.floor(late)
        self._split = (late - whole) * CONTROL_PERIOD
        self._commands = [0.0] * (whole + 2)  # of m + 1 samples ago to this one

    def pieces(self, command: float) -> Iterator[tuple[float, Callable[[float], float]]]:
        """Yield the pieces of a sample with a new command [N m]: duration [s], and tau as a function of time in it."""
        self._commands = [*self._commands[1:], command]
        for duration, demand in zip((self._split, CONTROL_PERIOD - self._split), self._commands[:2], strict=True):
            if duration > SHORTEST:
                torque = self._towards(self._gain * demand)
                yield duration, torque
                self.torque = torque(duration)

    def _towards(self, target: float) -> Callable[[float], float]:
        if self._lag == 0:
            return lambda _: target
        behind, lag = self.torque - target, self._lag
        return lambda time: target + behind * math.exp(-time / lag)
