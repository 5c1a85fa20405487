"""The study of presliding as Markdown and as a picture, with the answer that its numbers give."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt

from baselines.tools.provenance import command_line, commit
from beltarm_env.metrics import METRICS
from eval.comparison.statistics import estimate, interquartile_mean
from eval.report.style import COLOURS, mark_one_two_five, save_figure
from eval.report.text import cell, markdown_table
from eval.verification.lugre import STEPS
from eval.verification.presliding import (
    CHECKED,
    CONTROLLERS,
    DEFLECTIONS,
    FRICTIONS,
    LOCATED,
    NUDGE,
    NUDGED,
    Study,
    friction_name,
)

JUDGED = ("cost", "residual_pp_mm")
_BRISTLES = tuple(map(friction_name, DEFLECTIONS))


def _metric_table(study: Study, metric: str) -> str:
    """Interquartile mean with its interval, and plain mean, of each controller with each friction."""
    rows = []
    for controller in CONTROLLERS:
        values = [study.metric(metric, controller, friction) for friction in FRICTIONS]
        cells = [f"{cell(metric, estimate(of[None]))}; {of.mean():.{METRICS[metric].digits}f}" for of in values]
        rows.append([f"`{controller}`", *cells])
    return markdown_table(["controller", *FRICTIONS], rows)


def _change(study: Study, metric: str, controller: str, friction: str) -> tuple[float, float, float]:
    """Change against the located friction, arm by arm, with its interval [% of the latter's interquartile mean]."""
    found = study.change(metric, controller, friction).difference
    unit = 0.01 * interquartile_mean(study.metric(metric, controller, LOCATED))
    return found.iqm / unit, found.low / unit, found.high / unit


def _change_table(study: Study, metric: str) -> str:
    others = (NUDGED, *_BRISTLES)
    rows = []
    for controller in CONTROLLERS:
        changes = [_change(study, metric, controller, friction) for friction in others]
        rows.append([f"`{controller}`", *(f"{d:+.1f} [{low:+.1f}, {high:+.1f}]" for d, low, high in changes)])
    return markdown_table(["controller", *others], rows)


def _ranking_table(study: Study) -> str:
    rows = []
    for friction in FRICTIONS:
        cells = [", ".join(f"`{name}`" for name in study.ranking(metric, friction)) for metric in JUDGED]
        rows.append([friction, *cells])
    return markdown_table(["friction", *(f"{METRICS[metric].title}, lowest first" for metric in JUDGED)], rows, "lll")


def _check_table(study: Study) -> str:
    rows = [
        [
            friction_name(check.deflection),
            f"{1e3 * check.tip:.2f}",
            *(f"{100 * check.costs[name]:.2f}" for name in CHECKED),
        ]
        for check in study.checks
    ]
    return markdown_table(["deflection", "tip (mm)", *(f"cost of `{name}` (%)" for name in CHECKED)], rows)


def _pairs(study: Study, metric: str, friction: str) -> tuple[list[str], list[str]]:
    """Pairs whose order is reversed, both shown; and those for which a difference is shown with one friction alone."""
    before, after = study.verdicts(metric, LOCATED), study.verdicts(metric, friction)
    shown = ("better", "worse")
    changed = {pair for pair in after if after[pair] != before[pair]}
    turned = {pair for pair in changed if after[pair] in shown and before[pair] in shown}
    return [f"`{a}` and `{b}`" for a, b in sorted(turned)], [f"`{a}` and `{b}`" for a, b in sorted(changed - turned)]


def _line(study: Study, metric: str, friction: str) -> str:
    turned, one_sided = _pairs(study, metric, friction)
    changes = {name: _change(study, metric, name, friction)[0] for name in CONTROLLERS}
    groups = study.steady, [name for name in CONTROLLERS if name not in study.steady]
    largest = [max(group, key=lambda name: abs(changes[name])) for group in groups if group]
    parts = [
        f"reversed {', '.join(turned) or 'none'}",
        f"shown with one friction alone {', '.join(one_sided) or 'none'}",
        *(f"largest change {changes[name]:+.1f} % (`{name}`)" for name in largest),
    ]
    return f"- {METRICS[metric].title}, {friction}: {'; '.join(parts)}."


def answer(study: Study) -> str:
    """What the numbers say about the order of controllers, line by line, and what follows."""
    count = len(CONTROLLERS) * (len(CONTROLLERS) - 1) // 2 * len(_BRISTLES) * len(JUDGED)
    found = {friction: sum(len(_pairs(study, metric, friction)[0]) for metric in JUDGED) for friction in _BRISTLES}
    reversals, where = sum(found.values()), [friction for friction, number in found.items() if number]
    steady = [_change(study, "cost", name, of)[0] for name in study.steady for of in _BRISTLES]
    verdict = (
        "presliding does not change conclusions, and stays left out of the plant."
        if not reversals
        else f"presliding changes conclusions at {', '.join(where)}. What is claimed of the pairs named below does not "
        "hold on a motor that gives way so far before it breaks away, and a later plant has to have bristles."
    )
    lines = [
        f"**Of {count} comparisons of two controllers, {reversals} are reversed** (a difference shown both with the "
        f"located friction and with bristles, with opposite signs): {verdict} The cost of the controllers with which "
        f"no arm leaves the workspace ({', '.join(f'`{name}`' for name in study.steady)}) changes by "
        f"{max(steady, key=abs, default=0.0):+.1f} % at most.",
        "The answer holds for these controllers and gains."
        + (
            " With the others the nudge alone changes many arms too, and few of the intervals below exclude zero: what "
            "bristles change there is hardly told from chance."
            if len(study.steady) < len(CONTROLLERS)
            else ""
        ),
        "Pairs of controllers, and the largest change among those with which no arm leaves, and among the others:",
        "\n".join(_line(study, metric, friction) for metric in JUDGED for friction in (NUDGED, *_BRISTLES)),
    ]
    return "\n\n".join(lines)


def markdown(study: Study, arms: int, checked: int, seed: int, seconds: float) -> str:
    """The content of summary.md."""
    parts = [
        "# Presliding",
        "The plant's motor sticks without moving and breaks away at once. With LuGre friction "
        "(`eval/verification/lugre.py`) it first turns by a deflection, in bristles that spring back, with hysteresis. "
        "Steady friction and breakaway torque are the same, sensors, moves and cost are the environment's own. "
        f"{arms} arms of the training ranges, lumped model; controllers as shipped, of learned ones the first seed; "
        f"deflections at the motor, of the mean friction; σ₁ half of critical, less at speed, so that friction never "
        f"creates energy; Runge–Kutta steps of at most 1/{STEPS} sample. *{NUDGED}* has the friction of the plant and "
        f"{NUDGE:g} rad more torsion at the beginning: what differs there is chance.",
        answer(study),
        "![Cost](cost.png)",
        "## Cost",
        "Interquartile mean over the arms with its bootstrap 95 % interval; plain mean.",
        _metric_table(study, "cost"),
        "Change against the located friction, arm by arm: interquartile mean of the difference with its 95 % interval, "
        "in % of the located cost.",
        _change_table(study, "cost"),
        "## Residual vibration (mm, peak to peak)",
        _metric_table(study, "residual_pp_mm"),
        "Change against the located friction, in the same way:",
        _change_table(study, "residual_pp_mm"),
        "## Ranking",
        "By the interquartile mean.",
        _ranking_table(study),
        "## The located friction as the limit of a stiff bristle",
        f"{checked} arms. *Tip*: largest distance over 1.8 s, of the median arm, given the same torques, without "
        "feedback, the larger of both controllers' torques. *Cost*: mean absolute difference in closed loop, in % of "
        "the mean cost.",
        _check_table(study),
        f"`{command_line()}`, seeds {seed} to {seed + arms - 1}, beltarm {commit()}, {seconds:.0f} s.",
    ]
    return "\n\n".join(parts) + "\n"


def save_picture(study: Study, path: Path) -> None:
    """Draw the cost over the deflection, the located friction at its left end."""
    figure, axes = plt.subplots(figsize=(7, 4.2), layout="constrained")
    shown = (LOCATED, *_BRISTLES)
    places = list(range(len(shown)))
    for k, controller in enumerate(CONTROLLERS):
        found = [estimate(study.metric("cost", controller, friction)[None]) for friction in shown]
        colour = COLOURS[k] if k < len(COLOURS) else "0.4"
        low, high = [one.low for one in found], [one.high for one in found]
        axes.fill_between(places, low, high, color=colour, alpha=0.12, linewidth=0)
        axes.plot(places, [one.iqm for one in found], "o-", color=colour, ms=4, label=controller)
    axes.set_xticks(places, list(shown))
    axes.set_yscale("log")
    mark_one_two_five(axes.yaxis)
    axes.set_xlabel("friction: located, or breakaway deflection of LuGre friction at the motor")
    axes.set_ylabel("cost, interquartile mean")
    axes.grid(alpha=0.3, which="both")
    figure.legend(loc="outside right upper", frameon=False)
    save_figure(figure, path)
