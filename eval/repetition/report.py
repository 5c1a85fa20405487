"""Results of the repetitions as Markdown, as data and as a picture."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator, NullFormatter, ScalarFormatter
from numpy.typing import NDArray

from baselines.tools.provenance import command_line, commit
from beltarm_env import __version__
from beltarm_env.metrics import METRICS, heading
from eval.comparison.statistics import interquartile_mean, paired
from eval.repetition.study import ARM, KINDS, MOTOR, TORQUE, RepetitionResult
from eval.report.style import BLUE, ORANGE, VERMILION, save_figure
from eval.report.text import markdown_table

Floats = NDArray[np.float64]
_Label = tuple[float, str, str]  # value at the end of a curve, name, colour

COLOURS = {TORQUE: BLUE, ARM: ORANGE, MOTOR: VERMILION}
_LABEL_HEIGHT = 0.05  # least distance of two labels, of the axes' height
_COLUMNS = {
    **{name: (heading(name), METRICS[name].digits + 1) for name in ("cost", "tip_rms_mm", "residual_pp_mm")},
    "motor_rms_mrad": ("motor RMS (mrad at the joint)", 2),
}
"""Title and decimals of each metric."""


def differences_table(results: list[RepetitionResult]) -> str:
    """Cost of the last repetition minus others on the same arms, and the share of arms on which it is lower."""
    rows = []
    for kind in KINDS:
        learnt = _costs(results, kind, TORQUE)
        others = {
            f"first of `{TORQUE}`": learnt[0],
            f"last of `{ARM}`": _costs(results, kind, ARM)[-1],
            "`privileged`": _costs(results, kind, "privileged")[0],
        }
        for name, other in others.items():
            found = paired(learnt[-1:], other[None])
            d, wins = found.difference, found.win_rate.iqm
            rows.append([kind, name, f"{d.iqm:+.1f} [{d.low:+.1f}, {d.high:+.1f}]", f"{100 * wins:.0f}"])
    return markdown_table(["arms", "against", "cost", "lower on (% of the arms)"], rows, "llrr")


def _table(results: list[RepetitionResult], kind: str) -> str:
    rows = []
    for result in (result for result in results if result.kind == kind):
        for number, found in enumerate(result.estimates, start=1):
            cells = [
                f"{found[name].iqm:.{digits}f} [{found[name].low:.{digits}f}, {found[name].high:.{digits}f}]"
                for name, (_, digits) in _COLUMNS.items()
            ]
            which = str(number) if len(result.repetitions) > 1 else "each"
            rows.append([result.name, which, *cells])
    return markdown_table(["controller", "repetition", *(title for title, _ in _COLUMNS.values())], rows)


def markdown(results: list[RepetitionResult], seed: int, seconds: float) -> str:
    """The content of summary.md."""
    arms = len(results[0].repetitions[0]["cost"])
    parts = [
        "# Iterative learning",
        "The same move on the same arm, again and again; encoder observations and the design model's constants "
        "beforehand. Interquartile means over arms, with bootstrap 95 % intervals; lower is better everywhere. Not "
        "ranked with the other controllers, which meet every arm for the first time.",
        f"- `{TORQUE}` learns the arm's constants and the torque (`baselines/iterative/controller.py`); its first "
        f"repetition is `adaptive`.\n- `{ARM}` learns the constants, and plans the move for them.\n- `{MOTOR}` is the "
        "textbook's: the paper's controller with a feed-forward learnt from the motor's error "
        "(`baselines/iterative/motor_learning.py`).\n- `paper`, `adaptive` learn nothing from trial to trial; "
        "`privileged` is the plan of `adaptive` for the true arm on its true state. It is no lower bound: the plan is "
        "linear and quadratic, the arm and the cost are not.",
        "What is learnt is the cost, a sum of norms. The tip's RMS error, a square, may well rise a little meanwhile.",
        "![Cost over the repetitions](cost.png)",
        f"The last repetition of `{TORQUE}` minus others, arm by arm:",
        differences_table(results),
    ]
    for kind, of_kind in KINDS.items():
        parts += [f"## {kind}", f"{arms} scenarios: {of_kind.description}, random moves, seeds from {seed}."]
        parts.append(_table(results, kind))
    parts.append(f"`{command_line()}`, commit {commit()}, {seconds:.0f} s.")
    return "\n\n".join(parts) + "\n"


def as_json(results: list[RepetitionResult], seed: int) -> str:
    """The content of results.json."""
    rows = [
        {
            "method": result.name,
            "split": result.kind,
            "repetition": number if len(result.repetitions) > 1 else None,
            "episodes": len(result.repetitions[0]["cost"]),
            "metrics": {name: {k: round(v, 4) for k, v in asdict(value).items()} for name, value in found.items()},
        }
        for result in results
        for number, found in enumerate(result.estimates, start=1)
    ]
    provenance = {"command": command_line(), "beltarm": __version__, "commit": commit(), "seed": seed}
    return json.dumps({"provenance": provenance, "rows": rows}, indent=1) + "\n"


def save_picture(results: list[RepetitionResult], path: Path) -> None:
    """Draw the cost over the repetitions, over each arm's first and as it is, for all kinds of arms."""
    size = (5 * len(KINDS), 7.4)
    figure, grid = plt.subplots(2, len(KINDS), figsize=size, sharey="row", squeeze=False, layout="constrained")
    labels = {}
    for column, (kind, of_kind) in enumerate(KINDS.items()):
        relative, whole = grid[:, column]
        first = _costs(results, kind, TORQUE)[0]
        relative.set_title(f"{kind}\n{of_kind.description}", fontsize=10)
        labels[relative] = _draw(relative, results, kind, (TORQUE, ARM, "adaptive", "privileged"), 0.01 * first)
        whole.set_yscale("log")
        labels[whole] = _draw(whole, results, kind, (TORQUE, MOTOR, "paper", "adaptive"), np.ones_like(first))
        whole.set_yticks([100, 200, 500, 1000, 2000])
        whole.yaxis.set_major_formatter(ScalarFormatter())
        whole.yaxis.set_minor_formatter(NullFormatter())
        whole.set_xlabel("repetition")
    for axes, of_axes in labels.items():
        _label(axes, of_axes)
    grid[0, 0].set_ylabel("cost of an episode (% of that arm's first)")
    grid[1, 0].set_ylabel("cost of an episode")
    figure.suptitle("Interquartile means over arms; bands: the middle half of the arms", fontsize=10)
    save_figure(figure, path)


def _costs(results: list[RepetitionResult], kind: str, name: str) -> Floats:
    (found,) = (result for result in results if (result.kind, result.name) == (kind, name))
    return np.array([run["cost"] for run in found.repetitions])


def _draw(axes: Axes, results: list[RepetitionResult], kind: str, names: tuple[str, ...], unit: Floats) -> list[_Label]:
    labels = []
    for name in names:
        costs, colour = _costs(results, kind, name) / unit, COLOURS.get(name, "#444444")
        means = [interquartile_mean(row) for row in costs]
        labels.append((means[-1], name, colour))
        if len(costs) == 1:
            axes.axhline(means[0], color=colour, linewidth=1, linestyle="--")
            continue
        numbers = np.arange(1, len(costs) + 1)
        axes.fill_between(numbers, *np.percentile(costs, [25, 75], axis=1), color=colour, alpha=0.15, linewidth=0)
        axes.plot(numbers, means, color=colour, marker="o", markersize=3)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.margins(x=0.02)
    return labels


def _label(axes: Axes, labels: list[_Label]) -> None:
    """Write names beside the ends of their curves, one above the other; once the axes have their final limits."""
    lowest = -1.0
    for level, name, colour in sorted(labels):
        height = float(axes.transAxes.inverted().transform(axes.transData.transform((1, level)))[1])
        lowest = max(height, lowest + _LABEL_HEIGHT)
        axes.text(1.01, lowest, name, color=colour, transform=axes.transAxes, va="center", fontsize=9)
