"""The report, one HTML page that loads nothing else: `report.html` beside this file, with results and motions."""

from __future__ import annotations

import base64
import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from beltarm_env.arm import COLUMN, ArmParams
from beltarm_env.metrics import SETTLING_BAND, heading
from beltarm_env.rollout import Recording
from beltarm_env.timing import CONTROL_PERIOD, EPISODE_TIME
from eval.comparison.check import PERIOD_US
from eval.comparison.results import PAIRED_METRICS
from eval.comparison.splits import EDITION, SPLITS
from eval.report.figures import colours_of, forests, line, scene_panels
from eval.report.recordings import Scene, reference_angles
from eval.report.style import COLOURS
from eval.report.summary import CONSTANTS
from eval.report.table import Results

LARGEST = 3_000_000
"""Bytes that the page may have."""
EVERY = 4  # samples per frame of the animation: 6 ms
_DRAWING = Path(__file__).resolve().parents[2] / "docs" / "arm.svg"
_LONGEST_MM = 500.0  # an arm that left its workspace may be anywhere


def render(content: dict[str, Any], scenes: Sequence[Scene] = ()) -> str:
    """Render the page."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader([Path(__file__).parent, _DRAWING.parent]),
        autoescape=True,
        trim_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    results = Results(content)
    colours, legend = colours_of(results, scenes), []
    for method in colours:
        look = line(colours, method)
        dashes = "" if look["ls"] == "-" else " ".join(f"{2 * length:g}" for length in look["ls"][1])
        legend.append({"method": method, "variable": f"--c{COLOURS.index(look['color'])}", "dashes": dashes})
    return environment.get_template("report.html").render(
        results=results,
        drawing=_DRAWING.name,
        vibration=heading("residual_pp_mm"),
        band_mm=1000 * SETTLING_BAND,
        episode_s=EPISODE_TIME,
        splits=[(name, SPLITS[name].description) for name in results.splits],
        tables=[results.across_splits(metric) for metric in PAIRED_METRICS],
        edition=EDITION,
        forests=forests(results, colours),
        scenes=[(scene, scene_panels(scene, k, colours)) for k, scene in enumerate(scenes)],
        seed_note=results.seed_note(colours),
        animation=animation(scenes, colours),
        legend=legend,
        palette=COLOURS,
        period_us=PERIOD_US,
        command=without_paths(content["provenance"]["command"]),
        **CONSTANTS,
    )


def without_paths(command: str) -> str:
    """Command with absolute paths cut to their last part."""
    return " ".join(re.sub(r"^(--[\w-]+=)?(?:~[^/]*)?/(?:.*/)?", r"\1…/", part) for part in shlex.split(command))


# Animation


def animation(scenes: Sequence[Scene], colours: dict[str, str]) -> dict[str, Any]:
    """Data of the animation, as the page's script reads them: JSON with arrays in base64."""
    return {"period": EVERY * CONTROL_PERIOD, "scenes": [_animated(scene, list(colours)) for scene in scenes]}


def _animated(scene: Scene, names: list[str]) -> dict[str, Any]:
    moved = {method: _frames(scene.motions[method]) for method in names if method in scene.motions}
    first = next(iter(scene.motions.values()))
    arm = ArmParams.from_row(first.params[0])
    largest = np.median([np.hypot(frames[:, 2], frames[:, 3]).max() for frames in moved.values()])
    power = 10.0 ** np.floor(np.log10(max(largest, 2.0)))
    return {
        "title": scene.title,
        "link": arm.link_length,
        "hand": arm.hand_length,
        "payload": arm.payload_mass,
        "duration": float(first.moves[0, 2]),
        "magnified": float(next(step * power for step in (1, 2, 5, 10) if step * power >= max(largest, 2.0))),  # in mm
        "reference": encode(reference_angles(first)[EVERY - 1 :: EVERY]),
        "methods": [
            {"name": method, "colour": names.index(method), "frames": encode(frames)}
            for method, frames in moved.items()
        ],
    }


def _frames(recording: Recording) -> np.ndarray:
    """Joint angle, torsion [rad], radial and lateral error [mm], torque [N m] of each frame, shape (frames, 5)."""
    chosen = slice(EVERY - 1, None, EVERY)
    gear_ratio = recording.params[0, COLUMN.gear_ratio]
    state = recording.state[chosen, 0]
    errors = np.clip(1000 * recording.tip_error[chosen, 0], -_LONGEST_MM, _LONGEST_MM)
    columns = [state[:, 0] / gear_ratio, state[:, 2], errors[:, 0], errors[:, 1], recording.torque[chosen, 0]]
    return np.column_stack(columns).astype("<f4")


def encode(values: np.ndarray) -> str:
    """Little-endian float32 in base64, row by row."""
    return base64.b64encode(values.astype("<f4").tobytes()).decode()
