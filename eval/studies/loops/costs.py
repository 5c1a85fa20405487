"""Costs of every controller: on randomized arms, and with one thing changed.

Arms and moves are drawn from seeds of their own, between those of validation and those of the test splits.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from beltarm_env import CONTROL_PERIOD, ArmParams, design_model
from beltarm_env.arm import COLUMN, params_columns
from beltarm_env.arrays import Floats
from beltarm_env.metrics import TORQUES
from beltarm_env.rollout import Controller, Recording, rollout
from beltarm_env.task.ranges import DRIVE_RANGES
from beltarm_env.task.seeds import LOOPS
from eval.comparison.statistics import estimate, interquartile_mean, worst_mean
from eval.studies._arms import drawn, heading

_DESIGN = design_model()


@dataclass(frozen=True)
class Change:
    """Arms or sensors that differ in one respect."""

    title: str
    constants: dict[str, float] = field(default_factory=dict)  # of the arms
    settings: dict[str, Any] = field(default_factory=dict)  # of the environment

    def applied(self, table: Floats) -> Floats:
        """Arms with this change, columns as `ArmParams`, shape (n, len(FIELDS))."""
        changed = table.copy()
        for name, value in self.constants.items():
            changed[:, getattr(COLUMN, name)] = value
        return changed


def _scaled(title: str, factor: float, *names: str) -> Change:
    return Change(f"{title} ×{factor:g}", {name: factor * getattr(_DESIGN, name) for name in names})


def _latency(title: str, samples: float) -> Change:
    return Change(f"latency {title}", {"command_latency": samples * CONTROL_PERIOD})


_FRICTION = ("coulomb_friction", "motor_viscous_friction")
_EFFECTS = ("current_loop_time_constant", "static_friction_excess", "friction_variation")
_EFFECTS += ("torque_ripple", "kinematic_error", "belt_stiffening")
_OWN, _MOST = (latency / CONTROL_PERIOD for latency in (_DESIGN.command_latency, DRIVE_RANGES["command_latency"][1]))
_TORQUE_CONSTANT = (
    Change("torque constant +15 %", {"torque_constant_error": 0.15}),
    Change("torque constant −15 %", {"torque_constant_error": -0.15}),
)
CHANGES = (
    Change("payload 0.2 kg", {"payload_mass": 0.2}),
    Change("payload 0.5 kg", {"payload_mass": 0.5}),
    _scaled("belt stiffness", 0.8, "belt_stiffness"),
    _scaled("belt stiffness", 0.5, "belt_stiffness"),
    _scaled("friction", 1.3, *_FRICTION),
    _scaled("friction", 1.8, *_FRICTION),
    _scaled("motor inertia", 0.85, "motor_inertia"),
    _scaled("motor inertia", 1.15, "motor_inertia"),
    _latency("+0.5 sample", _OWN + 0.5),
    _latency("+1 sample", _OWN + 1.0),
    *_TORQUE_CONSTANT,
    *(Change(heading(name, 1.5), {name: 1.5 * DRIVE_RANGES[name][1]}) for name in _EFFECTS),
    Change("encoder of 1000 counts", settings={"encoder_counts": 1000}),
    Change("encoder 1 sample late", settings={"delay": 1}),
    Change("full two-link arm", settings={"model": "lagrangian"}),
)
"""Changes of the design model with its drive."""
LIMITS = (_latency(f"{_MOST + 0.5:g} samples", _MOST + 0.5), *_TORQUE_CONSTANT)
"""Changes of randomized arms: latency half a sample and torque constants beyond their training ranges."""

SHOWN_METRICS = ("cost", "tip_rms_mm", "residual_pp_mm")

Maker = Callable[[list[ArmParams]], Controller]


def blind(controller: Controller) -> Maker:
    """Constructor of a controller that is the same for all arms."""
    return lambda arms: controller


def run_arms(make: Maker, table: Floats, **settings: Any) -> Recording:
    """Run episodes on arms, columns as `ArmParams`, arm i with the move that seed `LOOPS.first + i` draws."""
    controller = make([ArmParams.from_row(row) for row in table])
    sensors = getattr(controller, "sensors", "encoder")
    options = {"params": params_columns(table)}
    return rollout(controller, len(table), seed=LOOPS.first, options=options, sensors=sensors, **settings)


def measure_costs(make: Maker, arms: int, moves: int) -> dict[str, Any]:
    """Run a controller on `arms` randomized ones and on `moves` of the design model, changed and not."""
    design, randomized = np.tile(design_model().row(), (moves, 1)), drawn(arms, LOOPS.first).params_table
    as_designed, as_randomized = run_arms(make, design), run_arms(make, randomized)
    metrics = as_randomized.metrics()
    return {
        "mean": metrics["cost"].mean(),
        "worst": worst_mean(metrics["cost"]),
        "left": int((~as_randomized.finished).sum()),
        "metrics": {name: estimate(metrics[name][None]) for name in (*SHOWN_METRICS, *TORQUES)},
        "design": interquartile_mean(as_designed.cost),
        "changes": [_effect(make, design, change, as_designed.cost) for change in CHANGES],
        "limits": [_effect(make, randomized, change, as_randomized.cost) for change in LIMITS],
    }


def _effect(make: Maker, table: Floats, change: Change, before: Floats) -> dict[str, float]:
    """Mean and interquartile mean of the cost over those without a change, and how many arms left the workspace."""
    run = run_arms(make, change.applied(table), **change.settings)
    ratios = {"mean": run.cost.mean() / before.mean(), "iqm": interquartile_mean(run.cost) / interquartile_mean(before)}
    return {**ratios, "left": int((~run.finished).sum())}
