"""Arms that studies draw, and controllers that several studies run on them."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

from baselines.gains import tuned
from baselines.optimal.adaptive import AdaptiveController, AdaptiveGains
from baselines.yardsticks.privileged import PrivilegedController
from beltarm_env import BeltArmVectorEnv

_NOISE = ("torque", "acceleration", "disturbance", "memory", "kinematic_error")  # of `Uncertainty`, beside doubts
_UNEXPLAINED = 5e-3  # [N m], of a filter that identifies nothing: what one torque has to stand for then


def drawn(count: int, seed: int, randomization: Any = "train") -> BeltArmVectorEnv:
    """Arms at the beginning of their moves, as `rollout` draws them: arm i has seed + i."""
    env = BeltArmVectorEnv(count, randomization=randomization)
    env.reset(seed=seed)
    return env


def privileged(count: int, seed: int, randomization: Any = "train") -> PrivilegedController:
    """The oracle for the arms that `drawn` draws."""
    return PrivilegedController(list(drawn(count, seed, randomization).params))


def believing(*held: str) -> AdaptiveController:
    """`adaptive`, which plans with squares, and believes some of its `Uncertainty` to be what the design model says."""
    gains = tuned("adaptive", AdaptiveGains)
    return AdaptiveController(
        gains, uncertainty=replace(gains.uncertainty(), **dict.fromkeys(held, 0.0)), improvements=0
    )


def identifying_nothing() -> AdaptiveController:
    """`adaptive` that believes in the design model, and explains what it sees by a disturbance."""
    gains = tuned("adaptive", AdaptiveGains)
    sure = {doubt.name: 0.0 for doubt in fields(gains.uncertainty()) if doubt.name not in _NOISE}
    doubts = replace(gains.uncertainty(), **sure, disturbance=max(_UNEXPLAINED, gains.unexplained_torque))
    return AdaptiveController(gains, uncertainty=doubts, improvements=0)
