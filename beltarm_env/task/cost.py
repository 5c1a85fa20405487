"""Cost per step: its negative is the reward, its sum what every controller is tuned on.

    cost = min(|e_p| / 10 mm, 10) + min(|e_v| / 200 mm/s, 10) + 0.1 |tau_k - tau_(k-1)| / torque limit

with the 2-D tip position error e_p and velocity error e_v against the tip of a rigid arm that follows the task
reference exactly. It cannot exceed `MAX_COST`; leaving the workspace is charged `MAX_COST` for every step that is left.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from beltarm_env.arm import Plant
from beltarm_env.engine import inlined
from beltarm_env.physics.kinematics import TipMotion, tip_error
from beltarm_env.timing import CONTROL_PERIOD, EPISODE_STEPS

POSITION_SCALE = 0.010  # [m]
VELOCITY_SCALE = 0.200  # [m/s]
MAX_TERM = 10.0  # of the position and of the velocity term
LARGEST_ERROR = 1e6  # [m]: reported of arms that huge torques have torn apart, whose tips are anywhere
TORQUE_RATE_WEIGHT = 0.1
MAX_COST = 2 * MAX_TERM + 2 * TORQUE_RATE_WEIGHT  # torque can change by twice its limit


STILL_BAND = 0.0005
"""Distance of the tip from its reference within which the arm is still [m]."""


class StepCost(NamedTuple):
    """Tip error [m], at most `LARGEST_ERROR`, and the three terms of the cost; the error's components [m]."""

    tip_error: float
    position: float
    velocity: float
    torque_rate: float
    x: float
    y: float


@inlined
def step_cost(tip: TipMotion, angle: float, speed: float, action: float, last_action: float, plant: Plant) -> StepCost:
    """Compute the cost of one step.

    Args:
        tip: Motion of the arm's end.
        angle: Reference joint angle [rad].
        speed: Reference joint speed [rad/s].
        action: Torque held over the step, over its limit.
        last_action: The same of the step before.
        plant: Coefficients of the arm.
    """
    off = tip_error(tip, angle, speed, plant)
    error = math.sqrt(off.x * off.x + off.y * off.y)
    velocity_error = math.sqrt(off.x_speed * off.x_speed + off.y_speed * off.y_speed)
    position = error * (1 / POSITION_SCALE)
    velocity = velocity_error * (1 / VELOCITY_SCALE)
    return StepCost(
        error if error < LARGEST_ERROR else LARGEST_ERROR,
        position if position < MAX_TERM else MAX_TERM,
        velocity if velocity < MAX_TERM else MAX_TERM,
        TORQUE_RATE_WEIGHT * abs(action - last_action),
        off.x,
        off.y,
    )


@inlined
def still_time(last: float, duration: float) -> float:
    """Return the time from a move's end until the arm is still [s]; all that is left of the move if it never is.

    Args:
        last: Number of steps after which the tip error was beyond `STILL_BAND` for the last time; 0 if it never was.
        duration: Of the move [s].
    """
    return max(min(last + 1, EPISODE_STEPS) * CONTROL_PERIOD - duration, 0.0)
