"""What the guard is worth, as a page in Markdown with a picture."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from baselines.guard.settings import GuardSettings
from eval.comparison.sets import SetLabel
from eval.guarding.faults import EARLIEST, FAULTS, LATEST
from eval.guarding.study import BASES, LEARNED, MEASURES, NAN, Health, Outcome
from eval.report.style import BLUE, GREEN, VERMILION, save_figure
from eval.report.text import markdown_table, number

MARGIN = 1.1
"""What the guarded controller may come to, over its base alone."""
_DIGITS = {"peak": 1, "left": 0, "energy": 1}


class Compared(NamedTuple):
    """One controller under one fault."""

    name: str
    fault: str
    base: Outcome  # its base alone; of a classical controller itself, without the guard
    without: Outcome
    guarded: Outcome

    @property
    def worse(self) -> list[str]:
        """Measures by which the guarded controller is worse than its base alone, beyond the margin."""
        return [of for of in MEASURES if getattr(self.guarded, of) > MARGIN * getattr(self.base, of) + 1e-9]


Results = list[Compared]


def _cell(one: Compared, measure: str) -> str:
    """Base alone, without and with the guard; the base once where it is the controller itself."""
    shown = [one.without, one.guarded] if one.name not in LEARNED else [one.base, one.without, one.guarded]
    texts = [number(getattr(outcome, measure), _DIGITS[measure]) for outcome in shown]
    if measure in one.worse:
        texts[-1] = f"**{texts[-1]}**"
    return " → ".join(texts)


def table(results: Results, name: str) -> str:
    """All faults of one controller."""
    order = f"`{BASES[name]}` alone → without → with the guard" if name in LEARNED else "without → with the guard"
    rows = [
        [one.fault, *(_cell(one, measure) for measure in MEASURES), number(one.guarded.passive, 0)]
        for one in results
        if one.name == name
    ]
    head = [f"`{name}`: {order}", *MEASURES.values(), "made passive (%)"]
    return markdown_table(head, rows)


def shortfalls(results: Results) -> str:
    """Sentences about where the guarded controller is worse than its base alone."""
    found = [(one, measure) for one in results for measure in one.worse]
    count = len(results) * len(MEASURES)
    if not found:
        return f"In all {count} comparisons the guarded controller is within 10 % of its base alone, or better."
    lines = [
        f"- `{one.name}`, {one.fault}: {MEASURES[of]} {number(getattr(one.guarded, of), _DIGITS[of])} against "
        f"{number(getattr(one.base, of), _DIGITS[of])} of `{BASES[one.name]}` alone; peak tip error "
        f"{number(one.guarded.peak, 1)} against {number(one.base.peak, 1)} mm."
        for one, of in found
    ]
    return f"In {count - len(found)} of {count} comparisons it is within 10 %, or better. It is not in these:\n\n" + (
        "\n".join(lines)
    )


def health_table(healthy: dict[tuple[str, str], Health]) -> str:
    """Cost with and without the guard where nothing breaks."""
    rows = [
        [
            f"`{name}`",
            split,
            number(found.before, 1),
            number(found.after, 1),
            number(100 * (found.after / found.before - 1), 2),
            number(100 * found.changed, 3),
            number(100 * found.arms, 0),
            number(100 * found.fallen, 1),
        ]
        for (name, split), found in healthy.items()
    ]
    head = ["controller", "split", "mean cost without", "with", "change (%)", "commands changed (%)", "on arms (%)"]
    return markdown_table([*head, "fell back (% of arms)"], rows, "llrrrrrr")


def draw(results: Results) -> Figure:
    """Peak tip error of the learned methods under every fault."""
    figure = plt.figure(figsize=(11, 4.2))
    axes = figure.subplots(1, len(LEARNED), sharex=True, sharey=True, squeeze=False)[0]
    shown = {"base": ("base alone", BLUE, "s"), "without": ("without the guard", VERMILION, "o")}
    shown["guarded"] = ("with the guard", GREEN, "D")
    for axis, name in zip(axes, LEARNED, strict=True):
        own = [one for one in results if one.name == name]
        for k, (field, (label, colour, marker)) in enumerate(shown.items()):
            peaks = [getattr(one, field).peak for one in own]
            heights = [place + 0.22 * (k - 1) for place in range(len(own))]
            axis.plot(peaks, heights, marker, color=colour, ms=6, label=label)
        axis.set_yticks(range(len(own)), [one.fault for one in own])
        axis.set_title(f"{name} on {BASES[name]}", fontsize=10)
        axis.set_xscale("log")
        axis.set_xlabel("peak tip error, mean (mm)")
        axis.grid(axis="x", color="0.9", lw=0.6)
        axis.set_axisbelow(True)
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
    axes[0].invert_yaxis()
    marks = axes[0].get_legend_handles_labels()
    figure.legend(*marks, frameon=False, fontsize=9, loc="lower center", ncols=len(shown))
    figure.tight_layout(rect=(0, 0.05, 1, 1))
    return figure


def _levels(settings: GuardSettings) -> str:
    return "\n".join(
        [
            "- **The base without its residual**, where the residual is no number, out of its range, or at its limit "
            f"for more than {settings.saturation} s.",
            "- **The servo `flat`**, where a planning base's observer is surprised (its innovations are "
            f"{settings.surprise} times as large as expected, squared), or begins anew; where a sample is lost, or no "
            "motor can have made it; or where the base's torque is no number. A base that does not plan stays.",
            "- **No torque**, for the rest of the move, where the encoder is not believed any more. Friction stops the "
            "motor.",
        ]
    )


def markdown(
    results: Results, healthy: dict[tuple[str, str], Health], arms: int, label: SetLabel, folder: Path, origin: str
) -> str:
    """The content of summary.md; the picture is drawn into the folder."""
    save_figure(draw(results), folder / "peak.png", dpi=110, bbox_inches="tight")
    settings = GuardSettings()
    parts = [
        "# What the guard is worth",
        "**Arms of the training ranges, on which the guard was developed: no test results.**",
        "The guard (`baselines/guard`) is between a controller and the motor. It limits the torque, and its change to "
        f"{settings.slew:g} times the limit per sample. It falls back, within {1000 * settings.fade:.0f} ms, to",
        _levels(settings),
        f"It returns after {settings.wait} s of good behaviour; twice as long after each further fall. It does not "
        "know which fault there is.",
        "## Faults",
        "\n".join(f"- **{name}**: {text}." for name, text in FAULTS.items()),
        f"Each begins within the move, at a share of it from {EARLIEST} to {LATEST} that differs from arm to arm, and "
        "lasts to the end. A command that is not a number counts as no torque. The torque energy is the integral of "
        "the squared torque; of an arm that left the workspace, what the episode would have come to at the rate "
        "until then. Its peak tip error is that at which it left, so it can be larger in truth.",
        f"{arms} arms with one move each, the same for all; means. Bold: more than 10 % above the base alone under "
        f"the same fault. “{NAN}” is a fault of learned methods alone. Learned: training seed 0.",
        "![Peak tip error under each fault](peak.png)",
        *(table(results, name) for name in BASES),
        "## Against the base alone",
        shortfalls(results),
        "What a residual adds to the torque where nothing breaks, it adds where something does, until the guard fades "
        "it out: a base that works less, and follows less well, keeps its lead in energy. Where the encoder lies, no "
        "guard saves the move: the arm stops where friction lets it, and what is left is the way to the goal.",
        "## Where nothing breaks",
        f"**{label.note}** The same scenarios with and without the guard. Its thresholds are set so that arms of the "
        "training ranges do not reach them; beyond these, on `drive` and `sensing`, some may.",
        health_table(healthy),
        origin,
    ]
    return "\n\n".join(parts) + "\n"
