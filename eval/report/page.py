"""Page of the report, rendered with the template beside this file."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from baselines.tools.files import write_text
from beltarm_env.metrics import ARRIVAL_BOUND, REVERSAL_SWING, SETTLING_BAND, heading
from beltarm_env.timing import EPISODE_TIME
from eval.comparison.pairs import CHANGE, NUDGE
from eval.comparison.results import MOSTLY, Comparison
from eval.comparison.splits import EDITION, SPLITS
from eval.comparison.statistics import LEAST_OF_TAIL, LEAST_SCENARIOS, RESAMPLES
from eval.report.animation import animation
from eval.report.arm import arm_drawing
from eval.report.figures import STRONGEST, background, forests, map_panels, profile_panels
from eval.report.frame import best_first
from eval.report.motions import scene_panels
from eval.report.scenes import Map, Recordings
from eval.report.style import COLOURS
from eval.report.svg import Panel, line
from eval.report.tables import PERIOD_US, effort_table, main_table, metric_tables, torque_table
from eval.report.templates import template
from eval.report.traces import seed_note

LARGEST = 3_000_000
"""Bytes that the page may have."""


def write_report(comparison: Comparison, said: Sequence[str], recordings: Recordings, out: Path) -> Path:
    """Write `report.html` into the folder `out`.

    Args:
        comparison: What was found.
        said: The verdict, sentence by sentence.
        recordings: Motions of chosen scenarios, and robustness maps if there are any.
        out: Folder of the comparison.

    Returns:
        The file: one page that loads nothing else.

    Raises:
        OSError: If it cannot be written.
    """
    path = out / "report.html"
    write_text(path, render(comparison, said, recordings))
    return path


def render(comparison: Comparison, said: Sequence[str], recordings: Recordings) -> str:
    """Render the page, with methods everywhere in the same order: the lowest cost on the main split first."""
    return template("report.html").render(**_content(best_first(comparison), said, recordings))


def _content(comparison: Comparison, said: Sequence[str], recordings: Recordings) -> dict[str, Any]:
    colours: dict[str, str] = dict(zip(_coloured(comparison, recordings), COLOURS, strict=False))
    return {
        "arm": arm_drawing(),
        "verdict": said,
        "main_split": comparison.main_split,
        "vibration": heading("residual_pp_mm"),
        "band_mm": 1000 * SETTLING_BAND,
        "episode_s": EPISODE_TIME,
        "failures": comparison.failures,
        "splits": [(name, SPLITS[name].description) for name in comparison.splits()],
        "episodes": comparison.outcomes[0].metrics["cost"].shape[1],
        "main_table": main_table(comparison),
        "tables": metric_tables(comparison),
        "set_note": comparison.note,
        "set_label": comparison.scenario_set,
        "edition": EDITION,
        "torque_table": torque_table(comparison),
        "effort_table": effort_table(comparison),
        "forests": forests(comparison, colours),
        "profiles": profile_panels(comparison, colours),
        "scenes": [
            (scene, scene_panels(scene, k, colours), {name: run.cost[0] for name, run in scene.motions.items()})
            for k, scene in enumerate(recordings.scenes)
        ],
        "maps": recordings.maps,
        "map_panels": _by_opponent(recordings.maps, colours),
        "strongest": STRONGEST,
        "background": background(comparison, colours),
        "seed_note": seed_note(comparison, list(colours)),
        "animation": animation(recordings.scenes, colours),
        "legend": [_legend_entry(colours, method) for method in colours],
        "palette": COLOURS,
        "arrival_mm": 1000 * ARRIVAL_BOUND,
        "mostly": MOSTLY,
        "resamples": RESAMPLES,
        "least_scenarios": LEAST_SCENARIOS,
        "least_of_tail": LEAST_OF_TAIL,
        "reversal_swing": REVERSAL_SWING,
        "period_us": PERIOD_US,
        "change": CHANGE,
        "nudge": NUDGE,
        "origin": comparison.provenance,
        "command": without_paths(comparison.provenance["command"]),
    }


def _coloured(comparison: Comparison, recordings: Recordings) -> list[str]:
    """Methods with a colour: those whose motion is shown, or else the best challenger and classical controller."""
    shown = {method for scene in recordings.scenes for method in scene.motions}
    split = comparison.main_split
    best = comparison.best_classical(split)
    shown = shown or {o.method.name for o in [*comparison.challengers(split)[:1], *([best] if best else [])]}
    return [outcome.method.name for outcome in comparison.methods() if outcome.method.name in shown]


def _by_opponent(maps: list[Map], colours: dict[str, str]) -> dict[str, list[Panel]]:
    """Pictures of the maps by the pair of methods that they compare."""
    found: dict[str, list[Panel]] = {}
    for map_, panel in zip(maps, map_panels(maps, colours), strict=True):
        found.setdefault(f"{map_.challenger} against {map_.classical}", []).append(panel)
    return found


def _legend_entry(colours: dict[str, str], method: str) -> dict[str, str]:
    look = line(colours, method)
    dashes = "" if look["ls"] == "-" else " ".join(f"{2 * length:g}" for length in look["ls"][1])
    return {"method": method, "variable": f"--c{COLOURS.index(look['color'])}", "dashes": dashes}


def without_paths(command: str) -> str:
    """Command with absolute paths cut to their last part."""
    return " ".join(re.sub(r"^(--[\w-]+=)?(?:~[^/]*)?/(?:.*/)?", r"\1…/", part) for part in shlex.split(command))
