"""Changes of an arm or a sensor, one thing at a time: what the page asks about where controllers break."""

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


def _later(samples: float) -> Change:
    return Change(
        f"latency +{samples:g} sample", {"command_latency": _DESIGN.command_latency + samples * CONTROL_PERIOD}
    )


def _torque_constant(percent: int) -> Change:
    return Change(f"torque constant {percent:+d} %".replace("-", "−"), {"torque_constant_error": percent / 100})


def _effect(name: str, size: float) -> Change:
    """An effect of the drive at a multiple of the upper end of its training range."""
    effect = EFFECTS[name]
    title = f"{effect.column or effect.title} {effect.sign}{effect.shown(name, size)} {effect.unit}"
    return Change(title, {name: size * DRIVE_RANGES[name][1]})


_FRICTION = ("coulomb_friction", "motor_viscous_friction")
_BEYOND = 1.5
_TORQUE_CONSTANT = (_torque_constant(15), _torque_constant(-15))
CHANGES = (
    Change("payload 0.2 kg", {"payload_mass": 0.2}),
    Change("payload 0.5 kg", {"payload_mass": 0.5}),
    _scaled("belt stiffness", 0.8, "belt_stiffness"),
    _scaled("belt stiffness", 0.5, "belt_stiffness"),
    _scaled("friction", 1.3, *_FRICTION),
    _scaled("friction", 1.8, *_FRICTION),
    _scaled("motor inertia", 0.85, "motor_inertia"),
    _scaled("motor inertia", 1.15, "motor_inertia"),
    _later(0.5),
    _later(1.0),
    *_TORQUE_CONSTANT,
    *(
        _effect(name, _BEYOND)
        for name in (
            *("current_loop_time_constant", "static_friction_excess", "friction_variation", "torque_ripple"),
            *("kinematic_error", "belt_stiffening"),
        )
    ),
    Change("encoder of 1000 counts", settings={"encoder_counts": 1000}),
    Change("encoder 1 sample late", settings={"delay": 1}),
    Change("full two-link arm", settings={"model": "lagrangian"}),
)
"""Of the design model with its drive; effects of the drive are half as large again as the most in training."""

_LATEST = DRIVE_RANGES["command_latency"][1]
LIMITS = (
    Change(f"latency {_LATEST / CONTROL_PERIOD + 0.5:g} samples", {"command_latency": _LATEST + 0.5 * CONTROL_PERIOD}),
    *_TORQUE_CONSTANT,
)
"""Of arms as they are built: half a sample of latency beyond the training range, and torque constants beyond theirs."""
