"""The paper's figures and its claim: does feedback of the torsional velocity remove the ringing of the tip?

Motion of motor and tip with and without vibration feedback (Figs. 4b and 8b), root loci (Fig. 6), damping over K4 and
M2, alternatives to everything that the paper does not print, random moves, and drives that are not ideal. The servo
takes every drive for ideal. Effects of a drive are at the upper ends of their training ranges; phases, orders, Stribeck
speeds and the signs of the torque constant's error and of the drift are drawn, so that there are several drives with
each effect.
"""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from baselines.tools.progress import progress_over
from beltarm_env import ArmParams
from beltarm_env.arm import COLUMN, FIELDS
from beltarm_env.arrays import Floats
from beltarm_env.rollout import Recording
from beltarm_env.task.ranges import DRIVE_RANGES
from beltarm_env.task.reference import MoveShape
from beltarm_env.task.seeds import PAPER_DRIVES, PAPER_MOVES, SeedRange
from beltarm_env.task.sensors import ENCODER_COUNTS
from eval.studies._arms import EFFECTS, IDEAL, drawn, with_effect
from eval.studies._frame import Bounds, StudyOptions
from eval.studies.paper import runs
from eval.studies.paper.linear import TABLE_2, linear_numbers
from eval.studies.paper.page import pictures, tables

__all__ = ["QUICK", "Options", "measure", "pictures", "tables"]
QUICK = {"draws": 1, "moves": 8}

_SAME = 1e-6  # relative difference below which a value changes nothing; actions are rounded to float32


@dataclass(frozen=True)
class Options(StudyOptions):
    """Options of the study."""

    bounds = Bounds(draws=(1, PAPER_DRIVES.size), moves=(1, PAPER_MOVES.size))

    draws: int = 24
    """Drives with each effect."""
    moves: int = PAPER_MOVES.size
    """Random moves."""


def measure(options: Options) -> dict[str, Any]:
    """Everything that pictures, tables and sentences show."""
    random_moves = SeedRange(PAPER_MOVES.first, options.moves)
    scenes, signals = run_scenes()
    usual = {scene["view"]: scene["phases"] for scene in scenes if scene["place"] == runs.STANDARD}
    return {
        "gains": asdict(TABLE_2),
        "move": runs.PLACES[runs.STANDARD]._asdict(),
        "bounds": {"removed": runs.REMOVED, "reduced": runs.REDUCED, "window": runs.END_WINDOW},
        "random_moves": random_moves._asdict(),
        "drawn_drives": {"first": PAPER_DRIVES.first, "size": options.draws},
        "scenes": scenes,
        "signals": signals,
        "alternatives": vary(usual),
        "random": {view: random(runs.suppression(under, random_moves)) for view, under in runs.BOTH_ARMS.items()},
        "linear": linear_numbers(TABLE_2),
        "drives": on_drives(options.draws),
    }


def run_scenes() -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Run the moves of `PLACES` under each of `VIEWS`: numbers of each, and signals over time of some."""
    scenes, signals = [], {}
    for view, conditions in progress_over("conditions", list(runs.VIEWS.items())):
        pair = [runs.run_moves(conditions, gains, list(runs.PLACES.values())) for gains in TABLE_2.without_and_with]
        ringing = np.array([runs.ringing_of(run) for run in pair])
        for k, (place, move) in enumerate(runs.PLACES.items()):
            shown = [runs.signals_of(run, k) for run in pair]
            numbers = {"place": place, "view": view, "move": move._asdict(), **ringing_numbers(ringing[:, :, k])}
            scenes.append({**numbers, "motions": [runs.summary(each) for each in shown]})
            if names := runs.SIGNALS.get((place, view)):
                without, suppressed = (  # fewer samples and digits than there are, for a picture
                    {name: [float(f"{value:.4g}") for value in each[name][::3]] for name in each} for each in shown
                )
                references = [f"{name}_reference" for name in names if f"{name}_reference" in without]
                signals[f"{place}, {view}"] = {
                    **{name: without[name] for name in ("time", *references)},
                    "without": {name: without[name] for name in names},
                    "suppressed": {name: suppressed[name] for name in names},
                }
    return sorted(scenes, key=lambda scene: list(runs.PLACES).index(scene["place"])), signals


def ringing_numbers(pair: Floats) -> dict[str, Any]:
    """Ringing of a move without and with feedback, (2, len(PHASES)), its ratios, the answer, and where the arm left."""
    left = dict(zip(runs.PHASES, runs.ratios(pair), strict=True))
    return {
        "phases": [dict(zip(runs.PHASES, phases, strict=True)) for phases in pair],
        "ratios": left,
        "answer": runs.answer(left["end"]),
        "left": np.isinf(pair[:, 1]).tolist(),
    }


def vary(usual: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Ringing for every alternative under both main conditions, and whether it differs from the standard move's."""
    by_view = {view: try_alternatives(ALTERNATIVES, base) for view, base in runs.MAIN.items()}
    rows = []
    for alternative in ALTERNATIVES:
        views = {}
        for view, results in by_view.items():
            numbers = ringing_numbers(results[alternative.label])
            own, other = ([list(phases.values()) for phases in each] for each in (numbers.pop("phases"), usual[view]))
            views[view] = {**numbers, "same": np.allclose(own, other, rtol=_SAME, atol=0, equal_nan=True)}
        names = {key: getattr(alternative, key) for key in ("assumption", "chosen", "label")}
        rows.append({**names, "views": views})
    return rows


def random(pair: Floats) -> dict[str, Any]:
    """Shares of random moves by their ratios of ringing in each phase, and on how many the arm left its workspace.

    `pair` is the ringing without and with vibration feedback, shape (2, len(PHASES), n). Moves on which the arm leaves
    its workspace with vibration feedback alone count as increased.
    """
    phases = {}
    for phase, values in zip(runs.PHASES, runs.ratios(pair), strict=True):
        known = np.sort(values[~np.isnan(values)])
        kinds = {"removed": known < runs.REMOVED, "reduced": known < runs.REDUCED}
        kinds["increased"] = known > 1 / runs.REDUCED
        median = float(np.quantile(known, 0.5, method="inverted_cdf")) if len(known) else math.nan
        shares = {kind: np.mean(chosen) if len(known) else math.nan for kind, chosen in kinds.items()}
        phases[phase] = {**shares, "median": median, "median_left": math.isinf(median), "ratios": known}
    return {"phases": phases, "left": np.isinf(pair[:, 1]).sum(axis=1)}


def on_drives(draws: int) -> list[dict[str, Any]]:
    """Ringing on all drives, by place and conditions."""
    rows = []
    for view, conditions in progress_over("drives", list(runs.MAIN.items())):
        pair = run_drives(list(runs.PLACES.values()), conditions, draws)
        for (place, move), drives in zip(runs.PLACES.items(), compare(pair, draws), strict=True):
            rows.append({"place": place, "view": view, "move": move._asdict(), "drives": drives})
    return sorted(rows, key=lambda row: list(runs.PLACES).index(row["place"]))


# Other values of what the paper does not print, and real drives

_USUAL, _TABLE_1 = runs.PLACES[runs.STANDARD], ArmParams()


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

    def under(self, base: runs.Conditions) -> runs.Conditions:
        """Conditions with this value, all others as in `base`; unless `told`, the controller believes in that arm."""
        arm, others = self._of(FIELDS), self._of(runs.Conditions.__dataclass_fields__)
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


def try_alternatives(alternatives: Sequence[Alternative], base: runs.Conditions) -> dict[str, Floats]:
    """Ringing by the label of the alternative, shape (2, len(PHASES)); equal conditions are run side by side."""
    grouped: dict[runs.Conditions, list[Alternative]] = {}
    for alternative in alternatives:
        grouped.setdefault(alternative.under(base), []).append(alternative)
    results: dict[str, Floats] = {}
    for conditions, group in grouped.items():
        ringing = runs.suppression(conditions, [alternative.move for alternative in group])
        results |= {alternative.label: ringing[:, :, k] for k, alternative in enumerate(group)}
    return results


DRIVES = (IDEAL, *EFFECTS)
"""Drives by name: ideal, with one effect, with all of them."""


def run_drives(moves: list[MoveShape], conditions: runs.Conditions, draws: int) -> list[Recording]:
    """Run moves on `draws` drives of each kind, without and with vibration feedback.

    A recording has for each move all `DRIVES` one after the other, for each drive `draws` episodes.
    """
    table = np.tile(conditions.arm.row(), (draws, 1))
    columns = [getattr(COLUMN, name) for name in FIELDS if name in DRIVE_RANGES]
    table[:, columns] = drawn(draws, PAPER_DRIVES.first, DRIVE_RANGES).params_table[:, columns]
    arms = np.concatenate([with_effect(table, drive, 1.0) for _ in moves for drive in DRIVES])
    shapes = [move for move in moves for _ in range(len(DRIVES) * draws)]
    return [runs.run_moves(conditions, gains, shapes, arms) for gains in TABLE_2.without_and_with]


def compare(pair: list[Recording], draws: int) -> list[list[dict[str, Any]]]:
    """Ringing without and with vibration feedback: for each move a row for each of `DRIVES`."""
    ringing = np.array([runs.ringing_of(run) for run in pair]).reshape(2, len(runs.PHASES), -1, len(DRIVES), draws)
    return [[_row(drive, ringing[:, :, move, k]) for k, drive in enumerate(DRIVES)] for move in range(ringing.shape[2])]


def _row(drive: str, ringing: Floats) -> dict[str, Any]:
    """Numbers of one drive, from its ringing, shape (2, len(PHASES), draws)."""
    _, stop, end = runs.ratios(ringing)
    return {
        "drive": drive,
        "ringing": np.median(ringing[:, 1], axis=1),
        "stop": _spread(stop),
        "end": _spread(end),
        "answers": Counter(runs.answer(ratio) for ratio in end),
        "ratios": {"stop": stop, "end": end},
    }


def _spread(values: Floats) -> list[float]:
    """Median, smallest and largest ratio, without drives that have nothing to compare; empty if none has."""
    values = values[~np.isnan(values)]
    return [np.median(values), values.min(), values.max()] if len(values) else []
