"""The arm's linear model about a joint angle, eq. (6), in continuous time and from one sample to the next."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beltarm_env.arm import ArmParams, Plant
from beltarm_env.engine import compiled
from beltarm_env.physics.lumped import carried_inertia
from beltarm_env.physics.models import LUMPED, Model, inverse_inertia, model_of, torsional_mobility
from beltarm_env.physics.trigonometry import sine_cosine
from beltarm_env.timing import SHORTEST_LAG

Floats = NDArray[np.float64]

_SIZE = 6  # four states, and two inputs that are held
_TERMS = 9  # of the exponential's series: at 100 rad/s and 1.5 ms the next one is 0.15^10 / 10! = 2e-15


@compiled
def _fill(held: Floats, plant: Plant, stiffness: float, cos_phi: float, model: Model) -> None:
    """Write A into rows and columns 0 to 3, b into column 4, and accelerations by a torque at phi into column 5.

    The torque is -M2 times 1 rad/s^2. So the lumped arm's motor and torsion accelerate by 0 and 1 rad/s^2, exactly.
    """
    w11, w12, w22 = inverse_inertia(cos_phi, plant, model)
    g, v, k, d = plant.gear, plant.viscous_friction, stiffness, plant.damping
    by_motor, mutual, by_belt = w11 * g * g, (w11 - w12) * g, torsional_mobility(w11, w12, w22)
    held[0, 1] = held[2, 3] = 1.0
    if model is LUMPED:
        held[3, 5] = 1.0
    else:
        m2 = carried_inertia(cos_phi, plant)
        held[1, 5], held[3, 5] = -g * w12 * m2, (w22 - w12) * m2
    held[1, 1], held[1, 2], held[1, 3], held[1, 4] = -v * by_motor, -k * mutual, -d * mutual, by_motor
    held[3, 1], held[3, 2], held[3, 3], held[3, 4] = -v * mutual, -k * by_belt, -d * by_belt, mutual


@compiled
def write_exponential(matrix: Floats, scale: float, result: Floats) -> None:
    """Write the first m rows of exp(scale * matrix) by its Taylor series, for small arguments.

    Args:
        matrix: Shape (6, 6).
        scale: Of the matrix.
        result: Shape (m, 6), written.
    """
    term, following = np.empty(_SIZE), np.empty(_SIZE)
    for i in range(result.shape[0]):
        for j in range(_SIZE):
            term[j] = 1.0 if j == i else 0.0
            result[i, j] = term[j]
        for order in range(1, _TERMS + 1):
            for j in range(_SIZE):
                following[j] = 0.0
                for m in range(_SIZE):
                    following[j] += term[m] * matrix[m, j] * (scale / order)
            for j in range(_SIZE):
                term[j] = following[j]
                result[i, j] += term[j]


def exponential(matrix: Floats, scale: float) -> Floats:
    """Compute exp(scale * matrix) of a matrix of shape (6, 6), for small arguments."""
    result = np.empty((_SIZE, _SIZE))
    write_exponential(matrix, scale, result)
    return result


@compiled
def write_sampled_models(
    plant: Plant, angles: Floats, period: float, tables: tuple[Floats, Floats, Floats], model: Model
) -> None:
    """Write the linear models of one arm behind an ideal drive from one sample to the next, at m joint angles.

    x[k+1] = A x[k] + b tau_m + e alpha with the torque tau_m [N m] and a torsional acceleration alpha [rad/s^2] held
    over `period`: blocks of the exponential of eq. (6) with the held inputs as further states.

    Args:
        plant: Coefficients of the arm.
        angles: theta_1 [rad], shape (m,).
        period: Between samples [s]; the arm's fastest rate times it has to stay below about 0.2.
        tables: A, shape (m, 4, 4), b and e, each of shape (m, 4); written.
        model: Whose equations of motion. On the full arm, alpha stands for a torque of -M2 alpha at phi.
    """
    held, stepped = np.zeros((_SIZE, _SIZE)), np.empty((4, _SIZE))
    transition, by_torque, by_acceleration = tables
    for k in range(angles.shape[0]):
        _, cosine = sine_cosine(angles[k])
        _fill(held, plant, plant.stiffness, cosine, model)
        write_exponential(held, period, stepped)
        for i in range(4):
            for j in range(4):
                transition[k, i, j] = stepped[i, j]
            by_torque[k, i], by_acceleration[k, i] = stepped[i, 4], stepped[i, 5]


def state_space(
    params: ArmParams, theta_1: float, model: str = "lumped", actuator: bool = False
) -> tuple[Floats, Floats, Floats]:
    """Compute the linear model A (4, 4), b (4, 1), c (2, 4) of eq. (6) at a joint angle.

    With W the inverse mass matrix for (theta_1, phi), and tau_b = K_s (1 - b) theta_s + D_s omega_s:

        domega_a/dt = W11 G^2 (tau - V_a1 omega_a) - (W11 - W12) G tau_b
        domega_s/dt = (W11 - W12) G (tau - V_a1 omega_a) - (W11 - 2 W12 + W22) tau_b

    For the lumped arm W11 = 1 / (M_a1 G^2), W12 = 0 and W22 = 1 / M2. Two differences from the print: the last entry of
    b in (6e) is printed -1/(M_a1 G), but (5a) with (6g) gives +1/(M_a1 G); and the belt's damping D_s, absent from the
    paper, appears beside K_s (zero `belt_damping_ratio` gives the paper's A).

    The belt has its stiffness about zero torsion. Dry friction is left out with all that it depends on; so are ripple
    and kinematic error, whose mean over a turn of the motor is zero, and the drift of friction.

    With `actuator`, the input is the command u in place of the torque tau, which is a fifth state:
    dtau/dt = ((1 + k) u - tau) / T_i, and A is (5, 5), b (5, 1), c (2, 5). The latency, a pure delay in front of this
    model, is left out: `sampled_state_space` has it.

    Args:
        params: The arm.
        theta_1: Joint angle about which the model is linear [rad].
        model: "lumped", or "lagrangian" (of which "mujoco" is another implementation).
        actuator: Whether the current loop is part of the model.

    Raises:
        ValueError: If theta_1 lies outside 0 to pi/2, the model is unknown, or there is no current loop to be a part.
        TypeError: If theta_1 is not a number.
    """
    if isinstance(theta_1, bool) or not isinstance(theta_1, int | float | np.integer | np.floating):
        raise TypeError(f"theta_1 must be a number [rad], got {theta_1!r}")
    if not 0 <= theta_1 <= math.pi / 2:
        raise ValueError(f"theta_1 must lie within 0 and pi/2 rad, got {theta_1!r}")
    equations = model_of(model)
    if actuator and params.current_loop_time_constant < SHORTEST_LAG:
        raise ValueError(
            f"actuator=True needs a current_loop_time_constant of at least {SHORTEST_LAG:g} s, got "
            f"{params.current_loop_time_constant!r}: the torque is the command times 1 + k, use actuator=False or "
            "sampled_state_space"
        )
    held = np.zeros((_SIZE, _SIZE))
    _fill(held, params.plant(), params.belt_stiffness * (1 - params.belt_stiffening), math.cos(theta_1), equations)
    if not actuator:
        return held[:4, :4], held[:4, 4:5], np.array([[1.0, 0, 0, 0], [0, 1, 0, 0]])
    rate = 1 / params.current_loop_time_constant
    a, b = held[:5, :5].copy(), np.zeros((5, 1))
    a[4], b[4] = [0, 0, 0, 0, -rate], (1 + params.torque_constant_error) * rate
    return a, b, np.eye(2, 5)
