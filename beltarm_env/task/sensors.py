"""Encoder of the motor: counts, and speed by differencing.

The encoder counts `motor angle / resolution`, rounded to the nearest whole count (half a count either way, unbiased);
the motor speed is the difference of two successive counts over the control period, as in the paper's software servo.
An index pulse, one per turn, tells where in its turn the motor is.

Sensors may be read between two samples, T apart. The state is then that of the cubics through angles and speeds at both
(Hermite's). Between samples the acceleration changes by V in all, the sum of its rises and falls, jumps included; the
angle is then wrong by at most 0.0162 V T^2, the speed by V T / 12: for each 0.1 N m by which the motor's net torque
changes in between, 0.04 counts of the encoder. Where nothing jumps, the angle is wrong by at most T^4 / 384 times its
fourth derivative.
"""

from __future__ import annotations

from beltarm_env.engine import inlined
from beltarm_env.physics.state import ArmState
from beltarm_env.physics.trigonometry import ROUNDER, sin_cos, wrapped
from beltarm_env.timing import CONTROL_PERIOD

ENCODER_COUNTS = 4000
"""Counts per motor revolution: 1000 pulses, four edges each."""


@inlined
def to_counts(angle: float, resolution: float) -> float:
    """Return the nearest whole count for a motor angle [rad], resolution in rad per count; halves round to even.

    Exact for magnitudes below 2^51 counts. Addition and subtraction of one constant, instead of a call to round, keep
    the loop over arms vectorised.
    """
    return (angle / resolution + ROUNDER) - ROUNDER


@inlined
def speed_from_counts(now: float, before: float, resolution: float) -> float:
    """Return the motor speed [rad/s] by differencing two successive counts."""
    return (now - before) * resolution * (1 / CONTROL_PERIOD)


@inlined
def around_half_a_turn(angle: float) -> tuple[float, float]:
    """Return sine and cosine of twice a motor angle [rad]: where in its half turn the motor is.

    Whole periods are taken off first, because `sin_cos` is for small angles. The error is below 1.5e-12 for angles up
    to 1000 rad: that of its series at pi is 1.1e-12.
    """
    return sin_cos(wrapped(2.0 * angle))


@inlined
def _cubic(angle_0: float, speed_0: float, angle_1: float, speed_1: float, back: float) -> tuple[float, float]:
    """Return angle and speed `back` of a period before instant 1, on the cubic through both instants."""
    change = angle_0 - angle_1
    slope_0, slope_1 = -CONTROL_PERIOD * speed_0, -CONTROL_PERIOD * speed_1  # per period, backwards in time
    square = 3.0 * change - 2.0 * slope_1 - slope_0
    cube = slope_0 + slope_1 - 2.0 * change
    angle = angle_1 + back * (slope_1 + back * (square + back * cube))
    return angle, speed_1 - back * (2.0 * square + 3.0 * back * cube) * (1 / CONTROL_PERIOD)


@inlined
def between_samples(before: ArmState, x: ArmState, back: float) -> ArmState:
    """Return the state `back` of a period before a sample with state x, `before` being that of the sample before.

    For back = 0 it is x, bit for bit.
    """
    angle, speed = _cubic(before.motor_angle, before.motor_speed, x.motor_angle, x.motor_speed, back)
    torsion, torsion_speed = _cubic(before.torsion, before.torsion_speed, x.torsion, x.torsion_speed, back)
    now = back == 0.0
    return ArmState(
        x.motor_angle if now else angle,
        x.motor_speed if now else speed,
        x.torsion if now else torsion,
        x.torsion_speed if now else torsion_speed,
    )
