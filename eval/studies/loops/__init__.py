"""Classical controllers in numbers: margins, costs, limits, times and tuning of each.

Poles and margins of the closed loop over joint angle and arms; cost and metrics on arms as they are built; cost with
one thing changed; the price of the margins; what identification is worth; time per action; gains and their tuning.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, fields
from functools import partial
from typing import Any

import numpy as np

from baselines import CONTROLLERS, TUNABLE
from baselines.gains import read_file
from baselines.loops.condition import CORNERS, MarginCondition, margins_on
from baselines.loops.models import continuous
from baselines.models.linear import ANGLES
from baselines.tools.progress import progress_over
from baselines.yardsticks.privileged import PrivilegedController
from beltarm_env import EPISODE_STEPS
from beltarm_env.arrays import Floats
from beltarm_env.rollout import Controller
from beltarm_env.task.seeds import LOOPS
from eval.comparison.check import microseconds
from eval.comparison.methods import chosen
from eval.studies._frame import Bounds, StudyOptions
from eval.studies.loops.costs import CHANGES, LIMITS, blind, measure_costs, optimum, price, worth
from eval.studies.loops.page import pictures, tables

__all__ = ["QUICK", "Options", "measure", "pictures", "tables"]
ORACLE = "privileged"
"""Name of the controller that knows arm and state; never ranked."""
QUICK = {"names": ("paper", "ei"), "arms": 8, "batch": 2}
ARMS = tuple(CORNERS)
"""Arms that loops are looked at on; the first is the design model."""
NONE_LEFT = {"gain_up": 1.0, "gain_down": 1.0, "phase": 0.0, "delay": 0.0, "modulus": 0.0}
"""Margins by name, and their values for an unstable loop."""
_REPETITIONS = 5  # of the episode that is timed
_PLANE = (-62.0, 72.0)  # smallest real and largest imaginary part of the poles that are drawn [1/s]


@dataclass(frozen=True)
class Options(StudyOptions):
    """Options of the study."""

    bounds = Bounds(arms=(8, 10_000), batch=(1, LOOPS.size))

    names: tuple[str, ...] = ()
    """Controllers to show. Default: all."""
    arms: int = 256
    """Arms for each cost, 8 to 10000. Where one thing is changed, a quarter of them."""
    batch: int = 256
    """Arms of the batch that is timed."""


def measure(options: Options) -> dict[str, Any]:
    """Everything about the chosen controllers; `ORACLE`, the last, has costs alone.

    Raises:
        ValueError: If a name is unknown, or a file of gains or of the optimum is damaged.
    """
    names = chosen("controller", options.names, CONTROLLERS)
    rows, built = {}, {}
    for name in progress_over("controllers", [*names, ORACLE]):
        make = PrivilegedController if name == ORACLE else blind(CONTROLLERS[name]())
        built[name], rows[name] = measure_costs(make, options.arms, options.arms // 4)
        if name != ORACLE:
            about = {"loop": scan(CONTROLLERS[name]()), "price": price(name, built[name])}
            rows[name] |= about | {"times": times(make([]), options.batch)}
    return {
        "arms": options.arms,
        "moves": options.arms // 4,
        "batch": options.batch,
        "first_seed": LOOPS.first,
        "oracle": ORACLE,
        "changes": [change.title for change in CHANGES],
        "limits": [change.title for change in LIMITS],
        "corners": ARMS,
        "asked": {"modulus": MarginCondition().modulus, "delay": MarginCondition().delay},
        "controllers": rows,
        "gains": {name: gains(name) for name in names},
        "worth": worth({name: built[name] for name in names}),
        "optimum": optimum(),
    }


def scan(controller: Any) -> dict[str, Any]:
    """Margins and poles of a controller on `ARMS` at each of `ANGLES`, as the page shows them.

    Raises:
        ValueError: If there is no linear law for the controller.
    """
    least, closed = margins_on(controller)
    margins = {name: np.where(least.stable, getattr(least, name), none) for name, none in NONE_LEFT.items()}
    poles = [continuous(at_angle) for at_angle in closed[0]]
    shown = [p[(p.imag > -1e-6) & (p.imag < _PLANE[1]) & (p.real > _PLANE[0])] for p in poles]
    return {
        "stable": bool(least.stable.all()),
        "stable_design": bool(least.stable[0].all()),
        "slowest": max(float(at_angle.real.max()) for at_angle in poles),
        "worst": {name: worst(name, values) for name, values in margins.items()},
        "worst_design": {name: worst(name, values[:1]) for name, values in margins.items()},
        "modulus_by_arm": margins["modulus"].min(axis=1),
        "design": {name: values[0] for name, values in margins.items()},
        "over_arms": {
            name: values.max(axis=0) if name == "gain_down" else values.min(axis=0) for name, values in margins.items()
        },
        "poles": [np.stack([each.real, each.imag], axis=-1) for each in shown],
    }


def worst(name: str, values: Floats) -> dict[str, Any]:
    """Worst value of a margin, shape (arms, 46), with its arm and its angle [degrees]."""
    place = values.argmax() if name == "gain_down" else values.argmin()
    arm, k = np.unravel_index(int(place), values.shape)
    return {"value": values[arm, k], "arm": ARMS[arm], "degrees": np.degrees(ANGLES[k])}


def times(controller: Controller, batch: int) -> dict[str, float]:
    """Wall-clock of a controller on arms of the training ranges.

    One arm plays the same episode several times, and the shortest time of each action counts, without other work of the
    machine.

    Returns:
        `first`, an episode's first action of one arm, with the plan for its move; `median` and `slow`, the 99th
        percentile, of its later actions; `batched`, per action in a batch [us]; and the batch's whole `episode` [s].
    """
    run = partial(microseconds, controller, steps=EPISODE_STEPS, seed=LOOPS.first, randomization="train")
    alone = np.min([run(1) for _ in range(_REPETITIONS)], axis=0)
    began = time.perf_counter()
    batched = np.median(run(batch)) / batch
    episode = time.perf_counter() - began
    median, slow = np.percentile(alone[1:], [50, 99])
    return {"first": alone[0], "median": median, "slow": slow, "batched": batched, "episode": episode}


def gains(name: str) -> dict[str, Any]:
    """Gains of a controller with the ranges that are searched, and the provenance of their tuning, if there was one."""
    own = CONTROLLERS[name]().gains
    origin = read_file().get(name, {}).get("provenance") if name in TUNABLE else None
    shown = ("command", "seed", "steps", "trials", "refused", "seconds", "date", "commit", "cost_untuned", "cost")
    return {
        "law": type(own).__name__,
        "values": [
            {"name": gain.name, "value": getattr(own, gain.name), "searched": dict(gain.metadata) or None}
            for gain in fields(own)
        ],
        "tuning": origin and {key: origin[key] for key in (*shown, "measured_on")},
    }
