"""The paper's figures and its claim: does feedback of the torsional velocity remove the ringing of the tip?

Motion of motor and tip with and without vibration feedback (Figs. 4b and 8b), root loci (Fig. 6), damping over K4 and
M2, alternatives to everything that the paper does not print, random moves, and drives that are not ideal.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

import numpy as np

from baselines.tools.options import Groups
from baselines.tools.progress import progress_over
from beltarm_env.arrays import Floats
from beltarm_env.task.reference import MoveShape
from beltarm_env.task.seeds import PAPER_DRIVES, PAPER_MOVES, SeedRange
from eval.studies._frame import StudyOptions
from eval.studies.paper import runs
from eval.studies.paper.linear import ServoGains, linear_numbers
from eval.studies.paper.pictures import pictures
from eval.studies.paper.runs import BOTH_ARMS, MAIN, PHASES, REDUCED, REMOVED, STANDARD, TO_0, VIEWS
from eval.studies.paper.tables import tables
from eval.studies.paper.variations import (
    USUAL_MOVE,
    Alternative,
    compare,
    list_alternatives,
    run_drives,
    try_alternatives,
)

__all__ = ["QUICK", "Options", "measure", "pictures", "tables"]
QUICK = {"draws": 1, "moves": 8}

_SAME = 1e-6  # relative difference below which a value changes nothing; actions are rounded to float32
_TABLE_2 = ServoGains()


@dataclass(frozen=True)
class Options(StudyOptions):
    """Options of the study."""

    groups: ClassVar[Groups] = {
        "basic": ("out", "quick", "draws", "moves"),
        "gain": ("k4", "natural_frequency", "damping"),
        "move": (),
    }
    bounds: ClassVar[Mapping[str, tuple[int, int | None]]] = {
        "draws": (1, PAPER_DRIVES.size),
        "moves": (1, PAPER_MOVES.size),
    }

    draws: int = 24
    """Drives with each effect."""
    moves: int = PAPER_MOVES.size
    """Random moves."""
    k4: float = _TABLE_2.k4
    """Gain K4 of the torsional velocity [N m s/rad], 0 to 1. Table 2 of the paper has 0.15."""
    natural_frequency: float = _TABLE_2.natural_frequency
    """Natural frequency omega_n of the position loop [rad/s], 0.1 to 100. Table 2 has 5."""
    damping: float = _TABLE_2.damping
    """Damping ratio xi of the position loop, 0.05 to 20. Table 2 has 2."""
    start_deg: float = math.degrees(USUAL_MOVE.start)
    """Joint angle at which the move starts [degrees], 0 to 90."""
    goal_deg: float = math.degrees(USUAL_MOVE.goal)
    """Joint angle at which the move ends [degrees], 0 to 90. The paper places its poles at 90."""
    duration: float = USUAL_MOVE.duration
    """Duration of the move [s]."""
    ramp_time: float = USUAL_MOVE.ramp_time
    """Duration of each ramp of the move [s]."""

    @property
    def gains(self) -> ServoGains:
        """The gains.

        Raises:
            ValueError: If one is out of range, naming it.
        """
        return ServoGains(self.k4, self.natural_frequency, self.damping)

    @property
    def move(self) -> MoveShape:
        """The standard move.

        Raises:
            ValueError: If an angle is out of range or the move is not feasible, naming the value and what would do.
        """
        for name, angle in (("--start-deg", self.start_deg), ("--goal-deg", self.goal_deg)):
            if not 0 <= angle <= 90:
                raise ValueError(f"{name} must lie within 0 and 90 degrees, got {angle:g}")
        move = MoveShape(math.radians(self.start_deg), math.radians(self.goal_deg), self.duration, self.ramp_time)
        runs.check_move(move)
        return move


def measure(options: Options) -> dict[str, Any]:
    """Everything that pictures, tables and sentences show.

    Raises:
        ValueError: If a gain, an angle or the move is not allowed.
    """
    gains, move = options.gains, options.move
    places = {STANDARD: move, TO_0: move._replace(start=abs(move.goal - move.start), goal=0.0)}
    random_moves = SeedRange(PAPER_MOVES.first, options.moves)
    scenes, signals = run_scenes(gains, places)
    usual = {scene["view"]: scene["phases"] for scene in scenes if scene["place"] == STANDARD}
    return {
        "gains": asdict(gains),
        "move": move._asdict(),
        "usual": gains == _TABLE_2 and move == USUAL_MOVE,
        "bounds": {"removed": REMOVED, "reduced": REDUCED, "window": runs.END_WINDOW},
        "random_moves": random_moves._asdict(),
        "drawn_drives": {"first": PAPER_DRIVES.first, "size": options.draws},
        "scenes": scenes,
        "signals": signals,
        "alternatives": vary(list_alternatives(move), gains, usual),
        "sweep": sweep(gains, move),
        "random": {view: random(runs.suppression(under, gains, random_moves)) for view, under in BOTH_ARMS.items()},
        "linear": linear_numbers(gains),
        "drives": on_drives(gains, places, options.draws),
    }


def run_scenes(gains: ServoGains, places: Mapping[str, MoveShape]) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Run moves, by place, under each of `VIEWS`: numbers of each, and signals over time of some."""
    scenes, signals = [], {}
    for view, conditions in progress_over("conditions", list(VIEWS.items())):
        pair = [runs.run_moves(conditions, each, list(places.values())) for each in gains.without_and_with]
        ringing = np.array([runs.ringing_of(run) for run in pair])
        for k, (place, move) in enumerate(places.items()):
            shown = [runs.signals_of(run, k) for run in pair]
            numbers = {"place": place, "view": view, "move": move._asdict(), **ringing_numbers(ringing[:, :, k])}
            scenes.append({**numbers, "motions": [runs.summary(each) for each in shown]})
            if names := runs.SIGNALS.get((place, view)):
                without, suppressed = ({name: thinned(each[name], 3) for name in each} for each in shown)
                references = [f"{name}_reference" for name in names if f"{name}_reference" in without]
                signals[f"{place}, {view}"] = {
                    **{name: without[name] for name in ("time", *references)},
                    "without": {name: without[name] for name in names},
                    "suppressed": {name: suppressed[name] for name in names},
                }
    return sorted(scenes, key=lambda scene: list(places).index(scene["place"])), signals


def ringing_numbers(pair: Floats) -> dict[str, Any]:
    """Ringing of a move without and with vibration feedback, its ratios, the answer, and where the arm left.

    Args:
        pair: Shape (2, len(PHASES)).
    """
    ratios = dict(zip(PHASES, runs.ratios(pair), strict=True))
    return {
        "phases": [dict(zip(PHASES, phases, strict=True)) for phases in pair],
        "ratios": ratios,
        "answer": runs.answer(ratios["end"]),
        "left": np.isinf(pair[:, 1]).tolist(),
    }


def thinned(values: Floats, every: int) -> list[float]:
    """Values for a picture: fewer samples and digits than there are."""
    return [float(f"{value:.4g}") for value in values[::every]]


def vary(alternatives: list[Alternative], gains: ServoGains, usual: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Ringing for every alternative under both main conditions, and whether it differs from the standard move's."""
    by_view = {view: try_alternatives(alternatives, base, gains) for view, base in MAIN.items()}
    rows = []
    for alternative in alternatives:
        views = {}
        for view, results in by_view.items():
            numbers = ringing_numbers(results[alternative.label])
            own, other = ([list(phases.values()) for phases in each] for each in (numbers.pop("phases"), usual[view]))
            views[view] = {**numbers, "same": np.allclose(own, other, rtol=_SAME, atol=0, equal_nan=True)}
        names = {key: getattr(alternative, key) for key in ("assumption", "chosen", "label")}
        rows.append({**names, "views": views})
    return rows


def sweep(gains: ServoGains, move: MoveShape) -> dict[str, Any]:
    """Ringing after the stop over the ramp time of the standard move."""
    moves = [move._replace(ramp_time=float(ramp)) for ramp in np.linspace(0.05, 0.5, 33) * move.duration]
    moves = [each for each in moves if runs.is_allowed(each)]
    return {
        "ramp_times": [each.ramp_time for each in moves],
        "views": {view: runs.suppression(conditions, gains, moves)[:, 1] for view, conditions in MAIN.items()},
    }


def random(pair: Floats) -> dict[str, Any]:
    """Shares of random moves by their ratios of ringing in each phase, and on how many the arm left its workspace.

    Moves on which the arm leaves its workspace with vibration feedback alone count as increased.

    Args:
        pair: Ringing without and with vibration feedback, shape (2, len(PHASES), n).
    """
    phases = {}
    for phase, ratios in zip(PHASES, runs.ratios(pair), strict=True):
        known = np.sort(ratios[~np.isnan(ratios)])
        kinds = {"removed": known < REMOVED, "reduced": known < REDUCED, "increased": known > 1 / REDUCED}
        median = float(np.quantile(known, 0.5, method="inverted_cdf")) if len(known) else math.nan
        shares = {kind: np.mean(chosen) if len(known) else math.nan for kind, chosen in kinds.items()}
        phases[phase] = {**shares, "median": median, "median_left": math.isinf(median), "ratios": known}
    return {"phases": phases, "left": np.isinf(pair[:, 1]).sum(axis=1)}


def on_drives(gains: ServoGains, places: Mapping[str, MoveShape], draws: int) -> list[dict[str, Any]]:
    """Motion and ringing on all drives, by place and conditions."""
    rows = []
    for view, conditions in progress_over("drives", list(MAIN.items())):
        pair = run_drives(gains, list(places.values()), conditions, draws)
        for (place, move), drives in zip(places.items(), compare(pair, draws), strict=True):
            rows.append({"place": place, "view": view, "move": move._asdict(), "drives": drives})
    return sorted(rows, key=lambda row: list(places).index(row["place"]))
