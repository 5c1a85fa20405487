"""Does presliding matter? Shipped controllers on arms with LuGre friction, beside the friction located as events."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from itertools import combinations

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from baselines.engines.parallel import Channel, Failure, run_side_by_side
from beltarm_env import BeltArmVectorEnv
from beltarm_env.arm import COLUMN
from beltarm_env.rollout import Controller, Recording, record
from eval.comparison.methods import classical_methods, learned_methods, shipped_policies
from eval.comparison.statistics import Paired, interquartile_mean, paired
from eval.verification.lugre import STEPS, LuGreArms

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

CONTROLLERS = ("paper", "ei", "preview", "adaptive", "ppo", "student")
"""Shipped controllers; of a learned one the policy of its first training seed."""
DEFLECTIONS = (3e-4, 1e-3, 3e-3, 1e-2)
"""Breakaway deflections at the motor [rad]; over the gear ratio at the joint."""
CHECKED_DEFLECTIONS = (3e-3, 1e-3, 3e-4, 1e-4, 3e-5)
"""Of the check that the located friction is the limit of a stiff bristle [rad]."""
CHECKED = ("paper", "ei")
"""Controllers of the check: those whose loops do not amplify rounding."""
NUDGE = 1e-5
"""By how much the torsion at the beginning differs, about half an encoder count at the joint, to see what chance does
[rad]."""

LOCATED, NUDGED = "located", "located, nudged"


def friction_name(deflection: float) -> str:
    """Name of LuGre friction with a breakaway deflection at the motor [rad]."""
    return f"{1e3 * deflection:g} mrad"


FRICTIONS: dict[str, float | None] = {LOCATED: None, NUDGED: None, **{friction_name(d): d for d in DEFLECTIONS}}
"""Breakaway deflection by the name of the friction, None for that of the kernels."""


@dataclass(frozen=True, slots=True)
class Result:
    """Metrics of one controller with one friction, each of shape (n,); `left` the workspace: 0 or 1."""

    controller: str
    friction: str
    metrics: dict[str, Floats]


@dataclass(frozen=True, slots=True)
class Check:
    """LuGre friction with one deflection against the located one."""

    deflection: float  # at the motor [rad]
    tip: float  # largest distance of the tips, of the median arm, given the same torques [m]
    costs: dict[str, float]  # by controller: mean absolute difference of the costs in closed loop, over the mean cost


class Replay:
    """Controller that repeats recorded actions, shape (T, n)."""

    def __init__(self, actions: Floats) -> None:
        self._actions = actions

    def predict(
        self,
        observation: Singles,
        state: int | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[Singles, int]:
        """Return the next actions of all arms; `state` counts them."""
        k = state or 0
        return self._actions[k, :, None].astype(np.float32), k + 1


def make_controller(name: str) -> Controller:
    """Make a shipped controller."""
    methods = [*classical_methods(), *learned_methods(shipped_policies())]
    (method,) = (method for method in methods if method.name == name)
    return method.controller(0, [])


def run(
    controller: Controller, arms: int, seed: int, deflection: float | None, *, nudge: float = 0.0, steps: int = STEPS
) -> Recording:
    """Run a controller on arms of the training ranges.

    Args:
        controller: What to run.
        arms: Number of arms.
        seed: Of the first arm; arm i has seed + i.
        deflection: At which the motor breaks away [rad]; None for the friction of the kernels.
        nudge: Added to the torsion at the beginning [rad].
        steps: Of LuGre friction, per control period, at least.
    """
    env = BeltArmVectorEnv(arms, randomization="train", autoreset_mode=AutoresetMode.DISABLED)
    if deflection is not None:
        env._batch.engine = LuGreArms(env._batch, deflection, steps)
    options = None
    if nudge:
        env.reset(seed=seed)
        options = {"state": env.state + np.array([0.0, 0.0, nudge, 0.0])}
    return record(controller, env, seed=seed, options=options)


def run_case(controller: str, friction: str, arms: int, seed: int) -> Result:
    """Run one controller with one friction."""
    nudge = NUDGE if friction == NUDGED else 0.0
    recording = run(make_controller(controller), arms, seed, FRICTIONS[friction], nudge=nudge)
    metrics: dict[str, Floats] = {**recording.metrics(), "left": np.where(recording.finished, 0.0, 1.0)}
    return Result(controller, friction, metrics)


def check_case(deflection: float, arms: int, seed: int) -> Check:
    """Compare LuGre friction with the located one: the tips under the same torques, and the costs in closed loop."""
    costs, tip = {}, 0.0
    for name in CHECKED:
        located = run(make_controller(name), arms, seed, None)
        bristles = run(make_controller(name), arms, seed, deflection)
        costs[name] = float(np.mean(np.abs(bristles.cost - located.cost)) / np.mean(located.cost))
        replay = Replay(located.torque / located.params[:, COLUMN.torque_limit])
        apart = run(replay, arms, seed, deflection).tip_error - run(replay, arms, seed, None).tip_error
        tip = max(tip, float(np.median(np.linalg.norm(apart, axis=2).max(axis=0))))
    return Check(deflection, tip, costs)


@dataclass(frozen=True, slots=True)
class Study:
    """All results, and the check of the engine."""

    results: dict[tuple[str, str], Result]  # by controller and friction
    checks: list[Check]

    def metric(self, name: str, controller: str, friction: str) -> Floats:
        """Values of a metric on all arms, shape (n,)."""
        return self.results[controller, friction].metrics[name]

    @property
    def steady(self) -> list[str]:
        """Controllers with which no arm leaves the workspace, whatever the friction."""
        left = {name: sum(self.metric("left", name, friction).sum() for friction in FRICTIONS) for name in CONTROLLERS}
        return [name for name in CONTROLLERS if not left[name]]

    def change(self, metric: str, controller: str, friction: str) -> Paired:
        """Compare a metric with one friction with that of the located one, arm by arm."""
        values = [self.metric(metric, controller, name)[None] for name in (friction, LOCATED)]
        return paired(values[0], values[1])

    def ranking(self, metric: str, friction: str) -> list[str]:
        """Controllers by the interquartile mean of a metric, the lowest first."""
        return sorted(CONTROLLERS, key=lambda name: interquartile_mean(self.metric(metric, name, friction)))

    def verdicts(self, metric: str, friction: str) -> dict[tuple[str, str], str]:
        """By pair of controllers whether the first has less than the second, arm by arm (`Paired.verdict`)."""
        values = {name: self.metric(metric, name, friction)[None] for name in CONTROLLERS}
        return {(one, two): paired(values[one], values[two]).verdict for one, two in combinations(CONTROLLERS, 2)}


def run_study(arms: int, checked: int, seed: int, jobs: int, tell: Callable[[str], object] = print) -> Study:
    """Run all controllers with all frictions on the same arms.

    Args:
        arms: Number of arms.
        checked: Number of arms that the engine is checked on.
        seed: Of the first arm; arm i has seed + i.
        jobs: Number of processes.
        tell: Called with the name of each part that is done.

    Raises:
        RuntimeError: If a part fails.
    """
    tasks: dict[str, Callable[[Channel], Result | Check]] = {}
    for deflection in reversed(CHECKED_DEFLECTIONS):
        tasks[f"check, {friction_name(deflection)}"] = partial(_of_channel, check_case, deflection, checked, seed)
    for controller in reversed(CONTROLLERS):
        for friction in FRICTIONS:
            tasks[f"{controller}, {friction}"] = partial(_of_channel, run_case, controller, friction, arms, seed)
    found: dict[str, Result | Check] = {}
    with closing(run_side_by_side(tasks, jobs)) as outcomes:
        for name, outcome in outcomes:
            if isinstance(outcome, Failure):
                raise RuntimeError(f"{name}: {outcome.message}")
            found[name] = outcome
            tell(name)
    results = [one for one in found.values() if isinstance(one, Result)]
    checks = [one for one in found.values() if isinstance(one, Check)]
    return Study(
        {(one.controller, one.friction): one for one in results},
        sorted(checks, key=lambda check: -check.deflection),
    )


def _of_channel(work: Callable[..., Result | Check], *arguments: object) -> Result | Check:
    """Call without the channel, which is the last argument of a task."""
    return work(*arguments[:-1])
