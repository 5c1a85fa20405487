"""Costs of every controller: on arms as they are built, with one thing changed, and against the optimum.

Arms and moves are drawn from seeds of their own, between those of validation and those of the test splits.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from baselines import CONTROLLERS
from baselines.yardsticks.oracle import METRICS, read_file
from baselines.yardsticks.privileged import PrivilegedController
from beltarm_env import ArmParams, BeltArmVectorEnv, design_model
from beltarm_env.arm import params_columns, params_table
from beltarm_env.arrays import Floats
from beltarm_env.rollout import Controller, Recording, rollout
from beltarm_env.task.reference import MoveShape
from beltarm_env.task.seeds import LOOPS
from eval.comparison.statistics import interquartile_mean
from eval.loops.changes import CHANGES, LIMITS, Change

PRIVILEGED = "privileged"
"""Name of the yardstick that knows arm and state; never ranked."""

Maker = Callable[[list[ArmParams]], Controller]


def makers(names: Sequence[str]) -> dict[str, Maker]:
    """Constructors of controllers for given arms, by name; only the one added, `PRIVILEGED`, looks at the arms.

    Raises:
        ValueError: If the file of gains is damaged.
    """
    return {**{name: blind(CONTROLLERS[name]()) for name in names}, PRIVILEGED: PrivilegedController}


def blind(controller: Controller) -> Maker:
    """Constructor of a controller that is the same for all arms."""
    return lambda arms: controller


def run_arms(make: Maker, table: Floats, **settings: Any) -> Recording:
    """Run episodes on arms, columns as `ArmParams`, arm i with the move that seed `LOOPS.first + i` draws."""
    controller = make([ArmParams.from_row(row) for row in table])
    sensors = getattr(controller, "sensors", "encoder")
    options = {"params": params_columns(table)} | settings.pop("options", {})
    return rollout(controller, len(table), seed=LOOPS.first, options=options, sensors=sensors, **settings)


def built_arms(count: int) -> Floats:
    """Arms and drives of the training ranges, columns as `ArmParams`, shape (count, len(FIELDS))."""
    env = BeltArmVectorEnv(count, randomization="train")
    env.reset(seed=LOOPS.first)
    return env.params_table


@dataclass(frozen=True)
class Effect:
    """Effect of a change on a controller, on the same moves."""

    of_mean: float  # mean cost over that without the change
    of_iqm: float  # the same of interquartile means
    failures: int  # episodes in which the arm left the workspace


@dataclass(frozen=True)
class Costs:
    """Metrics of one controller, and the effect of each change on its cost."""

    built: dict[str, Floats]  # metrics on arms as they are built, each of shape (n,)
    left: int  # of these, how many left the workspace
    design: Floats  # cost on the design model, shape (m,)
    changes: list[Effect]  # of `CHANGES`, on the design model
    limits: list[Effect]  # of `LIMITS`, on the arms as they are built
    oracle: Floats  # cost in the scenarios of the clairvoyant optimum


def measure(make: Maker, arms: int, moves: int) -> Costs:
    """Run a controller on arms as they are built and on the design model, changed and not, and beside the optimum.

    Args:
        make: Of the controller.
        arms: Number of arms as they are built.
        moves: Number of moves of the design model.
    """
    design, built = np.tile(design_model().row(), (moves, 1)), built_arms(arms)
    as_designed, as_built = run_arms(make, design), run_arms(make, built)
    return Costs(
        built=as_built.metrics(),
        left=int((~as_built.finished).sum()),
        design=as_designed.cost,
        changes=[_effect(make, design, change, as_designed.cost) for change in CHANGES],
        limits=[_effect(make, built, change, as_built.cost) for change in LIMITS],
        oracle=_on_oracle_scenarios(make),
    )


def _effect(make: Maker, table: Floats, change: Change, before: Floats) -> Effect:
    run = run_arms(make, change.applied(table), **change.settings)
    of_iqm = interquartile_mean(run.cost) / interquartile_mean(before)
    return Effect(float(run.cost.mean() / before.mean()), of_iqm, int((~run.finished).sum()))


def _on_oracle_scenarios(make: Maker) -> Floats:
    _, scenarios, _ = read_file()
    move = {field: [getattr(s.move, field) for s in scenarios] for field in MoveShape._fields}
    return run_arms(make, params_table([s.params for s in scenarios]), options={"move": move}).cost


@dataclass(frozen=True)
class OracleCosts:
    """The clairvoyant optimum's scenarios, and its cost in each."""

    names: list[str]
    costs: Floats


def oracle() -> OracleCosts:
    """Read the clairvoyant optimum from `baselines/oracle.json`.

    Raises:
        ValueError: If the file is damaged.
    """
    rows = read_file()[0]["scenarios"]
    return OracleCosts([f"{row['kind']}:{row['seed']}" for row in rows], np.array([row[METRICS[0]] for row in rows]))
