"""The chain as a page in Markdown and as a waterfall."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from beltarm_env.metrics import heading
from beltarm_env.task.seeds import LOOPS
from eval.comparison.statistics import average, interquartile_mean, worst_mean
from eval.report.style import BLUE, GREEN, VERMILION, save_figure
from eval.report.text import markdown_table, rounded
from eval.studies.steps.study import ADVANCES, BESIDE, SHOWN, Found


def table(found: list[Found]) -> str:
    """A row for each step."""
    rows = []
    for advance, of in zip([*ADVANCES, BESIDE], found, strict=True):
        costs = of.metrics["cost"]
        cost, *others = (rounded(name, average(name, of.metrics[name])) for name in SHOWN)
        tail = [f"{costs.mean():.0f}", f"{worst_mean(costs):.0f}", str(of.left)]
        rows.append([advance.title, f"`{advance.name}`", cost, *tail, *others])
    head = ["step", "controller", "cost", "mean", "worst 5 %", "left", *map(heading, SHOWN[1:])]
    return markdown_table(head, rows, "ll" + "r" * (len(head) - 2))


def draw(found: list[Found]) -> Figure:
    """A waterfall of the cost: what each step takes off or adds."""
    levels = [interquartile_mean(of.metrics["cost"]) for of in found[: len(ADVANCES)]]
    figure, axis = plt.subplots(figsize=(9, 4.6))
    for k, level in enumerate(levels):
        before = levels[k - 1] if k else 0.0
        yardstick = k == len(levels) - 1
        colour = "0.6" if yardstick else BLUE if k == 0 else GREEN if level < before else VERMILION
        low, high = (0.0, level) if k == 0 or yardstick else sorted((before, level))
        axis.barh(k, high - low, left=low, color=colour, height=0.62)
        axis.text(high + 15, k, f"{level:.0f}", va="center", fontsize=10)
        if k and not yardstick:
            axis.plot([before, before], [k - 0.69, k - 0.31], color="0.5", lw=0.8)
    axis.set_yticks(range(len(levels)), [advance.title for advance in ADVANCES], fontsize=9.5)
    axis.invert_yaxis()
    axis.set_xlim(0, 1.1 * max(levels))
    axis.set_xlabel("cost, interquartile mean")
    axis.grid(axis="x", color="0.9", lw=0.6)
    axis.set_axisbelow(True)
    for side in ("top", "right", "left"):
        axis.spines[side].set_visible(False)
    figure.tight_layout()
    return figure


def markdown(found: list[Found], folder: Path, origin: str) -> str:
    """The content of summary.md; the picture is drawn into the folder."""
    save_figure(draw(found), folder / "waterfall.png", dpi=110, bbox_inches="tight")
    arms = len(found[0].metrics["cost"])
    parts = [
        "# From the controller of 1991 to the best classical one",
        "What each step from the paper's controller to the best classical one brings on the drive as it is built. "
        f"{arms} arms and drives of the training ranges with random moves (seeds {LOOPS.first} to "
        f"{LOOPS.first + arms - 1}), the same for all. Controllers have their tuned gains; the steps of the "
        "identification have those of `adaptive`, with what is not yet identified held at the design model's value.",
        "![Waterfall of the cost](waterfall.png)",
        "Cost is the interquartile mean, beside it the mean, the mean of the worst 5 % of the arms, and how many arms "
        "left the workspace; then interquartile means (of shares: means).",
        table(found),
        "A step need not help. Constants of the arm alone, identified as if the drive were what the data sheet says, "
        "take its delay, friction and ripple for something else; the last row has the same law with nothing "
        "identified.",
        origin,
    ]
    return "\n\n".join(parts) + "\n"
