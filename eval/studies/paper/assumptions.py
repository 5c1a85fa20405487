"""Values that the paper does not print: those chosen, and the alternatives that its conclusion is tried with."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from beltarm_env import ArmParams
from beltarm_env.arm import FIELDS
from beltarm_env.arrays import Floats
from beltarm_env.task.reference import MoveShape
from beltarm_env.task.sensors import ENCODER_COUNTS
from eval.report.text import degrees
from eval.studies.paper.linear import ServoGains
from eval.studies.paper.runs import Conditions, is_allowed, suppression

USUAL_MOVE = MoveShape(np.pi / 4, np.pi / 2, 0.8, 0.12)
"""The standard move where no other is asked for."""
_TABLE_1 = ArmParams()


@dataclass(frozen=True, slots=True)
class Alternative:
    """Another value of one assumption; docs/results/paper says why the usual one is chosen."""

    assumption: str
    chosen: str
    label: str
    move: MoveShape
    changes: Mapping[str, Any] = field(default_factory=dict)  # of `ArmParams` or `Conditions`

    def under(self, base: Conditions) -> Conditions:
        """Conditions with this value, all others as in `base`; unless `told`, the controller believes in that arm."""
        arm = {name: value for name, value in self.changes.items() if name in FIELDS}
        others = {name: value for name, value in self.changes.items() if name not in (*arm, "told")}
        known = base.known if self.changes.get("told", True) else base.arm
        return replace(base, arm=replace(base.arm, **arm), known=known, **others)


_FRICTION, _DAMPING = _TABLE_1.coulomb_friction, _TABLE_1.belt_damping_ratio
_OF_ARM_AND_SERVO: dict[tuple[str, str], dict[str, dict[str, Any]]] = {
    ("how the arm folds", "as printed"): {"full two-link arm": {"model": "lagrangian"}},
    ("M2(90°)", f"{_TABLE_1.arm_inertia + _TABLE_1.arm_inertia_swing:.2f} kg m²"): {
        "M2(90°) 0.04 kg m²": {"arm_inertia_swing": 0.03},
        "M2(90°) 0.10 kg m²": {"arm_inertia_swing": 0.09},
        "payload 0.2 kg: 0.12 kg m²": {"payload_mass": 0.2},
        "M2(90°) 0.05, taken for 0.07": {"arm_inertia_swing": 0.04, "told": False},
        "M2(90°) 0.09, taken for 0.07": {"arm_inertia_swing": 0.08, "told": False},
    },
    ("Coulomb friction", f"{_FRICTION:g} N m, set-valued: the motor sticks"): {
        "no Coulomb friction": {"coulomb_friction": 0.0},
        "Coulomb friction × 0.7": {"coulomb_friction": 0.7 * _FRICTION},
        "Coulomb friction of Table 1": {"coulomb_friction": _FRICTION},
        "Coulomb friction × 1.3": {"coulomb_friction": 1.3 * _FRICTION},
    },
    ("belt damping ratio", f"ζ = {_DAMPING:g} at 90°"): {
        f"belt damping ζ = {ratio:g}": {"belt_damping_ratio": ratio} for ratio in (0.0, 0.005, _DAMPING, 0.05)
    },
    ("torque limit", f"{_TABLE_1.torque_limit:g} N m"): {
        f"torque limit {limit:g} N m": {"torque_limit": limit} for limit in (0.12, 0.10, 0.08)
    },
    ("length l3 of the hand", f"{_TABLE_1.hand_length:.2f} m"): {
        "hand 0 m": {"hand_length": 0.0},
        "hand 0.20 m": {"hand_length": 0.20},
    },
    ("sign of the friction compensation", "that of the reference speed"): {
        "compensated by measured speed": {"friction_sign": "measured"},
        "friction not compensated": {"friction_sign": "none"},
    },
    ("torsional velocity", "simulated from encoder data"): {"torsion measured exactly": {"true_torsion": True}},
    ("encoder", f"{ENCODER_COUNTS} counts per revolution"): {
        "encoder 1000 counts": {"encoder_counts": 1000},
        "encoder 100 000 counts": {"encoder_counts": 100_000},
    },
}
"""Changes of each `Alternative` by its label, for each assumption with the value chosen."""


def list_alternatives(standard: MoveShape) -> list[Alternative]:
    """Other values of everything assumed, one at a time around the standard move."""
    others = [
        Alternative(*assumption, label, standard, changes)
        for assumption, alternatives in _OF_ARM_AND_SERVO.items()
        for label, changes in alternatives.items()
    ]
    return [*_of_the_move(standard), *others]


def _of_the_move(standard: MoveShape) -> Iterator[Alternative]:
    """Alternative moves that the environment allows, without the standard one and without repetitions."""
    start, goal, duration, ramp_time = standard
    length = abs(goal - start)
    named = {
        ("ramp time of the trapezoid", f"{ramp_time:g} s"): {
            f"ramps of {ramp:g} s": standard._replace(ramp_time=ramp) for ramp in (0.08, 0.10, 0.16, 0.20, 0.25, 0.30)
        },
        ("duration of the move", f"{duration:g} s"): {
            f"move of {factor * duration:.3g} s": MoveShape(start, goal, factor * duration, factor * ramp_time)
            for factor in (0.8, 1.25, 1.5)
        },
        ("where the move leads", f"{degrees(start)} to {degrees(goal)}"): {
            "backwards": standard._replace(start=goal, goal=start),
            "the same length, to 0°": standard._replace(start=length, goal=0.0),
            "the same length, from 0°": standard._replace(start=0.0, goal=length),
        },
    }
    tried = [standard]
    for assumption, moves in named.items():
        for label, move in moves.items():
            if is_allowed(move) and not any(np.allclose(move, other) for other in tried):
                tried.append(move)
                yield Alternative(*assumption, label, move)


def try_alternatives(alternatives: list[Alternative], base: Conditions, gains: ServoGains) -> dict[str, Floats]:
    """Ringing by the label of the alternative, shape (2, len(PHASES)); equal conditions are run side by side."""
    grouped: dict[Conditions, list[Alternative]] = {}
    for alternative in alternatives:
        grouped.setdefault(alternative.under(base), []).append(alternative)
    results: dict[str, Floats] = {}
    for conditions, group in grouped.items():
        ringing = suppression(conditions, gains, [alternative.move for alternative in group])
        results |= {alternative.label: ringing[:, :, k] for k, alternative in enumerate(group)}
    return results
