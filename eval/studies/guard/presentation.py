"""Tables and the picture of the guard's page."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from eval.report.style import BLUE, GREEN, VERMILION, mark_one_two_five
from eval.report.text import markdown_table, number
from eval.studies._frame import Pictures

MEASURES = {"peak": "peak tip error (mm)", "left": "left (%)", "energy": "torque energy (10⁻³ N²m²s)"}
"""Headings of an outcome's measures."""
MARGIN = 1.1
"""Largest ratio of the guarded controller to its base alone that counts as no worse."""
_DIGITS = {"peak": 1, "left": 0, "energy": 1}


def tables(data: dict[str, Any]) -> dict[str, Any]:
    """A table of faults for each controller, that of health, and the comparisons in which the base alone is better."""
    worse = [(row, measure) for row in data["rows"] for measure in worse_measures(row)]
    return {
        "faults": [_faults_table(data, name) for name in data["bases"]],
        "healthy": _health_table(data),
        "comparisons": len(data["rows"]) * len(MEASURES),
        "worse": [
            {
                "controller": row["controller"],
                "fault": row["fault"],
                "base": data["bases"][row["controller"]],
                "measure": MEASURES[measure],
                "values": [number(row[kind][measure], _DIGITS[measure]) for kind in ("guarded", "base")],
                "peaks": [number(row[kind]["peak"], 1) for kind in ("guarded", "base")],
            }
            for row, measure in worse
        ],
        "margin": round(100 * (MARGIN - 1)),
        "learned": _learned(data),
    }


def worse_measures(row: dict[str, Any]) -> list[str]:
    """Measures by which the guarded controller is worse than its base alone, beyond the margin."""
    return [name for name in MEASURES if row["guarded"][name] > MARGIN * row["base"][name] + 1e-9]


def _learned(data: dict[str, Any]) -> list[str]:
    return [name for name, base in data["bases"].items() if name != base]


def _faults_table(data: dict[str, Any], name: str) -> str:
    """All faults of one controller."""
    learned = name in _learned(data)
    order = f"`{data['bases'][name]}` alone → without → with the guard" if learned else "without → with the guard"
    rows = []
    for row in data["rows"]:
        if row["controller"] == name:
            shown = [row["base"], row["without"], row["guarded"]] if learned else [row["without"], row["guarded"]]
            cells = []
            for measure in MEASURES:
                texts = [number(outcome[measure], _DIGITS[measure]) for outcome in shown]
                if measure in worse_measures(row):
                    texts[-1] = f"**{texts[-1]}**"
                cells.append(" → ".join(texts))
            rows.append([row["fault"], *cells, number(row["guarded"]["passive"], 0)])
    return markdown_table([f"`{name}`: {order}", *MEASURES.values(), "made passive (%)"], rows)


def _health_table(data: dict[str, Any]) -> str:
    """Cost with and without the guard where nothing breaks."""
    rows = [
        [
            f"`{row['controller']}`",
            row["split"],
            number(row["before"], 1),
            number(row["after"], 1),
            number(100 * (row["after"] / row["before"] - 1), 2),
            number(100 * row["changed"], 3),
            number(100 * row["arms"], 0),
            number(100 * row["fallen"], 1),
        ]
        for row in data["healthy"]
    ]
    titles = ["controller", "split", "mean cost without", "with", "change (%)", "commands changed (%)", "on arms (%)"]
    return markdown_table([*titles, "fell back (% of arms)"], rows, "llrrrrrr")


def pictures(data: dict[str, Any]) -> Pictures:
    """Peak tip error under every fault."""
    return {"peak.png": lambda: _draw(data)}


def _draw(data: dict[str, Any]) -> Figure:
    """Draw a panel for each learned method; for each controller if there is none."""
    names = _learned(data) or list(data["bases"])
    figure, grid = plt.subplots(1, len(names), figsize=(11, 4.2), sharex=True, sharey=True, squeeze=False)
    kinds = {
        "base": ("base alone", BLUE, "s"),
        "without": ("without the guard", VERMILION, "o"),
        "guarded": ("with the guard", GREEN, "D"),
    }
    for axis, name in zip(grid[0], names, strict=True):
        rows = [row for row in data["rows"] if row["controller"] == name]
        for k, (kind, (label, colour, marker)) in enumerate(kinds.items()):
            heights = [place + 0.22 * (k - 1) for place in range(len(rows))]
            axis.plot([row[kind]["peak"] for row in rows], heights, marker, color=colour, ms=6, label=label)
        axis.set_yticks(range(len(rows)), [row["fault"] for row in rows])
        axis.set_title(f"{name} on {data['bases'][name]}", fontsize=10)
        axis.set_xscale("log")
        mark_one_two_five(axis.xaxis)
        axis.set_xlabel("peak tip error, mean (mm)")
        axis.grid(axis="x", color="0.9", lw=0.6)
        axis.set_axisbelow(True)
        axis.spines[["top", "right"]].set_visible(False)
    grid[0, 0].invert_yaxis()
    marks = grid[0, 0].get_legend_handles_labels()
    figure.legend(*marks, frameon=False, fontsize=9, loc="lower center", ncols=len(kinds))
    figure.tight_layout(rect=(0, 0.05, 1, 1))
    return figure
