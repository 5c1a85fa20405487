"""Conditions that the paper's conclusion is tried with: other values of what it does not print, and real drives.

The servo takes every drive for ideal. Effects of a drive are at the upper ends of their training ranges; phases,
orders, Stribeck speeds and the signs of the torque constant's error and of the drift are drawn, so that there are
several drives with each effect.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from beltarm_env import ArmParams, BeltArmVectorEnv
from beltarm_env.arm import COLUMN, FIELDS
from beltarm_env.arrays import Floats
from beltarm_env.rollout import Recording
from beltarm_env.task.ranges import DRIVE_RANGES
from beltarm_env.task.reference import MoveShape
from beltarm_env.task.seeds import PAPER_DRIVES
from beltarm_env.task.sensors import ENCODER_COUNTS
from eval.report.text import degrees
from eval.studies._effects import EFFECTS, IDEAL, with_effect
from eval.studies.paper.linear import ServoGains
from eval.studies.paper.runs import PHASES, Conditions, answer, is_allowed, ratios, ringing_of, run_moves, suppression

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


DRIVES = (IDEAL, *EFFECTS)
"""Drives by name: ideal, with one effect, with all of them."""


def run_drives(gains: ServoGains, moves: list[MoveShape], conditions: Conditions, draws: int) -> list[Recording]:
    """Run moves on `draws` drives of each kind.

    Returns:
        A recording without and one with vibration feedback: for each move all `DRIVES` one after the other, for each
        drive `draws` episodes.
    """
    env = BeltArmVectorEnv(draws, randomization=DRIVE_RANGES)
    env.reset(seed=PAPER_DRIVES.first)
    drawn = np.tile(conditions.arm.row(), (draws, 1))
    columns = [getattr(COLUMN, name) for name in FIELDS if name in DRIVE_RANGES]
    drawn[:, columns] = env.params_table[:, columns]
    arms = np.concatenate([with_effect(drawn, drive, 1.0) for _ in moves for drive in DRIVES])
    shapes = [move for move in moves for _ in range(len(DRIVES) * draws)]
    return [run_moves(conditions, each, shapes, arms) for each in gains.without_and_with]


def compare(runs: list[Recording], draws: int) -> list[list[dict[str, Any]]]:
    """Motion and ringing without and with vibration feedback: for each move a row for each of `DRIVES`."""
    motions = np.array([np.where(run.finished, run.metrics()["residual_pp_mm"], np.inf) for run in runs])
    motions = motions.reshape(2, -1, len(DRIVES), draws)
    ringing = np.array([ringing_of(run) for run in runs]).reshape(2, len(PHASES), *motions.shape[1:])
    return [
        [_row(drive, motions[:, k, j], ringing[:, :, k, j]) for j, drive in enumerate(DRIVES)]
        for k in range(motions.shape[1])
    ]


def _row(drive: str, motion: Floats, ringing: Floats) -> dict[str, Any]:
    """Numbers of one drive, from its motion, shape (2, draws), and its ringing, shape (2, len(PHASES), draws)."""
    _, stop, end = ratios(ringing)
    return {
        "drive": drive,
        "motion": np.median(motion, axis=1),
        "motion_ratio": _spread(ratios(motion)),
        "ringing": np.median(ringing[:, 1], axis=1),
        "stop": _spread(stop),
        "end": _spread(end),
        "answers": Counter(answer(ratio) for ratio in end),
        "ratios": {"stop": stop, "end": end},
    }


def _spread(values: Floats) -> list[float]:
    """Median, smallest and largest ratio, without drives that have nothing to compare; empty if none has."""
    values = values[~np.isnan(values)]
    return [np.median(values), values.min(), values.max()] if len(values) else []
