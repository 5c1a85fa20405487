"""Changes of an arm or a sensor, one thing at a time, under which controllers are run."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from beltarm_env import CONTROL_PERIOD, design_model
from beltarm_env.arm import COLUMN
from beltarm_env.arrays import Floats
from beltarm_env.task.ranges import DRIVE_RANGES
from eval.comparison.effects import EFFECTS

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


def _effect(name: str) -> Change:
    """An effect of the drive half as large again as the upper end of its training range."""
    effect = EFFECTS[name]
    title = f"{effect.column or effect.title} {effect.sign}{effect.shown(name, 1.5)} {effect.unit}"
    return Change(title, {name: 1.5 * DRIVE_RANGES[name][1]})


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
    *map(_effect, _EFFECTS),
    Change("encoder of 1000 counts", settings={"encoder_counts": 1000}),
    Change("encoder 1 sample late", settings={"delay": 1}),
    Change("full two-link arm", settings={"model": "lagrangian"}),
)
"""Changes of the design model with its drive."""
LIMITS = (_latency(f"{_MOST + 0.5:g} samples", _MOST + 0.5), *_TORQUE_CONSTANT)
"""Changes of arms as they are built: latency half a sample and torque constants beyond their training ranges."""
