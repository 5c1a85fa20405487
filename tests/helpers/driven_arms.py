"""Arms behind the drive as it is built, for the tests."""

import math
from typing import Any

import numpy as np

from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.task.ranges import DRIVE_RANGES, IDEAL_RANGES
from eval.reference.event_located import EventLocatedArm

UPPER_ENDS = {name: high for name, (_, high) in DRIVE_RANGES.items()}
"""Every effect of the drive at its upper end in training."""


def driven_arm(params: ArmParams, state: np.ndarray, model: str) -> EventLocatedArm:
    return EventLocatedArm(params, state, model)


def push(sample: int) -> float:
    """Command [N m]: a 3 Hz wave of a fifth of the torque limit and a square one of a tenth at 1.7 Hz."""
    time = sample * CONTROL_PERIOD
    return 0.06 * math.sin(6 * math.pi * time) + math.copysign(0.03, math.sin(3.4 * math.pi * (time + 1e-9)))


def swing(sample: int, arm: EventLocatedArm) -> float:
    """Command [N m] of a servo that swings the joint from 0.2 to 1.35 rad and back, 0.4 s each way."""
    time = sample * CONTROL_PERIOD - 0.1
    turn = 2 * math.pi / 0.8
    way = 1.15 * 0.5 * (1 - math.cos(turn * min(max(time, 0.0), 0.8)))
    rate = 1.15 * 0.5 * turn * math.sin(turn * time) if 0 < time < 0.8 else 0.0
    gear, (angle, speed, _, _) = arm.params.gear_ratio, arm.state.tolist()
    demand = 400 * (gear * (0.2 + way) - angle) + 40 * (gear * rate - speed)
    limit = arm.params.torque_limit
    return min(max(7e-5 * demand, -limit), limit)


def drawn_arms(count: int, seed: int) -> list[dict[str, Any]]:
    """Arms of the training ranges behind drives at the upper ends, with phases and orders of their own.

    Every other one has the lowest Stribeck speed instead, at which friction changes fastest.
    """
    rng = np.random.default_rng(seed)
    arms = []
    for k in range(count):
        arm = {name: rng.uniform(*pair) for name, pair in IDEAL_RANGES.items()} | UPPER_ENDS
        arm |= {name: rng.uniform(*DRIVE_RANGES[name]) for name in DRIVE_RANGES if name.endswith("_phase")}
        arm["torque_ripple_order"] = float(rng.integers(4, 13))
        if k % 2:
            arm["stribeck_speed"] = DRIVE_RANGES["stribeck_speed"][0]
        arms.append(arm)
    return arms
