"""The full arm's equations of motion, derived by SymPy from the positions of its parts.

Coordinates are q = (theta_1, phi). Joint 1 is the origin; link 1 points along theta_1, link 2 along theta_1 - 2 phi.
The kinetic energy comes from the velocities of the parts, and Lagrange's equations turn it into

    M(q) q'' + c(q, q') = generalised forces.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import sympy

from beltarm_env import ArmParams


class Masses(NamedTuple):
    """Inertias and lengths of the moving parts."""

    motor: float  # G^2 M_a1 [kg m^2]   motor, gear and link 1 about joint 1
    link: float  # l         [m]        of each link
    rod: float  # m_2        [kg]       link 2, uniform
    end: float  # m_h + m_p  [kg]       point at joint 3: hand and payload
    pulley: float  # J       [kg m^2]   at joint 2, turning with link 2


def masses_of(params: ArmParams) -> Masses:
    """Distribute M2(0) and its swing S: link 2 takes what a uniform rod can, the hand or the pulley the rest."""
    l, m0, s = params.link_length, params.arm_inertia, params.arm_inertia_swing  # noqa: E741
    rod = min(s / (2 * l**2), 3 * m0 / l**2)
    end = max(0.0, (s - 6 * m0) / (4 * l**2)) + params.payload_mass
    return Masses(params.gear_ratio**2 * params.motor_inertia, l, rod, end, max(0.0, m0 - s / 6))


class Equations(NamedTuple):
    """SymPy expressions and the symbols in them."""

    angles: tuple[sympy.Symbol, ...]  # theta_1, phi
    rates: tuple[sympy.Symbol, ...]
    masses: tuple[sympy.Symbol, ...]  # in the order of `Masses`
    mass_matrix: sympy.Matrix  # M
    bias: sympy.Matrix  # c: Coriolis and centrifugal terms
    kinetic_energy: Any


@cache
def derive() -> Equations:
    """Mass matrix and bias from the geometry: d/dt dT/dq' - dT/dq = M q'' + c."""
    q = theta_1, phi = sympy.symbols("theta_1 phi", real=True)
    u = sympy.symbols("omega_1 omega_phi", real=True)
    masses = motor, l, rod, end, pulley = sympy.symbols("I_1 l m_2 m_3 J", nonnegative=True)  # noqa: E741

    def rate(quantity: Any) -> Any:
        return sympy.Matrix([quantity]).T.jacobian(q) * sympy.Matrix(u)

    def squared(quantity: Any) -> Any:
        return rate(quantity).dot(rate(quantity))

    along = theta_1 - 2 * phi
    joint_2 = l * sympy.Matrix([[sympy.cos(theta_1), sympy.sin(theta_1)]])
    link_2 = l * sympy.Matrix([[sympy.cos(along), sympy.sin(along)]])
    turning = squared([along])
    translation = rod * squared(joint_2 + link_2 / 2) + end * squared(joint_2 + link_2)
    energy = (motor * u[0] ** 2 + (rod * l**2 / 12 + pulley) * turning + translation) / 2
    energy = sympy.trigsimp(sympy.expand(energy))
    momentum = sympy.Matrix([energy]).jacobian(u)
    bias = momentum.jacobian(q) * sympy.Matrix(u) - sympy.Matrix([energy]).jacobian(q).T
    return Equations(q, u, masses, sympy.simplify(momentum.jacobian(u)), sympy.simplify(bias), energy)


@cache
def compiled() -> Callable[..., list[float]]:
    """Function of angles, rates and masses that returns M_11, M_12, M_22, c_1, c_2 and the kinetic energy."""
    s = derive()
    m = s.mass_matrix
    results = [m[0, 0], m[0, 1], m[1, 1], s.bias[0], s.bias[1], s.kinetic_energy]
    return sympy.lambdify([*s.angles, *s.rates, *s.masses], results, "math", cse=True)
