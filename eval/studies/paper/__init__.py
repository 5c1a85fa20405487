"""The paper's figures and its claim: does feedback of the torsional velocity remove the ringing of the tip?

Motion of motor and tip with and without vibration feedback (Figs. 4b and 8b), root loci (Fig. 6), damping over K4 and
M2, alternatives to everything that the paper does not print, random moves, and drives that are not ideal.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from baselines.tools.progress import progress_over
from beltarm_env.arrays import Floats
from beltarm_env.task.seeds import PAPER_DRIVES, PAPER_MOVES, SeedRange
from eval.studies._frame import Bounds, StudyOptions
from eval.studies.paper import runs
from eval.studies.paper.linear import TABLE_2, linear_numbers
from eval.studies.paper.pictures import pictures
from eval.studies.paper.runs import BOTH_ARMS, MAIN, PHASES, PLACES, REDUCED, REMOVED, STANDARD, VIEWS
from eval.studies.paper.tables import tables
from eval.studies.paper.variations import ALTERNATIVES, compare, run_drives, try_alternatives

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
    usual = {scene["view"]: scene["phases"] for scene in scenes if scene["place"] == STANDARD}
    return {
        "gains": asdict(TABLE_2),
        "move": PLACES[STANDARD]._asdict(),
        "bounds": {"removed": REMOVED, "reduced": REDUCED, "window": runs.END_WINDOW},
        "random_moves": random_moves._asdict(),
        "drawn_drives": {"first": PAPER_DRIVES.first, "size": options.draws},
        "scenes": scenes,
        "signals": signals,
        "alternatives": vary(usual),
        "random": {view: random(runs.suppression(under, random_moves)) for view, under in BOTH_ARMS.items()},
        "linear": linear_numbers(TABLE_2),
        "drives": on_drives(options.draws),
    }


def run_scenes() -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Run the moves of `PLACES` under each of `VIEWS`: numbers of each, and signals over time of some."""
    scenes, signals = [], {}
    for view, conditions in progress_over("conditions", list(VIEWS.items())):
        pair = [runs.run_moves(conditions, gains, list(PLACES.values())) for gains in TABLE_2.without_and_with]
        ringing = np.array([runs.ringing_of(run) for run in pair])
        for k, (place, move) in enumerate(PLACES.items()):
            shown = [runs.signals_of(run, k) for run in pair]
            numbers = {"place": place, "view": view, "move": move._asdict(), **ringing_numbers(ringing[:, :, k])}
            scenes.append({**numbers, "motions": [runs.summary(each) for each in shown]})
            if names := runs.SIGNALS.get((place, view)):
                without, suppressed = ({name: thinned(each[name]) for name in each} for each in shown)
                references = [f"{name}_reference" for name in names if f"{name}_reference" in without]
                signals[f"{place}, {view}"] = {
                    **{name: without[name] for name in ("time", *references)},
                    "without": {name: without[name] for name in names},
                    "suppressed": {name: suppressed[name] for name in names},
                }
    return sorted(scenes, key=lambda scene: list(PLACES).index(scene["place"])), signals


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


def thinned(values: Floats) -> list[float]:
    """Values for a picture: fewer samples and digits than there are."""
    return [float(f"{value:.4g}") for value in values[::3]]


def vary(usual: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Ringing for every alternative under both main conditions, and whether it differs from the standard move's."""
    by_view = {view: try_alternatives(ALTERNATIVES, base) for view, base in MAIN.items()}
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


def on_drives(draws: int) -> list[dict[str, Any]]:
    """Ringing on all drives, by place and conditions."""
    rows = []
    for view, conditions in progress_over("drives", list(MAIN.items())):
        pair = run_drives(list(PLACES.values()), conditions, draws)
        for (place, move), drives in zip(PLACES.items(), compare(pair, draws), strict=True):
            rows.append({"place": place, "view": view, "move": move._asdict(), "drives": drives})
    return sorted(rows, key=lambda row: list(PLACES).index(row["place"]))
