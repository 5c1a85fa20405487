"""Picture of the tails: in what share of all scenarios a method's cost or tip error reaches a value, or exceeds it."""

from __future__ import annotations

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from beltarm_env.metrics import heading
from eval.comparison.splits import EPISODES
from eval.report.style import COLOURS, mark_one_two_five
from eval.tails.study import DRAWN, Outcome

_LINES = ("-", "--", ":", "-.")


def draw(outcomes: list[Outcome]) -> Figure:
    """Draw the exceedance of the cost and of the largest tip error on one split, a curve for each method."""
    figure, axes = plt.subplots(1, len(DRAWN), figsize=(10.5, 4.8), sharey=True, squeeze=False)
    for axis, name in zip(axes[0], DRAWN, strict=True):
        for k, outcome in enumerate(outcomes):
            values, shares = outcome.curves[name]
            line, colour = _LINES[k // len(COLOURS) % len(_LINES)], COLOURS[k % len(COLOURS)]
            axis.plot(values, 100 * shares, line, color=colour, lw=1.8, label=outcome.method.name)
            axis.plot(values[-1:], 100 * shares[-1:], "o", color=colour, ms=4)
        axis.axhline(100 / EPISODES, color="0.45", lw=0.9, ls=(0, (4, 3)))
        axis.set_xscale("log")
        axis.set_yscale("log")
        mark_one_two_five(axis.xaxis)
        axis.yaxis.set_major_formatter("{x:g}")
        axis.set_xlabel(heading(name))
        axis.tick_params(labelsize=9)
        axis.grid(color="0.9", lw=0.6)
        axis.set_axisbelow(True)
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
    axes[0, 0].set_ylabel("share of scenarios that reach it (%)")
    axes[0, 0].annotate(
        f"one in {EPISODES}",
        (0.0, 100 / EPISODES),
        xycoords=("axes fraction", "data"),
        xytext=(4, 3),
        textcoords="offset points",
        color="0.35",
        fontsize=9,
    )
    figure.legend(*axes[0, 0].get_legend_handles_labels(), frameon=False, loc="lower center", ncols=6)
    rows = -(-len(outcomes) // 6)
    figure.tight_layout(rect=(0, 0.02 + 0.05 * rows, 1, 1), w_pad=2)
    return figure
