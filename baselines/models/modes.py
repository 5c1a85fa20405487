"""Vibration mode of the belt behind a motor held by its servo, as a function of the joint angle.

A servo much faster than the mode makes the joint angle theta_1 an input of (5b). Linear about an angle,

    M2 theta_s'' + D_s theta_s' + K_s theta_s = M2 theta_1'',

so that the mode has w = sqrt(K_s / M2(theta_1)) [rad/s] and zeta = D_s / (2 sqrt(K_s M2)): of the nominal arm
57.4 rad/s at 0 degrees and 21.7 rad/s at 90.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from baselines.models.rigid_arm import RigidArm
from beltarm_env import ArmParams
from beltarm_env.arrays import Floats


class Mode(NamedTuple):
    """Vibration modes of n arms; arrays of shape (n,)."""

    period: Floats  # of the damped vibration [s]
    decay: Floats  # of the amplitude over half a period: exp(-pi zeta / sqrt(1 - zeta^2))


def held_mode(params: ArmParams, angle: Floats) -> Mode:
    """Mode with the motor held at joint angles [rad] of shape (n,)."""
    m2 = RigidArm(params).link_inertia(angle)
    plant = params.plant()
    zeta = 0.5 * plant.damping / np.sqrt(plant.stiffness * m2)
    root = np.sqrt(1.0 - zeta * zeta)
    return Mode(2 * np.pi / (np.sqrt(plant.stiffness / m2) * root), np.exp(-np.pi * zeta / root))
