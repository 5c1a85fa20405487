"""Integration of the arm: RK4 steps that end exactly where the motor stops or breaks away.

Within one friction mode the arm is smooth and slow against the 1.5 ms sample, so a single RK4 step per sample is
already accurate; what costs accuracy is stepping across the instant of sticking or breaking away. The step is therefore
taken in full first, `mode_margin` tells whether the mode survived it, and only if not does `mode_change` locate the
instant, where the sample is split.
"""

from __future__ import annotations

from beltarm_env.arm import Plant
from beltarm_env.engine import inlined
from beltarm_env.physics import friction
from beltarm_env.physics.drive import angles_of
from beltarm_env.physics.models import Model, accelerations, driving_torque, driving_torque_rate
from beltarm_env.physics.state import ArmState

_ROOT_ITERATIONS = 5  # of Newton on a cubic that is nearly a straight line


@inlined
def moved(x: ArmState, dt: float, slope: ArmState) -> ArmState:
    """Return a state `dt` seconds on along a slope."""
    return ArmState(
        x.motor_angle + dt * slope.motor_angle,
        x.motor_speed + dt * slope.motor_speed,
        x.torsion + dt * slope.torsion,
        x.torsion_speed + dt * slope.torsion_speed,
    )


@inlined
def slope_of(x: ArmState, torque: float, direction: float, plant: Plant, model: Model) -> ArmState:
    """Return dx/dt within a friction mode: speeds [rad/s] and accelerations [rad/s^2]."""
    motor, torsional = accelerations(x, torque, direction, plant, model)
    return ArmState(x.motor_speed, motor, x.torsion_speed, torsional)


@inlined
def weighted(k1: ArmState, k2: ArmState, k3: ArmState, k4: ArmState) -> ArmState:
    """Return six times the mean slope of a Runge-Kutta step from its four slopes."""
    return ArmState(
        k1.motor_angle + 2 * (k2.motor_angle + k3.motor_angle) + k4.motor_angle,
        k1.motor_speed + 2 * (k2.motor_speed + k3.motor_speed) + k4.motor_speed,
        k1.torsion + 2 * (k2.torsion + k3.torsion) + k4.torsion,
        k1.torsion_speed + 2 * (k2.torsion_speed + k3.torsion_speed) + k4.torsion_speed,
    )


@inlined
def mode_margin(x: ArmState, torque: float, direction: float, plant: Plant, model: Model) -> float:
    """Return how far the state is inside its friction mode: negative once the mode has been left."""
    most = friction.breakaway_torque(angles_of(x, plant, None), plant, None)
    return friction.mode_margin(x.motor_speed, driving_torque(x, torque, plant, model), direction, most)


@inlined
def _exit_margin(x: ArmState, torque: float, direction: float, exit_side: float, plant: Plant, model: Model) -> float:
    most = friction.breakaway_torque(angles_of(x, plant, None), plant, None)
    pull = driving_torque(x, torque, plant, model)
    return friction.exit_margin(x.motor_speed, pull, direction, exit_side, most)


@inlined
def _exit_rate(x: ArmState, torque: float, direction: float, exit_side: float, plant: Plant, model: Model) -> float:
    motor, torsional = accelerations(x, torque, direction, plant, model)
    return friction.exit_margin_rate(motor, driving_torque_rate(x, torsional, plant, model), direction, exit_side)


@inlined
def hermite_root(start: float, start_slope: float, end: float, end_slope: float) -> float:
    """Find where on (0, 1) the cubic through both ends turns from positive to negative: bracketed Newton iteration.

    The number of iterations is fixed, without an early exit, so that many roots are found side by side.
    """
    c3 = 2 * start + start_slope - 2 * end + end_slope
    c2 = 3 * (end - start) - 2 * start_slope - end_slope
    low, high = 0.0, 1.0
    u = start / (start - end) if start > 0.0 else 0.5  # a motor breaking away starts at zero speed
    for _ in range(_ROOT_ITERATIONS):
        value = start + u * (start_slope + u * (c2 + u * c3))
        slope = start_slope + u * (2 * c2 + u * 3 * c3)
        low = u if value > 0.0 else low
        high = high if value > 0.0 else u
        newton = u - value / (slope if slope != 0.0 else 1.0)
        u = newton if (newton >= low) & (newton <= high) else 0.5 * (low + high)
    return u


@inlined
def mode_change(
    x: ArmState, torque: float, direction: float, dt: float, y: ArmState, plant: Plant, model: Model
) -> tuple[float, float]:
    """Find when the motor stops or breaks away, given that it does within `dt`.

    Args:
        x: State at the beginning.
        torque: Motor torque [N m].
        direction: Friction mode at the beginning.
        dt: Length of the step in which the mode is left [s].
        y: State after that whole step, taken in the old mode.
        plant: Coefficients of the arm.
        model: Whose equations of motion.

    Returns:
        Share of `dt` that is then over, and the side to which a motor at rest breaks away, -1 or +1.
    """
    exit_side = 1.0 if driving_torque(y, torque, plant, model) > 0.0 else -1.0
    fraction = hermite_root(
        _exit_margin(x, torque, direction, exit_side, plant, model),
        dt * _exit_rate(x, torque, direction, exit_side, plant, model),
        _exit_margin(y, torque, direction, exit_side, plant, model),
        dt * _exit_rate(y, torque, direction, exit_side, plant, model),
    )
    return fraction, exit_side
