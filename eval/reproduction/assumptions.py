"""What the paper does not print, what is chosen instead, and the alternatives that its conclusion is tried with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from beltarm_env import ArmParams
from beltarm_env.task.reference import MoveShape
from beltarm_env.task.sensors import ENCODER_COUNTS
from eval.reproduction.loop import ServoGains
from eval.reproduction.ringing import Suppression, suppression
from eval.reproduction.runs import Conditions, is_allowed
from eval.style.text import degrees

USUAL_MOVE = MoveShape(np.pi / 4, np.pi / 2, 0.8, 0.12)
"""The standard move where no other is asked for."""
_RAMP_TIMES = (0.08, 0.10, 0.16, 0.20, 0.25, 0.30)
_LENGTHENED = (0.8, 1.25, 1.5)
_TABLE_1 = ArmParams()


@dataclass(frozen=True, slots=True)
class Alternative:
    """Another value of one assumption."""

    label: str
    move: MoveShape
    arm: Mapping[str, float] = field(default_factory=dict)  # what differs of `ArmParams`
    unknown: bool = False  # whether it does so unknown to the controller
    changes: Mapping[str, Any] = field(default_factory=dict)  # what else differs of `Conditions`

    def under(self, base: Conditions) -> Conditions:
        """Conditions with this value, all others as in `base`."""
        known = base.arm if self.unknown else base.known
        return replace(base, arm=replace(base.arm, **self.arm), known=known, **self.changes)


@dataclass(frozen=True, slots=True)
class Assumption:
    """Unpublished setting, chosen value, alternatives; docs/paper.md says why each is chosen."""

    name: str
    chosen: str
    alternatives: list[Alternative]


def list_assumptions(standard: MoveShape) -> list[Assumption]:
    """Everything assumed, varied one at a time around the standard move."""
    return [*_of_the_move(standard), *_of_the_arm(standard), *_of_the_servo(standard)]


def _of_the_move(standard: MoveShape) -> list[Assumption]:
    ramps = [(f"ramps of {ramp:g} s", standard._replace(ramp_time=ramp)) for ramp in _RAMP_TIMES]
    durations = [
        (
            f"move of {factor * standard.duration:.3g} s",
            standard._replace(duration=factor * standard.duration, ramp_time=factor * standard.ramp_time),
        )
        for factor in _LENGTHENED
    ]
    length = abs(standard.goal - standard.start)
    places = [  # with one end at 0° two of them are the same
        ("backwards", standard._replace(start=standard.goal, goal=standard.start)),
        ("the same length, to 0°", standard._replace(start=length, goal=0.0)),
        ("the same length, from 0°", standard._replace(start=0.0, goal=length)),
    ]
    return [
        Assumption("ramp time of the trapezoid", f"{standard.ramp_time:g} s", _allowed(ramps, standard)),
        Assumption("duration of the move", f"{standard.duration:g} s", _allowed(durations, standard)),
        Assumption(
            "where the move leads",
            f"{degrees(standard.start)} to {degrees(standard.goal)}",
            _allowed(places, standard),
        ),
    ]


def _of_the_arm(standard: MoveShape) -> list[Assumption]:
    def of_arm(label: str, *, unknown: bool = False, **arm: float) -> Alternative:
        return Alternative(label, standard, arm, unknown)

    friction, damping = _TABLE_1.coulomb_friction, _TABLE_1.belt_damping_ratio
    return [
        Assumption(
            "how the arm folds",
            "as printed",
            [Alternative("full two-link arm", standard, changes={"model": "lagrangian"})],
        ),
        Assumption(
            "M2(90°)",
            f"{_TABLE_1.arm_inertia + _TABLE_1.arm_inertia_swing:.2f} kg m²",
            [
                of_arm("M2(90°) 0.04 kg m²", arm_inertia_swing=0.03),
                of_arm("M2(90°) 0.10 kg m²", arm_inertia_swing=0.09),
                of_arm("payload 0.2 kg: 0.12 kg m²", payload_mass=0.2),
                of_arm("M2(90°) 0.05, taken for 0.07", unknown=True, arm_inertia_swing=0.04),
                of_arm("M2(90°) 0.09, taken for 0.07", unknown=True, arm_inertia_swing=0.08),
            ],
        ),
        Assumption(
            "Coulomb friction",
            f"{friction:g} N m, set-valued: the motor sticks",
            [
                of_arm("no Coulomb friction", coulomb_friction=0.0),
                of_arm("Coulomb friction × 0.7", coulomb_friction=0.7 * friction),
                of_arm("Coulomb friction of Table 1", coulomb_friction=friction),
                of_arm("Coulomb friction × 1.3", coulomb_friction=1.3 * friction),
            ],
        ),
        Assumption(
            "belt damping ratio",
            f"ζ = {damping:g} at 90°",
            [of_arm(f"belt damping ζ = {ratio:g}", belt_damping_ratio=ratio) for ratio in (0.0, 0.005, damping, 0.05)],
        ),
        Assumption(
            "torque limit",
            f"{_TABLE_1.torque_limit:g} N m",
            [of_arm(f"torque limit {limit:g} N m", torque_limit=limit) for limit in (0.12, 0.10, 0.08)],
        ),
        Assumption(
            "length l3 of the hand",
            f"{_TABLE_1.hand_length:.2f} m",
            [of_arm("hand 0 m", hand_length=0.0), of_arm("hand 0.20 m", hand_length=0.20)],
        ),
    ]


def _of_the_servo(standard: MoveShape) -> list[Assumption]:
    def of_servo(label: str, **changes: Any) -> Alternative:
        return Alternative(label, standard, changes=changes)

    return [
        Assumption(
            "sign of the friction compensation",
            "that of the reference speed",
            [
                of_servo("compensated by measured speed", friction_sign="measured"),
                of_servo("friction not compensated", friction_sign="none"),
            ],
        ),
        Assumption(
            "torsional velocity",
            "simulated from encoder data",
            [of_servo("torsion measured exactly", true_torsion=True)],
        ),
        Assumption(
            "encoder",
            f"{ENCODER_COUNTS} counts per revolution",
            [
                of_servo("encoder 1000 counts", encoder_counts=1000),
                of_servo("encoder 100 000 counts", encoder_counts=100_000),
            ],
        ),
    ]


def _allowed(named: list[tuple[str, MoveShape]], standard: MoveShape) -> list[Alternative]:
    """Alternative moves that the environment allows, without the standard one and without repetitions."""
    alternatives: list[Alternative] = []
    for name, move in named:
        others = (standard, *(alternative.move for alternative in alternatives))
        if is_allowed(move) and not any(np.allclose(move, other) for other in others):
            alternatives.append(Alternative(name, move))
    return alternatives


def try_alternatives(assumptions: list[Assumption], base: Conditions, gains: ServoGains) -> dict[str, Suppression]:
    """Run every alternative under the conditions `base`, else unchanged; by its label."""
    grouped: dict[Conditions, list[Alternative]] = {}
    for alternative in (alternative for assumption in assumptions for alternative in assumption.alternatives):
        grouped.setdefault(alternative.under(base), []).append(alternative)
    found: dict[str, Suppression] = {}
    for conditions, group in grouped.items():
        together = suppression(conditions, gains, [alternative.move for alternative in group])
        found |= {alternative.label: together.one(k) for k, alternative in enumerate(group)}
    return found
