"""What an accelerometer buys, as a page in Markdown with a picture."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from beltarm_env.metrics import TORQUE_QUALITY, heading
from eval.comparison.sets import SetLabel
from eval.comparison.statistics import average, interquartile_mean, paired
from eval.report.style import BLUE, GREEN, ORANGE, save_figure
from eval.report.text import cell, markdown_table, rounded
from eval.sensing.study import COMPARED, NAMES, TIERS, Results, Times

_COLOURS = dict(zip(NAMES, (BLUE, ORANGE, GREEN), strict=True))


def splits_of(results: Results) -> list[str]:
    """Splits of the results, in their order."""
    return list(dict.fromkeys(split for _, split, _ in results))


def table(results: Results, name: str) -> str:
    """Every split with and without the accelerometer, and the difference on the same scenarios."""
    rows = []
    for split in splits_of(results):
        without, with_it = (results[name, split, tier] for tier in TIERS)
        cells = []
        for metric in COMPARED:
            levels = [rounded(metric, interquartile_mean(found.metrics[metric])) for found in (without, with_it)]
            pair = paired(with_it.metrics[metric][None], without.metrics[metric][None])
            cells += [" → ".join(levels), cell(metric, pair.difference)]
        rows.append([split, *cells, f"{without.left} → {with_it.left}"])
    head = [word for metric in COMPARED for word in (heading(metric), "difference")]
    return markdown_table([f"`{name}` on", *head, "left"], rows)


def torques_table(results: Results, split: str, times: Times) -> str:
    """What the motor has to follow, what the filter knows, and what it takes, on one split."""
    rows = []
    for (name, at, tier), found in results.items():
        if at == split:
            levels = [rounded(metric, average(metric, found.metrics[metric])) for metric in TORQUE_QUALITY]
            rows.append([f"`{name}`", tier, *levels, f"{1000 * found.torsion:.2f}", f"{times[name, tier]:.0f}"])
    head = [*map(heading, TORQUE_QUALITY), "error of the torsion, RMS (mrad)", "per action, one arm, median (µs)"]
    return markdown_table(["controller", "sensors", *head], rows, "ll" + "r" * len(head))


def draw(results: Results) -> Figure:
    """Cost on every split: without the accelerometer a ring, with it a disc."""
    splits = splits_of(results)
    figure, axis = plt.subplots(figsize=(8.5, 0.8 * len(splits) + 1.9), layout="constrained")
    for place, split in enumerate(splits):
        for k, name in enumerate(NAMES):
            before, after = (interquartile_mean(results[name, split, tier].metrics["cost"]) for tier in TIERS)
            height = place + 0.26 * (k - 1)
            axis.plot([before, after], [height, height], color=_COLOURS[name], lw=2.2, alpha=0.45, zorder=1)
            axis.plot(before, height, "o", mfc="white", mec=_COLOURS[name], ms=7)
            axis.plot(after, height, "o", color=_COLOURS[name], ms=7)
            axis.annotate(
                f"{after:.0f}",
                (min(before, after), height),
                (-8, 0),
                textcoords="offset points",
                ha="right",
                va="center",
            )
    for name in NAMES:
        axis.plot([], [], "o-", color=_COLOURS[name], mfc="white", label=f"{name}, encoder")
        axis.plot([], [], "o-", color=_COLOURS[name], label=f"{name}, with the accelerometer")
    axis.set_yticks(range(len(splits)), splits)
    axis.set_ylim(len(splits) - 0.5, -0.5)
    axis.set_xlim(left=0)
    axis.set_xlabel("cost, interquartile mean")
    axis.grid(axis="x", color="0.9", lw=0.6)
    axis.set_axisbelow(True)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
    figure.legend(frameon=False, fontsize=9, loc="outside upper center", ncols=len(NAMES))
    return figure


def markdown(results: Results, times: Times, label: SetLabel, folder: Path, origin: str) -> str:
    """The content of summary.md; the picture is drawn into the folder."""
    save_figure(draw(results), folder / "cost.png", dpi=110, bbox_inches="tight")
    splits = splits_of(results)
    main = "randomized" if "randomized" in splits else splits[0]
    episodes = len(results[NAMES[0], main, TIERS[0]].metrics["cost"])
    parts = [
        "# What an accelerometer buys",
        f"**{label.note}**",
        "The best classical controllers and a student, with the motor's encoder alone and with an accelerometer on the "
        'arm\'s end beside it (`sensors="accelerometer"`: a MEMS part, low-passed, noisy, with a zero-g output of its '
        "own). The laws of `adaptive` and `preview` and their gains are the same, tuned for the encoder alone; only "
        "the filter has two readings more, with the noise of the part's data sheet. Of `student` there is one for each "
        "set of sensors, both with training seed 0; that with the accelerometer (`python train/student.py --sensors "
        "accelerometer`) sees its readings, and corrects the `adaptive` that has them. A track of its own, ranked with "
        "nothing.",
        f"{episodes} scenarios per split, the same for all; interquartile means, and the interquartile mean of the "
        "differences on the same scenarios with its bootstrap 95 % interval. Lower is better; encoder → with the "
        "accelerometer. Left: arms that left the workspace.",
        "![Cost on every split, with and without the accelerometer](cost.png)",
        *(table(results, name) for name in NAMES),
        f"## Torques, knowledge and time on {main}",
        torques_table(results, main, times),
        "Error of the torsion: estimated less true, over all samples and arms.",
        origin,
    ]
    return "\n\n".join(parts) + "\n"
