"""Vibration mode of the belt behind a motor held by its servo, as a function of the joint angle.

A servo much faster than the mode makes the joint angle theta_1 an input of (5b). Linear about an angle,

    M2 theta_s'' + D_s theta_s' + K_s theta_s = M2 theta_1'',

so that the mode has w = sqrt(K_s / M2(theta_1)) [rad/s] and zeta = D_s / (2 sqrt(K_s M2)): of the nominal arm
57.4 rad/s at 0 degrees and 21.7 rad/s at 90.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from baselines.models.linear import turning_load
from beltarm_env.arm import Plant
from beltarm_env.engine import compiled
from beltarm_env.physics.trigonometry import exponential


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
