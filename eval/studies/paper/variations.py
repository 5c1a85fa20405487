"""Conditions that the paper's conclusion is tried with: other values of what it does not print, and real drives.

The servo takes every drive for ideal. Effects of a drive are at the upper ends of their training ranges; phases,
orders, Stribeck speeds and the signs of the torque constant's error and of the drift are drawn, so that there are
several drives with each effect.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from beltarm_env import ArmParams
from beltarm_env.arm import COLUMN, FIELDS
from beltarm_env.arrays import Floats
from beltarm_env.rollout import Recording
from beltarm_env.task.ranges import DRIVE_RANGES
from beltarm_env.task.reference import MoveShape
from beltarm_env.task.seeds import PAPER_DRIVES
from beltarm_env.task.sensors import ENCODER_COUNTS
from eval.studies._arms import drawn
from eval.studies._effects import EFFECTS, IDEAL, with_effect
from eval.studies.paper.linear import TABLE_2
from eval.studies.paper.runs import (
    PHASES,
    PLACES,
    STANDARD,
    Conditions,
    answer,
    ratios,
    ringing_of,
    run_moves,
    suppression,
)

_USUAL, _TABLE_1 = PLACES[STANDARD], ArmParams()


@dataclass(frozen=True, slots=True)
class Alternative:
    """Another value of one assumption; docs/results/paper says why the usual one is chosen."""

    assumption: str
    chosen: str
    label: str
    changes: Mapping[str, Any]  # of `MoveShape`, `ArmParams` or `Conditions`; and whether the controller is `told`

    @property
    def move(self) -> MoveShape:
        """The standard move with this value."""
        return _USUAL._replace(**self._of(MoveShape._fields))

    def under(self, base: Conditions) -> Conditions:
        """Conditions with this value, all others as in `base`; unless `told`, the controller believes in that arm."""
        arm, others = self._of(FIELDS), self._of(Conditions.__dataclass_fields__)
        known = base.known if self.changes.get("told", True) else base.arm
        return replace(base, arm=replace(base.arm, **arm), known=known, **others)

    def _of(self, names: Iterable[str]) -> dict[str, Any]:
        return {name: self.changes[name] for name in names if name in self.changes}


_FRICTION, _DAMPING = _TABLE_1.coulomb_friction, _TABLE_1.belt_damping_ratio
_LONGER = {0.8: "move of 0.64 s", 1.25: "move of 1 s", 1.5: "move of 1.2 s"}
_TRIED: dict[tuple[str, str], dict[str, dict[str, Any]]] = {
    ("ramp time of the trapezoid", "0.12 s"): {
        f"ramps of {ramp:g} s": {"ramp_time": ramp} for ramp in (0.08, 0.10, 0.16, 0.20, 0.25, 0.30)
    },
    ("duration of the move", "0.8 s"): {
        label: {"duration": factor * _USUAL.duration, "ramp_time": factor * _USUAL.ramp_time}
        for factor, label in _LONGER.items()
    },
    ("where the move leads", "45° to 90°"): {
        "backwards": {"start": _USUAL.goal, "goal": _USUAL.start},
        "the same length, to 0°": {"start": np.pi / 4, "goal": 0.0},
        "the same length, from 0°": {"start": 0.0, "goal": np.pi / 4},
    },
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
ALTERNATIVES = [Alternative(*assumption, *tried) for assumption, of_it in _TRIED.items() for tried in of_it.items()]
"""Other values of everything assumed, one at a time around the standard move."""


def try_alternatives(alternatives: Sequence[Alternative], base: Conditions) -> dict[str, Floats]:
    """Ringing by the label of the alternative, shape (2, len(PHASES)); equal conditions are run side by side."""
    grouped: dict[Conditions, list[Alternative]] = {}
    for alternative in alternatives:
        grouped.setdefault(alternative.under(base), []).append(alternative)
    results: dict[str, Floats] = {}
    for conditions, group in grouped.items():
        ringing = suppression(conditions, [alternative.move for alternative in group])
        results |= {alternative.label: ringing[:, :, k] for k, alternative in enumerate(group)}
    return results


DRIVES = (IDEAL, *EFFECTS)
"""Drives by name: ideal, with one effect, with all of them."""


def run_drives(moves: list[MoveShape], conditions: Conditions, draws: int) -> list[Recording]:
    """Run moves on `draws` drives of each kind.

    Returns:
        A recording without and one with vibration feedback: for each move all `DRIVES` one after the other, for each
        drive `draws` episodes.
    """
    table = np.tile(conditions.arm.row(), (draws, 1))
    columns = [getattr(COLUMN, name) for name in FIELDS if name in DRIVE_RANGES]
    table[:, columns] = drawn(draws, PAPER_DRIVES.first, DRIVE_RANGES).params_table[:, columns]
    arms = np.concatenate([with_effect(table, drive, 1.0) for _ in moves for drive in DRIVES])
    shapes = [move for move in moves for _ in range(len(DRIVES) * draws)]
    return [run_moves(conditions, gains, shapes, arms) for gains in TABLE_2.without_and_with]


def compare(runs: list[Recording], draws: int) -> list[list[dict[str, Any]]]:
    """Ringing without and with vibration feedback: for each move a row for each of `DRIVES`."""
    ringing = np.array([ringing_of(run) for run in runs]).reshape(2, len(PHASES), -1, len(DRIVES), draws)
    return [[_row(drive, ringing[:, :, move, k]) for k, drive in enumerate(DRIVES)] for move in range(ringing.shape[2])]


def _row(drive: str, ringing: Floats) -> dict[str, Any]:
    """Numbers of one drive, from its ringing, shape (2, len(PHASES), draws)."""
    _, stop, end = ratios(ringing)
    return {
        "drive": drive,
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
