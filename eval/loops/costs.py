"""What every controller costs: on arms of the training ranges, where one constant is moved, and against the optimum.

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
from beltarm_env.arm import FIELDS
from beltarm_env.rollout import Controller, Recording, rollout
from beltarm_env.task.reference import MoveShape

Floats = NDArray[np.float64]

SEED = 7_500_000
"""Arm i is seeded with this + i."""
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
"""What is moved, one at a time."""

Maker = Callable[[list[ArmParams]], Controller]


def makers(names: Sequence[str]) -> dict[str, Maker]:
    """Controllers by name, made for arms; only the one added, `PRIVILEGED`, looks at them.

    Raises:
        ValueError: If the file of gains is damaged.
    """
    return {**{name: _blind(CONTROLLERS[name]()) for name in names}, PRIVILEGED: privileged_controller}


def _blind(controller: Controller) -> Maker:
    return lambda arms: controller


def run_arms(name: str, make: Maker, arms: list[ArmParams], **settings: Any) -> Recording:
    """Episodes on given arms, arm i with the move that seed `SEED + i` draws."""
    if name == PRIVILEGED:
        settings["sensors"] = "full"
    params = {field: [getattr(arm, field) for arm in arms] for field in FIELDS}
    options = {"params": params} | settings.pop("options", {})
    return rollout(make(arms), len(arms), seed=SEED, options=options, **settings)


def drawn_arms(count: int) -> list[ArmParams]:
    """Arms of the training ranges."""
    env = BeltArmVectorEnv(count, randomization="train")
    env.reset(seed=SEED)
    return list(env.params)


@dataclass(frozen=True)
class Break:
    """What a change does to a controller, on the same moves."""

    ratio: float  # mean cost over that on the nominal arm
    failures: int  # episodes in which the arm left the workspace


@dataclass(frozen=True)
class Costs:
    """What one controller costs."""

    nominal: dict[str, Floats]  # metrics on nominal arms, each of shape (n,)
    randomized: dict[str, Floats]  # on arms of the training ranges
    breaks: list[Break]  # in the order of `CHANGES`
    oracle: Floats  # cost in the scenarios of the clairvoyant optimum


def measure(name: str, make: Maker, count: int) -> Costs:
    """Run a controller on everything, `count` arms each."""
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
class Oracle:
    """The clairvoyant optimum's scenarios and what it costs there."""

    names: list[str]
    costs: Floats


def oracle() -> Oracle:
    """As stored in `baselines/oracle.json`.

    Raises:
        ValueError: If the file is damaged.
    """
    rows = read_file()[0]["scenarios"]
    return Oracle([f"{row['kind']}:{row['seed']}" for row in rows], np.array([row[METRICS[0]] for row in rows]))
