"""Speed of environments, controllers and training, each beside a peer in the same run.

Runs take turns; times and ratios are medians over the repetitions, start-ups the best of theirs. Between machines,
compare the ratios to the peer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from eval.report.style import BLUE, GREEN, ORANGE, PINK, SKY, VERMILION
from eval.report.text import markdown_table
from eval.speed import sizes, stepping
from eval.studies._frame import Pictures, StudyOptions

Part = Literal["steps", "rollouts", "start", "training", "sizes"]
PARTS: tuple[Part, ...] = ("steps", "rollouts", "start", "training", "sizes")
QUICK: Mapping[str, Any] = {"parts": ("steps", "sizes"), "arms": 64, "repetitions": 1, "steps": 2, "largest": 20}
_LOOKS = ((VERMILION, "o-"), (ORANGE, "o--"), (BLUE, "s-"), (GREEN, "^-"), (PINK, "v-"), (SKY, "v--"))


@dataclass(frozen=True)
class Options(StudyOptions):
    """Options of the measurement."""

    bounds: ClassVar[Mapping[str, tuple[int, int | None]]] = {
        **dict.fromkeys(("arms", "steps", "largest"), (1, 1_000_000)),
        "repetitions": (1, 1000),
    }

    parts: tuple[Part, ...] = PARTS
    """Parts to measure: steps of environments; rollouts with controllers; start-up and memory; PPO's training loop;
    steps over the size of the batch, beside all peers that are installed (extra `bench`)."""
    arms: int = 4096
    """Arms of the batch."""
    repetitions: int = 9
    """Repetitions of each measurement."""
    steps: int = 100
    """Steps per repetition of a batch. Single arms take a hundred times as many."""
    largest: int = 100_000
    """Largest batch beside the peers."""


def measure(options: Options) -> dict[str, Any]:
    """Measure the chosen parts."""
    arms, steps, repetitions, parts = options.arms, options.steps, options.repetitions, options.parts
    rows = []
    data: dict[str, Any] = {"repetitions": repetitions, "sizes": {}, "rates": {}}
    if "steps" in parts:
        rows += [*stepping.batch_rows(arms, steps, repetitions), *stepping.single_rows(steps, repetitions)]
    if "rollouts" in parts:
        rows += stepping.rollout_rows(repetitions)
    if "start" in parts:
        rows += [*stepping.start_up_rows(repetitions), *stepping.memory_rows()]
    if "training" in parts:
        rows += stepping.training_rows(repetitions)
    if "sizes" in parts:
        data["sizes"] = [size for size in sizes.SIZES if size <= options.largest]
        data["rates"] = sizes.rates(data["sizes"], repetitions)
    return {**data, "rows": [row._asdict() for row in rows]}


def tables(data: dict[str, Any]) -> dict[str, Any]:
    """Tables of speeds, and of speeds over the size of the batch."""
    speeds = markdown_table(("what", "measured", "peer", "ratio", "middle half"), map(_cells, data["rows"]), "lrrrr")
    rates = {name: [_rounded(median) for _, median, _ in quartiles] for name, quartiles in data["rates"].items()}
    over_sizes = zip([f"{size:,}" for size in data["sizes"]], *rates.values(), strict=False)
    return {
        "speeds": speeds,
        "sizes": markdown_table(("arms or carts", *rates), over_sizes, "r" * (1 + len(rates))) if rates else "",
    }


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    measured, ratios = _quantity(row["measured"], row["unit"]), [f"{ratio:.2f}" for ratio in row["ratios"]]
    peer = f"{row['peer']}: {_quantity(row['of_peer'], row['unit'])}" if ratios else "–"
    ratio = f"{ratios[len(ratios) // 2]}x" if ratios else "–"
    return row["what"], measured, peer, ratio, f"{ratios[0]} to {ratios[2]}" if len(ratios) == 3 else "–"


def _quantity(value: float, unit: str) -> str:
    if unit == "steps/s":
        return f"{_rounded(value)} {unit}"
    return f"{value:.0f} {unit}" if value >= 100 else f"{value:.2g} {unit}"


def _rounded(rate: float) -> str:
    """Format steps per second with two digits or more."""
    for unit, name in ((1e6, " M"), (1e3, " k")):
        if rate >= unit:
            return f"{rate / unit:.1f}{name}" if rate < 100 * unit else f"{rate / unit:.0f}{name}"
    return f"{rate:.0f}"


def pictures(data: dict[str, Any]) -> Pictures:
    """Steps per second over the size of the batch."""
    return {"sizes.png": lambda: _draw(data["sizes"], data["rates"])} if data["rates"] else {}


def _draw(batch_sizes: list[int], rates: dict[str, Any]) -> Figure:
    """Draw medians, and the range between the quartiles."""
    figure, axes = plt.subplots(figsize=(9, 5))
    looks: dict[str, tuple[str, str]] = dict(zip(sizes.STEPPERS, _LOOKS, strict=True))
    for name, quartiles in rates.items():
        (colour, look), (low, median, high) = looks[name], np.array(quartiles).T
        axes.plot(batch_sizes, median, look, color=colour, markersize=5, label=name)
        axes.fill_between(batch_sizes, low, high, color=colour, alpha=0.2, linewidth=0)
    axes.set(xscale="log", yscale="log", xlabel="arms or carts of the batch", ylabel="steps per second, one core")
    axes.grid(color="0.9", lw=0.6)
    axes.legend(frameon=False, fontsize=9)
    axes.spines[["top", "right"]].set_visible(False)
    return figure
