"""Corners of the training ranges, for loops and for designs that have to hold there.

Eleven constants that the training ranges vary touch the linear loop, `LOOP_FIELDS`. Of their 2048 corners nine are
chosen by what fails:

- the belt's damping always at its lower end, and viscous friction but once: they damp the mode for every loop;
- a light arm on a stiff belt behind a late drive: the fastest mode with the longest delay. A strong torque constant and
  a light motor are the highest gain, which most loops bear worst; with a weak one those fail whose observer expects it;
- the same with the slow mode of a load, of which a payload alone leaves the light arm's at 0 degrees;
- the slowest mode behind a heavy motor, which integral action excites;
- drives prompt and weak, for loops that rest on their gain, with stiff and with soft belts; and with a soft belt and
  much viscous friction, for observers that expect less of it.

Of 34 loops of all kinds with random gains, which were not looked at for the choice, those that pass here pass at all
2048 corners, and none has a modulus margin there that is more than 0.05 less. On 300 arms from within the ranges a loop
that feeds back the torsion of one simulated mode (`paper`) had less than at any corner: for a frequency in between.
"""

from __future__ import annotations

from dataclasses import replace

from beltarm_env import ArmParams
from beltarm_env.task.ranges import TRAIN_RANGES, design_model

LOOP_FIELDS = (
    *("motor_inertia", "motor_viscous_friction", "arm_inertia", "arm_inertia_swing", "payload_mass"),
    *("belt_stiffness", "belt_stiffening", "belt_damping_ratio"),
    *("current_loop_time_constant", "command_latency", "torque_constant_error"),
)
"""Constants of an arm that its linear loop depends on, and that the training ranges vary."""


def corner(*high: str) -> ArmParams:
    """The arm at the upper ends of some training ranges and the lower ends of the others of `LOOP_FIELDS`."""
    ends = {name: TRAIN_RANGES[name][name in high] for name in LOOP_FIELDS}
    return replace(design_model(), **ends)


_LATE = ("current_loop_time_constant", "command_latency")
_STIFF_LATE = ("belt_stiffness", *_LATE)
_LOAD = ("arm_inertia_swing", "payload_mass")
CORNERS = {
    "design model": design_model(),
    "stiff, late, strong": corner(*_STIFF_LATE, "torque_constant_error"),
    "stiff, late": corner(*_STIFF_LATE),
    "stiff": corner("belt_stiffness"),
    "loaded, stiff, late, strong": corner(*_LOAD, *_STIFF_LATE, "torque_constant_error"),
    "payload, stiff, late, heavy motor": corner("motor_inertia", "payload_mass", *_STIFF_LATE),
    "loaded, softest, late, heavy motor": corner("motor_inertia", "arm_inertia", *_LOAD, "belt_stiffening", *_LATE),
    "soft": corner("arm_inertia"),
    "payload, soft": corner("arm_inertia", "payload_mass"),
    "viscous, soft": corner("motor_viscous_friction", "arm_inertia", "belt_stiffening"),
}
"""Arms on which margins are asked for, by name; what a name does not say is at its lower end."""
