"""Costs of every controller: on arms of the training ranges, with one constant changed, and against the optimum.

Arms and moves are drawn from seeds of their own, between those of validation and those of the test splits.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines import CONTROLLERS
from baselines.yardsticks.oracle import METRICS, read_file
from baselines.yardsticks.privileged import privileged_controller
from beltarm_env import ArmParams, BeltArmVectorEnv
from beltarm_env.arm import params_columns, params_table
from beltarm_env.rollout import Controller, Recording, rollout
from beltarm_env.task.reference import MoveShape
from beltarm_env.task.seeds import LOOPS

Floats = NDArray[np.float64]

PRIVILEGED = "privileged"
"""Name of the yardstick that knows arm and state; never ranked."""
_NOMINAL = ArmParams()


@dataclass(frozen=True)
class Change:
    """An arm or a sensor that differs from the nominal one, in one respect."""

    title: str
    params: dict[str, float] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)  # of the environment


def _scaled(title: str, factor: float, *names: str) -> Change:
    return Change(f"{title} ×{factor:g}", {name: factor * getattr(_NOMINAL, name) for name in names})


_FRICTION = ("coulomb_friction", "motor_viscous_friction")
CHANGES = (
    Change("payload 0.2 kg", {"payload_mass": 0.2}),
    Change("payload 0.5 kg", {"payload_mass": 0.5}),
    _scaled("stiffness", 0.8, "belt_stiffness"),
    _scaled("stiffness", 0.5, "belt_stiffness"),
    _scaled("friction", 1.3, *_FRICTION),
    _scaled("friction", 1.8, *_FRICTION),
    _scaled("motor inertia", 0.9, "motor_inertia"),
    _scaled("motor inertia", 1.1, "motor_inertia"),
    Change("delay 1 sample", settings={"delay": 1}),
    Change("delay 2 samples", settings={"delay": 2}),
    Change("1000 counts", settings={"encoder_counts": 1000}),
    Change("full arm", settings={"model": "lagrangian"}),
)
"""Changes of the nominal arm, made one at a time."""

Maker = Callable[[list[ArmParams]], Controller]


def makers(names: Sequence[str]) -> dict[str, Maker]:
    """Constructors of controllers for given arms, by name; only the one added, `PRIVILEGED`, looks at the arms.

    Raises:
        ValueError: If the file of gains is damaged.
    """
    return {**{name: _blind(CONTROLLERS[name]()) for name in names}, PRIVILEGED: privileged_controller}


def _blind(controller: Controller) -> Maker:
    return lambda arms: controller


def run_arms(name: str, make: Maker, arms: list[ArmParams], **settings: Any) -> Recording:
    """Run episodes on given arms, arm i with the move that seed `LOOPS.first + i` draws."""
    if name == PRIVILEGED:
        settings["sensors"] = "full"
    options = {"params": params_columns(params_table(arms))} | settings.pop("options", {})
    return rollout(make(arms), len(arms), seed=LOOPS.first, options=options, **settings)


def drawn_arms(count: int) -> list[ArmParams]:
    """Draw arms of the training ranges."""
    env = BeltArmVectorEnv(count, randomization="ideal")
    env.reset(seed=LOOPS.first)
    return list(env.params)


@dataclass(frozen=True)
class Break:
    """Effect of a change on a controller, on the same moves."""

    ratio: float  # mean cost over that on the nominal arm
    failures: int  # episodes in which the arm left the workspace


@dataclass(frozen=True)
class Costs:
    """Metrics of one controller, and the effect of each change on its cost."""

    nominal: dict[str, Floats]  # metrics on nominal arms, each of shape (n,)
    randomized: dict[str, Floats]  # on arms of the training ranges
    breaks: list[Break]  # in the order of `CHANGES`
    oracle: Floats  # cost in the scenarios of the clairvoyant optimum


def measure(name: str, make: Maker, count: int) -> Costs:
    """Run a controller on `count` nominal, changed and randomized arms each, and in the optimum's scenarios."""
    nominal = run_arms(name, make, [_NOMINAL] * count)
    breaks = []
    for change in CHANGES:
        run = run_arms(name, make, [ArmParams(**change.params)] * count, **change.settings)
        breaks.append(Break(float(run.cost.mean() / nominal.cost.mean()), int((~run.finished).sum())))
    randomized = run_arms(name, make, drawn_arms(count))
    return Costs(nominal.metrics(), randomized.metrics(), breaks, _on_oracle_scenarios(name, make))


def _on_oracle_scenarios(name: str, make: Maker) -> Floats:
    _, scenarios, _ = read_file()
    move = {field: [getattr(s.move, field) for s in scenarios] for field in MoveShape._fields}
    return run_arms(name, make, [s.params for s in scenarios], options={"move": move}).cost


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
