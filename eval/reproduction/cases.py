"""What the paper does not print, what is taken instead, and the range over which its conclusion is tried."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from beltarm_env import ArmParams
from beltarm_env.task.reference import MoveShape
from eval.reproduction.effects import Compared, compare
from eval.reproduction.loop import ServoGains
from eval.reproduction.runs import Assumptions, is_allowed
from eval.reproduction.words import degrees

USUAL_MOVE = MoveShape(np.pi / 4, np.pi / 2, 0.8, 0.12)
"""The standard move where no other is asked for."""
_RAMP_TIMES = (0.08, 0.10, 0.16, 0.20, 0.25, 0.30)
_LENGTHENED = (0.8, 1.25, 1.5)
_TABLE_1 = ArmParams()


@dataclass(frozen=True, slots=True)
class Variant:
    """One value of an assumption."""

    label: str
    move: MoveShape
    arm: Mapping[str, float] = field(default_factory=dict)  # what differs of `ArmParams`
    unknown: bool = False  # whether it does so unknown to the controller
    changes: Mapping[str, Any] = field(default_factory=dict)  # what else differs of `Assumptions`

    def under(self, base: Assumptions) -> Assumptions:
        """Assumptions with this value, all others as in `base`."""
        known = base.arm if self.unknown else base.known
        return replace(base, arm=replace(base.arm, **self.arm), known=known, **self.changes)


@dataclass(frozen=True, slots=True)
class Open:
    """One thing that the paper leaves open, with values to try beside the one taken."""

    name: str
    printed: str  # what the paper says about it
    taken: str
    why: str
    variants: list[Variant]


def open_questions(standard: MoveShape) -> list[Open]:
    """Everything assumed, varied one at a time around the standard move."""
    return [*_of_the_move(standard), *_of_the_arm(standard), *_of_the_servo(standard)]


def _of_the_move(standard: MoveShape) -> list[Open]:
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
        Open(
            "ramp time of the trapezoid",
            "a trapezoid, no times",
            f"{standard.ramp_time:g} s",
            _reason(standard, "ramp_time", "short against the belt's period, as its visible ringing suggests"),
            _allowed(ramps, standard),
        ),
        Open(
            "duration of the move",
            "nothing",
            f"{standard.duration:g} s",
            _reason(standard, "duration", "two periods of cruise, three after the stop"),
            _allowed(durations, standard),
        ),
        Open(
            "where the move leads",
            "poles are placed for 90°",
            f"{degrees(standard.start)} to {degrees(standard.goal)}",
            _reason(standard, "goal", "it ends at the angle analysed"),
            _allowed(places, standard),
        ),
    ]


def _of_the_arm(standard: MoveShape) -> list[Open]:
    def of_arm(label: str, *, unknown: bool = False, **arm: float) -> Variant:
        return Variant(label, standard, arm, unknown)

    friction, damping = _TABLE_1.coulomb_friction, _TABLE_1.belt_damping_ratio
    return [
        Open(
            "how the arm folds",
            "two masses, all of the arm on one axis",
            "as printed",
            "the paper's plant; docs/physics.md derives the full one",
            [Variant("full two-link arm", standard, changes={"model": "lagrangian"})],
        ),
        Open(
            "M2(90°)",
            "M2(0°) = 0.01 kg m² only",
            "0.07 kg m²",
            "link 2 as a uniform rod with M2(0°) has 0.48 kg",
            [
                of_arm("M2(90°) 0.04 kg m²", arm_inertia_swing=0.03),
                of_arm("M2(90°) 0.10 kg m²", arm_inertia_swing=0.09),
                of_arm("payload 0.2 kg: 0.12 kg m²", payload_mass=0.2),
                of_arm("M2(90°) 0.05, taken for 0.07", unknown=True, arm_inertia_swing=0.04),
                of_arm("M2(90°) 0.09, taken for 0.07", unknown=True, arm_inertia_swing=0.08),
            ],
        ),
        Open(
            "Coulomb friction",
            "0.032 N m; neglected in the analysis",
            "0.032 N m, set-valued: the motor sticks",
            "Table 1",
            [
                of_arm("no Coulomb friction", coulomb_friction=0.0),
                of_arm("Coulomb friction × 0.7", coulomb_friction=0.7 * friction),
                of_arm("Coulomb friction of Table 1", coulomb_friction=friction),
                of_arm("Coulomb friction × 1.3", coulomb_friction=1.3 * friction),
            ],
        ),
        Open(
            "belt damping ratio",
            "none in the model",
            f"ζ = {damping:g} at 90°",
            "belts have 0.005 to 0.05",
            [of_arm(f"belt damping ζ = {ratio:g}", belt_damping_ratio=ratio) for ratio in (0.0, 0.005, damping, 0.05)],
        ),
        Open(
            "torque limit",
            "nothing",
            f"{_TABLE_1.torque_limit:g} N m",
            "a rigid 0° to 90° in 0.7 s needs 0.256 N m with ramps of 15 % of it, 0.223 N m with 25 to 35 %",
            [of_arm(f"torque limit {limit:g} N m", torque_limit=limit) for limit in (0.12, 0.10, 0.08)],
        ),
        Open(
            "length l3 of the hand",
            "nothing",
            "0.10 m",
            "a plausible gripper",
            [of_arm("hand 0 m", hand_length=0.0), of_arm("hand 0.20 m", hand_length=0.20)],
        ),
    ]


def _of_the_servo(standard: MoveShape) -> list[Open]:
    def of_servo(label: str, **changes: Any) -> Variant:
        return Variant(label, standard, changes=changes)

    return [
        Open(
            "sign of the friction compensation",
            "no law",
            "that of the reference speed",
            "known without noise",
            [
                of_servo("compensated by measured speed", friction_sign="measured"),
                of_servo("friction not compensated", friction_sign="none"),
            ],
        ),
        Open(
            "torsional velocity",
            "from a simulation of the arm",
            "simulated from encoder data",
            "as printed",
            [of_servo("torsion measured exactly", true_torsion=True)],
        ),
        Open(
            "encoder",
            "a rotary encoder",
            "4000 counts per revolution",
            "1000 lines, four edges each",
            [
                of_servo("encoder 1000 counts", encoder_counts=1000),
                of_servo("encoder 100 000 counts", encoder_counts=100_000),
            ],
        ),
    ]


def _reason(standard: MoveShape, name: str, usual: str) -> str:
    """Why a value of the standard move is what it is."""
    return usual if np.isclose(getattr(standard, name), getattr(USUAL_MOVE, name)) else "as asked for"


def _allowed(named: list[tuple[str, MoveShape]], standard: MoveShape) -> list[Variant]:
    """Variants of the move that the environment allows, none of them the standard one, and none twice."""
    variants: list[Variant] = []
    for name, move in named:
        if is_allowed(move) and not any(np.allclose(move, other) for other in (standard, *(v.move for v in variants))):
            variants.append(Variant(name, move))
    return variants


def run_all(questions: list[Open], base: Assumptions, gains: ServoGains) -> dict[str, Compared]:
    """Run every variant that differs from the assumptions `base`; by its label."""
    variants = [variant for question in questions for variant in question.variants]
    grouped: dict[Assumptions, list[Variant]] = {}
    for variant in variants:
        grouped.setdefault(variant.under(base), []).append(variant)
    found: dict[str, Compared] = {}
    for assumed, group in grouped.items():
        compared = compare(assumed, gains, [variant.move for variant in group])
        found |= {variant.label: compared.one(k) for k, variant in enumerate(group)}
    return found
