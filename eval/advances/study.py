"""Runs of a chain of controllers, each with one step more than the one before, on the same arms and moves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from baselines import CONTROLLERS
from baselines.gains import tuned
from baselines.optimal.adaptive import AdaptiveController, AdaptiveGains
from baselines.yardsticks.privileged import PrivilegedController
from beltarm_env import BeltArmVectorEnv
from beltarm_env.arrays import Floats
from beltarm_env.metrics import TORQUE_QUALITY
from beltarm_env.rollout import Recording, rollout
from beltarm_env.task.seeds import LOOPS

MOST_ARMS = 10_000
SHOWN = ("cost", "tip_rms_mm", "residual_pp_mm", *TORQUE_QUALITY)
"""Metrics of the table."""

_ARM = ("swing", "stiffness", "motor_inertia", "friction", "inertia", "torque_constant")
_TIMING = ("delay", "lag")
_TURNING = ("variation", "excess", "stiffening")
_RIPPLE = ("ripple",)
_DRIFTS = ("drift", "friction_drift")
_UNEXPLAINED = 5e-3  # [N m], of a filter that identifies nothing: what one torque has to stand for then


@dataclass(frozen=True)
class Advance:
    """A controller, and what it has that the one before has not."""

    title: str
    name: str
    make: Callable[[], Any] | None  # None: the yardstick, which is made for its arms


def _identifying(*held: str) -> Callable[[], Any]:
    """`adaptive`, which plans with squares, and believes some of its `Uncertainty` to be what the design model says."""

    def make() -> Any:
        gains = tuned("adaptive", AdaptiveGains)
        known: dict[str, float] = dict.fromkeys(held, 0.0)
        if set(_ARM) <= set(held):
            known |= {**dict.fromkeys(_DRIFTS, 0.0), "disturbance": max(_UNEXPLAINED, gains.unexplained_torque)}
        return AdaptiveController(gains, uncertainty=replace(gains.uncertainty(), **known), improvements=0)

    return make


ADVANCES = (
    Advance("1991: computed torque, PD, torsion feedback", "paper", CONTROLLERS["paper"]),
    Advance("+ gains tuned, links and friction in the feed-forward", "retuned", CONTROLLERS["retuned"]),
    Advance("+ input shaping, integral action", "ei", CONTROLLERS["ei"]),
    Advance("+ optimal plan, observer, prediction (design model)", "preview", CONTROLLERS["preview"]),
    Advance("+ the arm's constants identified", "adaptive", _identifying(*_TIMING, *_TURNING, *_RIPPLE)),
    Advance("+ delay and current loop", "adaptive", _identifying(*_TURNING, *_RIPPLE)),
    Advance("+ friction over the turn, breakaway, stiffening", "adaptive", _identifying(*_RIPPLE)),
    Advance("+ torque ripple", "adaptive", _identifying()),
    Advance("+ first plan for the task's own cost", "adaptive", CONTROLLERS["adaptive"]),
    Advance("arm, drive and state known (no controller)", "privileged", None),
)
"""The chain."""

BESIDE = Advance("`adaptive` with nothing identified", "adaptive", _identifying(*_ARM, *_TIMING, *_TURNING, *_RIPPLE))
"""Not of the chain: what identification is worth to the same law."""


@dataclass(frozen=True)
class Found:
    """Metrics of one controller, each of shape (arms,)."""

    metrics: dict[str, Floats]
    left: int  # arms that left the workspace


def measure(advance: Advance, arms: int) -> Found:
    """Run one controller on arms of the training ranges; the same ones, with the same moves, for all."""
    run = _rollout(advance, arms)
    found = run.metrics()
    return Found({name: found[name] for name in SHOWN}, int((~run.finished).sum()))


def _rollout(advance: Advance, arms: int) -> Recording:
    if advance.make is not None:
        return rollout(advance.make(), arms, seed=LOOPS.first, randomization="train")
    env = BeltArmVectorEnv(arms, randomization="train", sensors="full")
    env.reset(seed=LOOPS.first)
    controller = PrivilegedController(list(env.params))
    return rollout(controller, arms, seed=LOOPS.first, randomization="train", sensors="full")
