"""The controllers over the drive as a page in Markdown, and as data."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from beltarm_env.arrays import Floats
from beltarm_env.metrics import TORQUE_QUALITY
from beltarm_env.metrics import heading as of_metric
from beltarm_env.task.seeds import DRIVE_SIZES
from eval.comparison.statistics import estimate, interquartile_mean
from eval.drives.effects import ALL, EFFECTS, IDEAL, heading
from eval.drives.study import SHOWN, DriveStudy
from eval.report.text import markdown_table, number, rounded

_SHIPPED = "Controllers are as they are shipped. Classical ones are tuned on the training ranges, drives included."
_FIRST_EDITION = (
    "What the first edition's controllers, all made for an ideal drive, came to on such drives is kept in "
    "docs/history/first-edition/drive: why there is a second edition."
)
_ARMS = {"train": "arms and drives of the training ranges", "ideal": "arms whose drive is ideal"}
_LEADERS = 3  # controllers that the sentences follow


def costs_table(study: DriveStudy) -> str:
    """Cost with each effect at the upper end of its range, interquartile mean and mean, and the arms that left."""
    columns = (IDEAL, *EFFECTS)
    rows = [[name, *(_cell(study, name, effect) for effect in columns)] for name in study.names]
    best = [min(study.names, key=lambda name: interquartile_mean(study.cost(name, effect))) for effect in columns]
    rows.append(["*least*", *(f"*{name}*" for name in best)])
    return markdown_table(["controller", *map(heading, columns)], rows)


def _cell(study: DriveStudy, name: str, effect: str) -> str:
    costs, left = study.cost(name, effect), study.left(name, effect)
    return f"{interquartile_mean(costs):.0f} ({costs.mean():.0f})" + (f", {left} left" if left else "")


def torques_table(study: DriveStudy) -> str:
    """What the motor has to follow, on the ideal drive and with all effects at the upper ends of their ranges."""
    columns = [(metric, effect) for metric in TORQUE_QUALITY for effect in (IDEAL, ALL)]
    rows = [[name, *(rounded(of, study.level(name, at, of)) for of, at in columns)] for name in study.names]
    return markdown_table(["torques", *(f"{of_metric(of)}, {heading(at)}" for of, at in columns)], rows)


def training(trained: dict[str, str]) -> str:
    """Sentences on the arms that learned controllers were trained on; empty without such controllers."""
    found = []
    for kind in dict.fromkeys(trained.values()):
        names = [f"`{name}`" for name in trained if trained[name] == kind]
        arms = _ARMS.get(kind, "arms that their policies do not name")
        found.append(f"{_listed(names)} {'were' if len(names) > 1 else 'was'} trained on {arms}.")
    return " ".join(found)


def _listed(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def sentences(study: DriveStudy) -> list[str]:
    """What follows from the numbers."""

    def level(name: str, effect: str) -> float:
        return interquartile_mean(study.cost(name, effect))

    def ratio(name: str, effect: str) -> float:
        return level(name, effect) / level(name, IDEAL)

    leaders = sorted(study.names, key=lambda name: level(name, IDEAL))[:_LEADERS]
    order = sorted(study.names, key=lambda name: level(name, ALL))
    was = _listed([f"`{name}` ({level(name, IDEAL):.0f})" for name in leaders])
    now = _listed([f"{level(name, ALL):.0f} (×{number(ratio(name, ALL), 1)})" for name in leaders])
    places = _listed([f"{order.index(name) + 1}" for name in leaders])
    found = [
        f"On the ideal drive {was} cost least. With all effects at the upper ends of their ranges they cost {now}, and "
        f"take the places {places} of {len(order)}; the least is `{order[0]}` with {level(order[0], ALL):.0f} "
        f"(×{number(ratio(order[0], ALL), 1)}).",
    ]
    harms = []
    for name in leaders:
        worst = sorted((effect for effect in EFFECTS if effect != ALL), key=lambda effect: -ratio(name, effect))[:2]
        harms.append(
            f"`{name}` {' and '.join(f'{heading(effect)} (×{number(ratio(name, effect), 1)})' for effect in worst)}"
        )
    found.append(f"By themselves, the effects that raise the cost of these most are: for {'; for '.join(harms)}.")
    bent = [
        (name, effect) for effect in EFFECTS if effect != ALL for name in study.names if _falls(study, name, effect)
    ]
    if bent:
        over = _listed([EFFECTS[effect].title for effect in dict.fromkeys(effect for _, effect in bent)])
        whose = _listed([f"`{name}`" for name in dict.fromkeys(name for name, _ in bent)])
        found.append(
            f"More of an effect need not cost more: over the {over} the cost of {whose} rises and falls to less than "
            "half. Between the sizes that are shown it may do so as well."
        )
    steady = [name for name in study.names if max(ratio(name, effect) for effect in EFFECTS) < 1.25]
    lost = {name: sum(study.left(name, effect) for effect in EFFECTS) for name in study.names}
    lost = [f"`{name}` {count}" for name, count in lost.items() if count]
    among = f"of {study.arms * len(EFFECTS)} arms each"
    found.append(
        (f"No effect raises the cost of {_listed([f'`{name}`' for name in steady])} by a quarter. " if steady else "")
        + (f"Arms left the workspace, {among}: {_listed(lost)}." if lost else "No arm left the workspace.")
    )
    return found


def _falls(study: DriveStudy, name: str, effect: str) -> bool:
    """Whether the cost at some size is below half of that at a smaller one."""
    levels = np.array([interquartile_mean(values) for values in study.found[name, effect].metrics["cost"]])
    return bool((levels < 0.5 * np.maximum.accumulate(levels)).any())


def markdown(study: DriveStudy, pictures: Sequence[Path], origin: str) -> str:
    """The content of summary.md."""
    shown = {path.stem: path.name for path in pictures}
    first, last = DRIVE_SIZES.first, DRIVE_SIZES.first + study.arms - 1
    sizes = ", ".join(f"{size:g}" for size in study.sizes)
    parts = [
        "# Controllers on a drive that is not ideal",
        "Cost and vibration over the size of each effect of the drive, one effect at a time and all of them together. "
        f"{' '.join(filter(None, (_SHIPPED, training(study.trained), _FIRST_EDITION)))}",
        f"{study.arms} arms of the training ranges with random moves (seeds {first} to {last}), the same for every "
        "controller, effect and size. Phases, orders, Stribeck speeds and the signs of the torque constant's error and "
        f"of the drift are drawn from the training ranges; the effects have {sizes} times the upper end of theirs. One "
        "training seed of the learned controllers. Lower is better everywhere.",
        *sentences(study),
        f"![Cost over the size of each effect]({shown['cost']})",
        "*Interquartile means over the arms; grey: beyond the training ranges.*",
        "## Cost at the upper ends of the training ranges",
        "Interquartile mean, in parentheses the mean, and the number of arms that left the workspace.",
        costs_table(study),
        "## Torques",
        "What the motor has to follow, and what tells a controller that hammers; interquartile means, of shares means.",
        torques_table(study),
        "## Tip and residual vibration",
        f"![RMS error of the tip over the size of each effect]({shown['tip_rms']})",
        f"![Residual vibration over the size of each effect]({shown['residual']})",
        "All numbers, with bootstrap 95 % intervals, are in [results.json](results.json).",
        origin,
    ]
    return "\n\n".join(parts) + "\n"


def as_json(study: DriveStudy, provenance: dict[str, object]) -> str:
    """The content of results.json: a row for each controller, effect and size, one a line."""
    rows = []
    for (name, effect), outcome in study.found.items():
        for k, size in enumerate(study.sizes):
            row = {"method": name, "effect": effect, "size": size, "episodes": study.arms}
            metrics = {metric: _estimates(outcome.metrics[metric][k]) for metric in SHOWN}
            rows.append(json.dumps({**row, "left_workspace": int(outcome.left[k].sum()), "metrics": metrics}))
    listed = ",\n".join(rows)
    return f'{{"provenance": {json.dumps(provenance | {"trained": study.trained})},\n"rows": [\n{listed}\n]}}\n'


def _estimates(values: Floats) -> dict[str, float]:
    found = {**asdict(estimate(values[None])), "mean": float(np.mean(values))}
    return {name: round(value, 3) for name, value in found.items()}
