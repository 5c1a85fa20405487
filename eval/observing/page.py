"""What observers see through the encoder, as a page in Markdown with a picture."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from agents.observer.network import Observer
from agents.observer.quantities import NAMES, QUANTITIES
from eval.comparison.sets import SetLabel
from eval.observing.study import ACTING, HOLD, Seen, Watcher
from eval.report.style import BLUE, GREEN, ORANGE, save_figure
from eval.report.text import markdown_table

Results = dict[tuple[str, str, str], Seen]
"""By acting controller, split and watcher."""
_TORSION = NAMES.index("torsion")
_SHOWN_AS = {"rad": (1e3, "mrad"), "rad/s": (1.0, "rad/s"), "m": (1e3, "mm"), "m/s": (1e3, "mm/s"), "ln": (100, "%")}
"""Factor and unit in which a quantity's error is shown; that of a logarithm is about a share."""


def _splits(results: Results) -> list[str]:
    return list(dict.fromkeys(split for _, split, _ in results))


def _watchers(results: Results) -> list[str]:
    return list(dict.fromkeys(watcher for *_, watcher in results))


def _percent(share: float) -> str:
    return "–" if np.isnan(share) else f"{100 * share:.0f}"


def _left(results: Results, episodes: int) -> str:
    counts = {(name, split): episodes - seen.arms for (name, split, _), seen in results.items()}
    gone = [f"{count} under `{name}` on {split}" for (name, split), count in counts.items() if count]
    return f"Arms that left their workspace are not scored: {', '.join(gone) or 'none did'}."


def torsion_table(results: Results) -> str:
    """Error of the torsion on every split, for every acting controller."""
    watchers = _watchers(results)
    rows = [
        [
            split,
            *(f"{1e3 * results[name, split, watcher].rms[_TORSION]:.2f}" for name in ACTING for watcher in watchers),
        ]
        for split in _splits(results)
    ]
    head = [f"{watcher}, under `{name}`" for name in ACTING for watcher in watchers]
    return markdown_table(["error of the torsion, RMS (mrad)", *head], rows)


def quantities_table(results: Results, acting: str, split: str) -> str:
    """Error of every quantity on one split, and how often the truth is within one stated deviation."""
    watchers, rows = _watchers(results), []
    for k, quantity in enumerate(QUANTITIES):
        factor, unit = _SHOWN_AS[quantity.unit]
        found = [results[acting, split, watcher] for watcher in watchers]
        errors = [f"{factor * seen.rms[k]:.3g}" for seen in found]
        rows.append([f"{quantity.name} ({unit})", *errors, *(_percent(seen.within_one[k]) for seen in found)])
    head = [*(f"{watcher}, RMS" for watcher in watchers), *(f"{watcher}, within one (%)" for watcher in watchers)]
    return markdown_table(["quantity", *head], rows)


def honesty_table(results: Results, acting: str) -> str:
    """Share of the true torsion within one and two stated deviations, on every split."""
    watchers = _watchers(results)
    rows = []
    for split in _splits(results):
        found = [results[acting, split, watcher] for watcher in watchers]
        pairs = [(_percent(seen.within_one[_TORSION]), _percent(seen.within_two[_TORSION])) for seen in found]
        rows.append([split, *(" / ".join(pair) for pair in pairs)])
    return markdown_table(["torsion within one / two deviations (%)", *watchers], rows)


def size_table(watchers: dict[str, Watcher], times: dict[str, float]) -> str:
    """Size of the learned observers, and what an estimate takes."""
    rows = []
    for name, watcher in watchers.items():
        if isinstance(watcher, Observer):
            inputs = len(watcher.columns)
            weights = sum(parameter.numel() for parameter in watcher.parameters())
            products = (inputs + watcher.width) * (3 * watcher.width + 2 * len(NAMES))
            rows.append([name, f"{4e-3 * weights:.0f}", f"{products}", f"{watcher.hold}", f"{times[name]:.0f}"])
    head = ["weights (kB, single precision)", "multiplications", "every … samples", "in Python, one arm, median (µs)"]
    return markdown_table(["observer", *head], rows)


def draw(results: Results) -> Figure:
    """Error of the torsion on every split under the last acting controller."""
    splits, watchers, acting = _splits(results), _watchers(results), ACTING[-1]
    figure, axis = plt.subplots(figsize=(8.5, 0.52 * len(splits) + 1.7), layout="constrained")
    for k, (watcher, colour) in enumerate(zip(watchers, (BLUE, GREEN, ORANGE), strict=True)):
        errors = [1e3 * results[acting, split, watcher].rms[_TORSION] for split in splits]
        places = np.arange(len(splits)) + 0.26 * (k - 1)
        axis.barh(places, errors, 0.24, color=colour, label=watcher)
        for place, error in zip(places, errors, strict=True):
            axis.annotate(f"{error:.2f}", (error, place), (4, 0), textcoords="offset points", va="center", fontsize=8)
    axis.set_yticks(range(len(splits)), splits)
    axis.invert_yaxis()
    axis.set_xlabel(f"error of the torsion under {acting}, RMS (mrad)")
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
    figure.legend(frameon=False, fontsize=9, loc="outside upper center", ncols=len(watchers))
    return figure


def markdown(
    results: Results,
    watchers: dict[str, Watcher],
    times: dict[str, float],
    label: SetLabel,
    episodes: int,
    folder: Path,
    origin: str,
) -> str:
    """The content of summary.md; the picture is drawn into the folder."""
    save_figure(draw(results), folder / "torsion.png", dpi=110, bbox_inches="tight")
    splits, acting = _splits(results), ACTING[-1]
    main = "randomized" if "randomized" in splits else splits[0]
    parts = [
        "# What can be seen through the encoder",
        f"**{label.note}**",
        "Three observers of the same episodes. *filter*: the extended Kalman filter that `adaptive` identifies its arm "
        "with. *learned alone*: a GRU that has the encoder's and the reference's entries of the observation, and no "
        "filter. *learned on the filter*: a GRU that is told the filter's belief and doubts, and corrects them. The "
        "learned ones are fitted to arms of the training ranges under the torques of several controllers "
        "(`train/observer.py`); none of them acts here.",
        f"{episodes} scenarios per split, the same for all; root mean squares over all arms, of an estimate every "
        f"{HOLD} samples. Lower is better. {_left(results, episodes)}",
        "![Error of the torsion on every split](torsion.png)",
        torsion_table(results),
        f"## Everything that is estimated, on {main}",
        f"Under `{acting}`. Of constants, per commanded torque, the logarithm over the nominal value is estimated; its "
        "error is shown as a share. Within one: how often the truth lies within one deviation of the estimate, as the "
        "observer itself states it; 68 % would be honest, less is overconfident. Of the tip's errors the filter states "
        "none.",
        quantities_table(results, acting, main),
        "## Does it know when it does not know?",
        f"Under `{acting}`; honest would be 68 / 95. On splits beyond the training ranges nothing was fitted.",
        honesty_table(results, acting),
        "## Size",
        size_table(watchers, times),
        origin,
    ]
    return "\n\n".join(parts) + "\n"
