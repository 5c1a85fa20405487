"""The paper's figures and its claim: does feedback of the torsional velocity remove the ringing of the tip?

Motion of motor and tip with and without vibration feedback (Figs. 4b and 8b), root loci (Fig. 6), damping over K4 and
M2, alternatives to everything that the paper does not print, random moves, and drives that are not ideal.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

import numpy as np

from baselines.tools.options import Groups
from baselines.tools.progress import progress_over
from beltarm_env.arrays import Floats
from beltarm_env.task.reference import MoveShape
from beltarm_env.task.seeds import PAPER_DRIVES, PAPER_MOVES, SeedRange
from eval.comparison.effects import ALL, IDEAL
from eval.studies._frame import StudyOptions
from eval.studies.paper.assumptions import USUAL_MOVE, Alternative, list_alternatives, try_alternatives
from eval.studies.paper.drives import DRIVES, compare, run_drives
from eval.studies.paper.linear import ServoGains, linear_numbers, without_and_with
from eval.studies.paper.pictures import pictures
from eval.studies.paper.responses import SIGNALS, Response, response
from eval.studies.paper.ringing import END_WINDOW, PHASES, REDUCED, REMOVED, Suppression, ringing_of, suppression
from eval.studies.paper.runs import BOTH_ARMS, FRICTION, MAIN, STANDARD, TO_0, VIEWS, check_move, is_allowed, run_moves
from eval.studies.paper.tables import tables

__all__ = ["QUICK", "Options", "measure", "pictures", "tables"]
QUICK = {"draws": 1, "moves": 8}

_SWEPT = 33  # ramp times
_SAME = 1e-6  # relative difference below which a value changes nothing; actions are rounded to float32
_EVERY = {"responses": 3, "swings": 8}  # samples between those that are kept for pictures
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
        check_move(move)
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
    drives, swings = on_drives(gains, places, options.draws)
    return {
        "gains": asdict(gains),
        "move": move._asdict(),
        "usual": gains == _TABLE_2 and move == USUAL_MOVE,
        "bounds": {"removed": REMOVED, "reduced": REDUCED, "window": END_WINDOW},
        "random_moves": random_moves._asdict(),
        "drawn_drives": {"first": PAPER_DRIVES.first, "size": options.draws},
        "scenes": scenes,
        "signals": signals,
        "alternatives": vary(list_alternatives(move), gains, usual),
        "sweep": sweep(gains, move),
        "random": {view: random(suppression(under, gains, random_moves)) for view, under in BOTH_ARMS.items()},
        "linear": linear_numbers(gains),
        "drives": drives,
        "swings": swings,
    }


def run_scenes(gains: ServoGains, places: Mapping[str, MoveShape]) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Run moves, by place, under each of `VIEWS`: numbers of each, and signals over time of some."""
    scenes, signals = [], {}
    for view, conditions in progress_over("conditions", list(VIEWS.items())):
        runs = [run_moves(conditions, g, list(places.values())) for g in without_and_with(gains)]
        both = Suppression(*map(ringing_of, runs))
        for k, (place, move) in enumerate(places.items()):
            ringing, shown = both.only(k), [response(run, k) for run in runs]
            numbers = {"place": place, "view": view, "move": move._asdict(), **ringing_numbers(ringing)}
            scenes.append({**numbers, "motions": [each.summary() for each in shown]})
            if (place, view) in SIGNALS:
                signals[f"{place}, {view}"] = over_time(SIGNALS[place, view], *shown)
    return sorted(scenes, key=lambda scene: list(places).index(scene["place"])), signals


def ringing_numbers(ringing: Suppression) -> dict[str, Any]:
    """Ringing of a move without and with vibration feedback, its ratios, the answer, and where the arm left."""
    return {
        "phases": [{phase: float(getattr(rung, phase)[0]) for phase in PHASES} for rung in ringing],
        "ratios": {phase: ringing.ratio(phase) for phase in PHASES},
        "answer": ringing.answer,
        "left": [bool(np.isinf(rung.stop[0])) for rung in ringing],
    }


def over_time(names: Iterable[str], without: Response, suppressed: Response) -> dict[str, Any]:
    """Signals for a picture, by name, and those of a rigid arm on the reference, where there are any."""
    every = _EVERY["responses"]
    references = [f"{name}_reference" for name in names if "lateral" not in name]
    return {
        "time": thinned(without.time, every),
        **{name: thinned(without.signal(name), every) for name in references},
        "without": {name: thinned(without.signal(name), every) for name in names},
        "suppressed": {name: thinned(suppressed.signal(name), every) for name in names},
    }


def thinned(values: Floats, every: int) -> list[float]:
    """Values for a picture: fewer samples and digits than there are."""
    return [float(f"{value:.4g}") for value in values[::every]]


def vary(alternatives: list[Alternative], gains: ServoGains, usual: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Ringing for every alternative under both main conditions, and whether it differs from the standard move's."""
    by_view = {view: try_alternatives(alternatives, base, gains) for view, base in MAIN.items()}
    rows = []
    for alternative in alternatives:
        views = {view: ringing_numbers(by_view[view][alternative.label]) for view in MAIN}
        for view, numbers in views.items():
            pairs = zip(numbers.pop("phases"), usual[view], strict=True)
            numbers["same"] = all(
                np.allclose(list(own.values()), list(other.values()), rtol=_SAME, atol=0, equal_nan=True)
                for own, other in pairs
            )
        names = {key: getattr(alternative, key) for key in ("assumption", "chosen", "label")}
        rows.append({**names, "views": views})
    return rows


def sweep(gains: ServoGains, move: MoveShape) -> dict[str, Any]:
    """Ringing after the stop over the ramp time of the standard move."""
    moves = [move._replace(ramp_time=float(ramp)) for ramp in np.linspace(0.05, 0.5, _SWEPT) * move.duration]
    moves = [each for each in moves if is_allowed(each)]
    results = {view: suppression(conditions, gains, moves) for view, conditions in MAIN.items()}
    return {
        "ramp_times": [each.ramp_time for each in moves],
        "views": {view: [rung.stop for rung in pair] for view, pair in results.items()},
    }


def random(ringing: Suppression) -> dict[str, Any]:
    """Shares of random moves by their ratios of ringing in each phase, and on how many the arm left its workspace.

    Moves on which the arm leaves its workspace with vibration feedback alone count as increased.
    """
    phases = {}
    for phase in PHASES:
        ratios = ringing.ratios(phase)
        ratios = np.sort(ratios[~np.isnan(ratios)])
        median = float(np.quantile(ratios, 0.5, method="inverted_cdf")) if len(ratios) else math.nan
        phases[phase] = {
            "removed": np.mean(ratios < REMOVED) if len(ratios) else math.nan,
            "reduced": np.mean(ratios < REDUCED) if len(ratios) else math.nan,
            "increased": np.mean(ratios > 1 / REDUCED) if len(ratios) else math.nan,
            "median": median,
            "median_left": math.isinf(median),
            "ratios": ratios,
        }
    return {"phases": phases, "left": [int(np.isinf(rung.stop).sum()) for rung in ringing]}


def on_drives(gains: ServoGains, places: Mapping[str, MoveShape], draws: int) -> tuple[list[Any], dict[str, Any]]:
    """Motion and ringing on all drives, and the tip's velocity on the standard move, ideal and with all effects."""
    rows, swings = [], dict[str, Any]()
    for view, conditions in progress_over("drives", list(MAIN.items())):
        runs = run_drives(gains, list(places.values()), conditions, draws)
        results = compare(runs, draws)
        for k, place in enumerate(places):
            own = results[k * len(DRIVES) : (k + 1) * len(DRIVES)]
            rows.append({"place": place, "view": view, "move": places[place]._asdict(), "drives": own})
        if view == FRICTION:
            every = _EVERY["swings"]
            swings |= {"time": thinned(runs[0].time, every)}
            for drive, shown in ((IDEAL, 1), (ALL, draws)):  # all ideal drives are the same
                first = DRIVES.index(drive) * draws
                errors = [run.tip_velocity_error[:, first : first + shown, 0].T for run in runs]
                swings[drive] = [[thinned(line, every) for line in lines] for lines in errors]
    return sorted(rows, key=lambda row: list(places).index(row["place"])), swings
