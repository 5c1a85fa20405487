"""Output of a comparison: the main table and the verdict on the terminal, and all files of its folder.

Its report is one HTML page that loads nothing else: `report.html` beside this file, with results and motions. Pictures
beside the page show a motion on every split, and all intervals.
"""

import base64
import re
import shlex
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import jinja2
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Console
from rich.markup import escape

from baselines.tools.files import write_text
from beltarm_env.arm import COLUMN, ArmParams
from beltarm_env.metrics import ARRIVAL_BOUND, SETTLING_BAND, heading
from beltarm_env.rollout import Recording
from beltarm_env.task.cost import STILL_BAND
from beltarm_env.timing import CONTROL_PERIOD, EPISODE_TIME
from eval.comparison.check import PERIOD_US
from eval.comparison.custom import RESULTS
from eval.comparison.results import PAIRED_METRICS, Comparison
from eval.comparison.rollouts import Failure, calls_side_by_side
from eval.comparison.schema import require_rows_kept, write_results
from eval.comparison.splits import EDITION, SPLITS, Split
from eval.comparison.statistics import LEAST_OF_TAIL
from eval.report import figures
from eval.report.recordings import Scene, record_scenes, reference_angles
from eval.report.style import BLUE, COLOURS, OF_KIND, mark_one_two_five, save_figures
from eval.report.summary import CONSTANTS, described, headline
from eval.report.table import Record, Results, estimate, to_terminal
from eval.report.text import degrees
from eval.report.verdict import verdict

_MOTIONS = {"tip_error.png": figures.tip_error, "residual.png": figures.tip_after, "torque.png": figures.torque}
_ACROSS = 3  # splits side by side
_ANSWERS = (f"time until still, within {1000 * STILL_BAND:g} mm, after a move (ms)", "cost")
_DRAWN = 1000.0  # cost up to which a method has bars; others would hide all differences


def publish(
    comparison: Comparison, splits: dict[str, Split], folder: Path, jobs: int | None = None
) -> tuple[dict[str, Any], list[Failure]]:
    """Write report.html, results.json, episodes.csv and pictures of a comparison of some splits.

    Returns:
        The content of results.json, and all failures, also of methods that were run once more to be shown.

    Raises:
        OSError: If a file cannot be written.
        ValueError: If no method is left, or results that are there would be lost.
    """
    scenes, traces, failures = record_scenes(comparison, splits, jobs)
    comparison = comparison.with_failures(failures)
    if any(failure.varies for failure in failures):  # what is lost is neither drawn nor compared with
        return publish(comparison, splits, folder, jobs)
    require_rows_kept(folder / RESULTS, comparison)
    content = write_results(comparison, folder, *verdict(comparison))
    page, drawn = folder / "report.html", plots(Results(content), traces)
    calls: dict[str, Callable[[], object]] = {"report.html": lambda: write_text(page, render(content, scenes))}
    calls |= {name: partial(save_figures, {name: draw}, folder) for name, draw in drawn.items()}
    calls_side_by_side("report and pictures", calls, jobs)
    return content, comparison.failures


def print_results(content: dict[str, Any], console: Console) -> None:
    """Print the main split, best method first, and the verdict."""
    results = Results(content)
    console.print(to_terminal(results.main_table(), console.width))
    for sentence in content["verdict"]:
        console.print(escape(sentence), style="bold", highlight=False)
    console.print(escape(results.note), highlight=False)
    least = f" (of {LEAST_OF_TAIL} scenarios or more)" if results.episodes < LEAST_OF_TAIL else ""
    console.print(
        "*: best of its column; =: not shown to differ from it on this split, in interquartile means; the verdict "
        "tests means too, over all splits. Cost: minus the return, averaged over the middle half of runs; mean: over "
        f"all; worst 5 %: over the worst of them{least}; fail: not to stay within {1000 * SETTLING_BAND:g} mm; left: "
        "the arm left its workspace; residual p-p: vibration after the move, of arms that arrive, within "
        f"{1000 * ARRIVAL_BOUND:g} mm in the mean.",
        style="dim",
        highlight=False,
    )


def plots(results: Results, traces: Sequence[Scene]) -> dict[str, Callable[[], Figure]]:
    """Recipes of all pictures, by the names of their files."""
    colours = figures.colours_of(results, traces)
    note = f"Scenarios of the {results.label.title}"
    return {
        **{name: partial(_motions, draw, traces, colours, note) for name, draw in _MOTIONS.items() if traces},
        "answer.png": partial(_answer, results, note),
        "intervals.png": partial(_intervals, results, note),
    }


def _motions(draw: figures.Draw, traces: Sequence[Scene], colours: dict[str, str], note: str) -> Figure:
    """Draw a motion on each split, by all methods that have a colour."""
    across = min(len(traces), _ACROSS)
    down = -(-len(traces) // across)
    with plt.rc_context(figures.LOOK):
        figure = plt.figure(figsize=(4.2 * across, 3.3 * down + 0.7), layout="constrained")
        for part, scene in zip(figure.subfigures(down, across, squeeze=False).flat, traces, strict=False):
            start, goal = next(iter(scene.motions.values())).moves[0, :2]
            part.suptitle(f"{scene.split}: {scene.title}, {degrees(start)} to {degrees(goal)}", fontsize=10)
            draw(part, figures.runs_of(scene, colours))
        _finish(figure, note)
    return figure


def _finish(figure: Figure, note: str) -> None:
    """Put a note above a figure and one legend of all its axes below."""
    figure.suptitle(note, fontsize=10, color="0.4")
    entries = {}
    for axis in figure.axes:
        entries |= dict(zip(*reversed(axis.get_legend_handles_labels()), strict=True))
    figure.legend(entries.values(), entries, loc="outside lower center", ncols=6, frameon=False)


def _answer(results: Results, note: str) -> Figure:
    """Draw the time until still and the cost on the main split as bars with their intervals, the best method on top."""
    every = list(reversed(results.on(results.main)))
    rows = [row for row in every if estimate(row, "cost").iqm < _DRAWN] or every
    left_out = [row["method"] for row in reversed(every) if row not in rows]
    dear = f"; not drawn, for costs above {_DRAWN:.0f}: {', '.join(left_out)}" if left_out else ""
    figure, axes = plt.subplots(1, 2, figsize=(9.0, 0.9 + 0.3 * len(rows)), layout="constrained", sharey=True)
    for axis, name, scale, title in zip(axes, ("still_s", "cost"), (1000, 1), _ANSWERS, strict=True):
        for height, row in enumerate(rows):
            value = estimate(row, name)
            ends = scale * np.abs([[value.iqm - value.low], [value.high - value.iqm]])
            style = {"color": OF_KIND[row["kind"]], "label": row["kind"], "error_kw": {"lw": 1.0}}
            axis.bar_label(axis.barh(height, scale * value.iqm, 0.66, xerr=ends, **style), fmt="%.0f", padding=4)
        axis.set_xlabel(title)
        axis.margins(x=0.12)
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].set_yticks(range(len(rows)), [row["method"] for row in rows])
    _finish(figure, f"{note}, {results.main}: interquartile means with 95 % intervals{dear}")
    return figure


def _intervals(results: Results, note: str) -> Figure:
    """Interquartile means with their intervals: a row of axes per split, best at the top, what is not ranked below."""
    down, across = len(results.splits), len(PAIRED_METRICS)
    height = (0.9 + 0.19 * len(results.methods)) * down + 0.6
    figure, axes = plt.subplots(down, across, figsize=(3.0 * across, height), layout="constrained", squeeze=False)
    for row, split in zip(axes, results.splits, strict=True):
        ranking = sorted(results.on(split), key=lambda r: (r["kind"] != "privileged", -estimate(r, "cost").iqm))
        best = results.records.get((results.best_classical(split) or "", split))
        for axis, name in zip(row, PAIRED_METRICS, strict=True):
            _draw_intervals(axis, ranking, name)
            if best and np.isfinite(estimate(best, name).iqm):
                axis.axvline(estimate(best, name).iqm, color=BLUE, lw=0.8, ls=":")
            axis.set(xlabel=heading(name), yticks=[])
        row[0].set_yticks(range(len(ranking)), [record["method"] for record in ranking], fontsize=8)
        row[0].set_title(split, loc="left", fontsize=11)
    _finish(figure, f"{note}: interquartile means with 95 % intervals; further left is better")
    return figure


def _draw_intervals(axis: Axes, ranking: list[Record], name: str) -> None:
    for height, record in reversed([*enumerate(ranking)]):
        value, kind = estimate(record, name), record["kind"]  # not a number where no arm arrives
        ends = np.abs([[value.iqm - value.low], [value.high - value.iqm]])
        axis.errorbar(value.iqm, height, xerr=ends, fmt="o", color=OF_KIND[kind], ms=4, capsize=2, label=kind)
    if unranked := sum(record["kind"] == "privileged" for record in ranking):
        axis.axhline(unranked - 0.5, color="0.55", lw=0.8)
    axis.set_xscale("log")
    mark_one_two_five(axis.xaxis)
    axis.set_ylim(-0.7, len(ranking) - 0.3)
    axis.grid(axis="x", which="both", alpha=0.3)
    axis.tick_params(labelsize=8)


# Report

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
    colours, legend = figures.colours_of(results, scenes), []
    for method in colours:
        look = figures.line(colours, method)
        dashes = "" if look["ls"] == "-" else " ".join(f"{2 * length:g}" for length in look["ls"][1])
        legend.append({"method": method, "variable": f"--c{COLOURS.index(look['color'])}", "dashes": dashes})
    return environment.get_template("report.html").render(
        results=results,
        headline=headline(results),
        methods=described(results),
        drawing=_DRAWING.name,
        vibration=heading("residual_pp_mm"),
        band_mm=1000 * SETTLING_BAND,
        still_mm=1000 * STILL_BAND,
        episode_s=EPISODE_TIME,
        splits=[(name, SPLITS[name].description) for name in results.splits],
        tables=[results.across_splits(metric) for metric in PAIRED_METRICS],
        edition=EDITION,
        forests=figures.forests(results, colours),
        scenes=[(scene, figures.scene_panels(scene, k, colours)) for k, scene in enumerate(scenes)],
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
    chosen, gear_ratio = slice(EVERY - 1, None, EVERY), recording.params[0, COLUMN.gear_ratio]
    state = recording.state[chosen, 0]
    errors = np.clip(1000 * recording.tip_error[chosen, 0], -_LONGEST_MM, _LONGEST_MM)
    return np.column_stack([state[:, 0] / gear_ratio, state[:, 2], errors, recording.torque[chosen, 0]]).astype("<f4")


def encode(values: np.ndarray) -> str:
    """Little-endian float32 in base64, row by row."""
    return base64.b64encode(values.astype("<f4").tobytes()).decode()
