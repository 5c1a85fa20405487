"""The arm's linear model about a joint angle, eq. (6), in continuous time and from one sample to the next."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beltarm_env.arm import ArmParams, plant_of, plant_of_params
from beltarm_env.jit import compiled
from beltarm_env.physics.models import LUMPED, MODELS, Model, inverse_inertia
from beltarm_env.physics.plant import Plant

Floats = NDArray[np.float64]

_TERMS = 9  # of the exponential's series: at 100 rad/s and 1.5 ms the next one is 0.15^10 / 10! = 2e-15


@compiled
def _fill(held: Floats, plant: Plant, cos_phi: float, model: Model) -> None:
    """Write A into rows and columns 0 to 3, b into column 4 and a torsional acceleration into column 5."""
    w11, w12, w22 = inverse_inertia(cos_phi, plant, model)
    g, v, k, d = plant.gear, plant.viscous_friction, plant.stiffness, plant.damping
    by_motor, mutual, by_belt = w11 * g * g, (w11 - w12) * g, w11 - 2 * w12 + w22
    held[0, 1] = held[2, 3] = held[3, 5] = 1.0
    held[1, 1], held[1, 2], held[1, 3], held[1, 4] = -v * by_motor, -k * mutual, -d * mutual, by_motor
    held[3, 1], held[3, 2], held[3, 3], held[3, 4] = -v * mutual, -k * by_belt, -d * by_belt, mutual


@compiled
def _exponential(matrix: Floats, scale: float) -> Floats:
    """exp(scale * matrix) by its Taylor series, for small arguments."""
    size = len(matrix)
    total, term = np.eye(size), np.eye(size)
    for order in range(1, _TERMS + 1):
        following = np.zeros((size, size))
        for i in range(size):
            for j in range(size):
                for m in range(size):
                    following[i, j] += term[i, m] * matrix[m, j] * (scale / order)
        term = following
        total += term
    return total


@compiled
def sample_models(table: Floats, angles: Floats, period: float) -> tuple[Floats, Floats, Floats]:
    """Linear models of n lumped arms from one sample to the next, at m joint angles.

    x[k+1] = A x[k] + b tau_m + e alpha with the torque tau_m [N m] and a torsional acceleration alpha [rad/s^2] held
    over `period`: blocks of the exponential of eq. (6) with the held inputs as further states.

    Args:
        table: Constants of the arms, columns as `ArmParams`, shape (n, 12).
        angles: theta_1 [rad], shape (m,).
        period: Between samples [s]; the arm's fastest rate times it has to stay below about 0.2.

    Returns:
        A, b and e of shapes (n, m, 4, 4), (n, m, 4) and (n, m, 4).
    """
    count, size = len(table), len(angles)
    a, b, e = np.empty((count, size, 4, 4)), np.empty((count, size, 4)), np.empty((count, size, 4))
    for i in range(count):
        plant = plant_of(table[i])
        for k in range(size):
            held = np.zeros((6, 6))
            _fill(held, plant, math.cos(angles[k]), LUMPED)
            stepped = _exponential(held, period)
            a[i, k], b[i, k], e[i, k] = stepped[:4, :4], stepped[:4, 4], stepped[:4, 5]
    return a, b, e


def state_space(params: ArmParams, theta_1: float, model: str = "lumped") -> tuple[Floats, Floats, Floats]:
    """Linear model A (4, 4), b (4, 1), c (2, 4) of eq. (6) at joint angle `theta_1` [rad], Coulomb friction left out.

    With W the inverse mass matrix for (theta_1, phi), and tau_b = K_s theta_s + D_s omega_s:

        domega_a/dt = W11 G^2 (tau_m - V_a1 omega_a) - (W11 - W12) G tau_b
        domega_s/dt = (W11 - W12) G (tau_m - V_a1 omega_a) - (W11 - 2 W12 + W22) tau_b

    For the lumped arm W11 = 1 / (M_a1 G^2), W12 = 0 and W22 = 1 / M2. Two differences from the print: the last entry of
    b in (6e) is printed -1/(M_a1 G), but (5a) with (6g) gives +1/(M_a1 G); and the belt's damping D_s, absent from the
    paper, appears beside K_s (zero `belt_damping_ratio` gives the paper's A).

    Args:
        params: The arm.
        theta_1: Joint angle about which the model is linear [rad].
        model: "lumped", or "lagrangian" (of which "mujoco" is another implementation).

    Raises:
        ValueError: If theta_1 lies outside 0 to pi/2, or the model is unknown.
        TypeError: If theta_1 is not a number.
    """
    if isinstance(theta_1, bool) or not isinstance(theta_1, int | float | np.integer | np.floating):
        raise TypeError(f"theta_1 must be a number [rad], got {theta_1!r}")
    if not 0 <= theta_1 <= math.pi / 2:
        raise ValueError(f"theta_1 must lie within 0 and pi/2 rad, got {theta_1!r}")
    if not isinstance(model, str) or model not in MODELS:
        raise ValueError(f"model must be one of {', '.join(map(repr, MODELS))}, got {model!r}")
    plant = plant_of_params(params)
    held = np.zeros((6, 6))
    _fill(held, plant, math.cos(theta_1), MODELS[model])
    return held[:4, :4], held[:4, 4:5], np.array([[1.0, 0, 0, 0], [0, 1, 0, 0]])
