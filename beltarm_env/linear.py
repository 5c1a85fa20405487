"""The arm's linear model about a joint angle, eq. (6)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beltarm_env.dynamics import MODELS, inverse_inertia
from beltarm_env.params import FIELDS, ArmParams, plant_of

Floats = NDArray[np.float64]


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
    plant = plant_of(np.array([getattr(params, name) for name in FIELDS]))
    w11, w12, w22 = inverse_inertia(math.cos(theta_1), plant, MODELS[model])
    g, v, k, d = plant.gear, plant.viscous_friction, plant.stiffness, plant.damping
    by_motor, mutual, by_belt = w11 * g * g, (w11 - w12) * g, w11 - 2 * w12 + w22
    a = np.array(
        [
            [0, 1, 0, 0],
            [0, -v * by_motor, -k * mutual, -d * mutual],
            [0, 0, 0, 1],
            [0, -v * mutual, -k * by_belt, -d * by_belt],
        ]
    )
    b = np.array([[0], [by_motor], [0], [mutual]])
    c = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0]])
    return a, b, c
