"""Linear model of the arm: from one sample to the next, tabulated over the joint angle; its vibration mode, dead time.

**Mode** of the belt behind a motor held by its servo. A servo much faster than the mode makes the joint angle theta_1
an input of (5b). Linear about an angle,

    M2 theta_s'' + D_s theta_s' + K_s theta_s = M2 theta_1'',

so that the mode has w = sqrt(K_s / M2(theta_1)) [rad/s] and zeta = D_s / (2 sqrt(K_s M2)): of the nominal arm
57.4 rad/s at 0 degrees and 21.7 rad/s at 90.

**Dead time** from a sample to the instant at which its command acts on the motor. The command is late by T_c, and the
current loop follows it with the time constant T_i. Control counts both as one dead time T_c + T_i, as a drive engineer
adds up small time constants (C. Kessler: Das symmetrische Optimum, Regelungstechnik 6, 1958): at 300 rad/s a lag of
0.55 ms differs from a dead time by 0.1 degrees of phase and 1.3 % of gain. So plans and feed-forward are read that much
later in the move, and feedback is about the state then.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arm import Plant, plant_of
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled, inlined
from beltarm_env.physics.linear import write_sampled_models
from beltarm_env.physics.models import LUMPED, Model
from beltarm_env.physics.substeps import REMEDIES, fastest_rate
from beltarm_env.physics.trigonometry import exponential, sine_cosine

_MOST = 0.5  # rate times period: there the series' next term is 0.5^10 / 10! = 3e-10
ANGLES = np.linspace(0.0, np.pi / 2, 46)
"""Joint angles of the tables [rad], every two degrees; outside, tables are constant."""


class LinearArm(NamedTuple):
    """Linear models x[k+1] = A x[k] + b tau_m + e alpha of an arm at each of `ANGLES`, Coulomb friction left out.

    See `beltarm_env.physics.linear.write_sampled_models`.
    """

    transition: Floats  # A, shape (46, 4, 4)
    by_torque: Floats  # b, shape (46, 4)
    by_acceleration: Floats  # e, shape (46, 4): of a torsional acceleration alpha [rad/s^2], held

    def at(self, k: int) -> LinearArm:
        """The model at one of the angles, without their axis."""
        return LinearArm(*(part[k] for part in self))


def empty_linear_arm() -> LinearArm:
    """Room for the linear models of an arm."""
    size = len(ANGLES)
    return LinearArm(np.empty((size, 4, 4)), np.empty((size, 4)), np.empty((size, 4)))


@compiled
def write_linear_arm(row: Any, model: Model, arm: LinearArm) -> None:
    """Write linear models, the belt with its mean stiffness, of an arm with a row of constants, as `ArmParams`."""
    write_sampled_models(plant_of(row), ANGLES, CONTROL_PERIOD, arm, model)


def linear_arm_of(row: Floats, model: Model = LUMPED) -> LinearArm:
    """Linear models of an arm with a row of constants, as the fields of `ArmParams`, by equations of motion.

    Raises:
        ValueError: If the arm is too stiff for the series that they are computed by.
    """
    rate = fastest_rate(plant_of(row), model)
    if not rate * CONTROL_PERIOD < _MOST:
        raise ValueError(
            f"the arm's fastest rate is {rate:.3g} rad/s: a linear model of a sample is for less than "
            f"{_MOST / CONTROL_PERIOD:.0f}: {REMEDIES[0]}"
        )
    arm = empty_linear_arm()
    write_linear_arm(row, model, arm)
    return arm


def linear_arm(params: ArmParams) -> LinearArm:
    """Linear models of an arm."""
    return linear_arm_of(params.row())


@inlined
def turning_load(angle: float, speed: float, plant: Plant) -> tuple[float, float]:
    """Inertia M2 [kg m^2] and the torque M2' phi'^2 / 2 [N m] that completes (5b), at an angle [rad] and its rate."""
    sine, cosine = sine_cosine(angle)
    return plant.inertia + plant.inertia_swing * sine * sine, plant.inertia_swing * sine * cosine * speed * speed


@inlined
def place(angle: float) -> tuple[int, float]:
    """Row of a table over `ANGLES` at or below an angle [rad], and the weight of the next one at it."""
    position = min(max(0.0, angle / ANGLES[1]), len(ANGLES) - 1.0)  # 0 of an angle that is not a number
    row = min(int(position), len(ANGLES) - 2)
    return row, position - row


@inlined
def between(low: float, high: float, weight: float) -> float:
    """Linear interpolation between two entries of a table, `weight` being that of the second."""
    return low * (1.0 - weight) + high * weight


def at_angle(table: Floats, angle: Floats) -> Floats:
    """Linear interpolation of one arm's table over `ANGLES` at joint angles [rad] of shape (n,): shape (n, ...)."""
    return np.array([table[row] * (1.0 - weight) + table[row + 1] * weight for row, weight in map(place, angle)])


class Mode(NamedTuple):
    """Vibration mode of an arm."""

    period: float  # of the damped vibration [s]
    decay: float  # of the amplitude over half a period: exp(-pi zeta / sqrt(1 - zeta^2))


@compiled
def held_mode(angle: float, plant: Plant) -> Mode:
    """Mode with the motor held at a joint angle [rad]."""
    m2, _ = turning_load(angle, 0.0, plant)
    zeta = 0.5 * plant.damping / math.sqrt(plant.stiffness * m2)
    root = math.sqrt(1.0 - zeta * zeta)
    return Mode(2 * math.pi / (math.sqrt(plant.stiffness / m2) * root), exponential(-math.pi * zeta / root))


def dead_time(params: ArmParams) -> float:
    """Return T_c + T_i [s]."""
    return params.command_latency + params.current_loop_time_constant
