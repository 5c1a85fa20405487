"""Tables of the page, from the data alone: one function for each."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from math import isfinite, nan
from typing import Any

import numpy as np

from beltarm_env.metrics import TORQUES, heading
from eval.comparison.statistics import Estimate
from eval.report.text import cell, markdown_table, number, numbers, poles_text
from eval.studies.loops.costs import IDENTIFYING, SHOWN_METRICS, WORSE
from eval.studies.loops.symbols import MEANING

Data = dict[str, Any]


def _factor(value: float) -> str:
    """A gain margin as text; a dash where there is none."""
    return f"×{value:.3g}" if isfinite(value) and value else "–"


_MARGINS: dict[str, tuple[str, Callable[[float], str]]] = {
    "gain_up": ("gain up", _factor),
    "gain_down": ("gain down", _factor),
    "phase": ("phase (°)", partial(number, digits=0)),
    "delay": ("delay (samples)", partial(number, digits=1)),
    "modulus": ("modulus", partial(number, digits=2)),
}
"""Title and text of each margin."""
_MARGIN_TITLES = [title for title, _ in _MARGINS.values()]


def tables(data: Data) -> dict[str, Any]:
    """Tables by the names that the template has for them, and names of controllers for its sentences."""
    rows = data["controllers"]
    ranked = {name: row for name, row in rows.items() if name != data["oracle"]}
    return {
        "glance": _glance(data),
        "margins": _margins(ranked),
        "corners": _corners(ranked),
        "by_arm": _by_arm(data["corners"], ranked),
        "costs": _costs(data),
        "changes": _changes(data),
        "limits": _limits(data),
        "prices": _prices(ranked),
        "ranked": ranked,
        "gap": _gap(data),
        "sections": {name: (_gains(data["gains"][name]), _shown(row["loop"])) for name, row in ranked.items()},
        "unpriced": [name for name, row in ranked.items() if data["gains"][name]["tuning"] and not row["price"]],
        "kept": [name for name, entry in data["gains"].items() if entry["tuning"] and _found_nothing(entry["tuning"])],
        "identifying": IDENTIFYING,
        "worse": WORSE,
    }


def _known(value: float | None) -> float:
    """A number of the data, NaN for none."""
    return nan if value is None else value


def _label(data: Data, name: str) -> str:
    return f"*{name}* (not ranked)" if name == data["oracle"] else name


def _labelled(data: Data) -> Iterator[tuple[str, dict[str, Any]]]:
    return ((_label(data, name), row) for name, row in data["controllers"].items())


def ratio_text(value: float, left: int = 0) -> str:
    """A ratio of costs, and how many arms left the workspace, if any."""
    return (f"{value:.2f}" if value < 9.95 else f"{value:.0f}") + (f" ({left} left)" if left else "")


def _glance(data: Data) -> str:
    """A row for each controller: what it costs, how robust it is, what it asks of motor and computer."""
    titles = ["controller", "cost", "worst 5 %", *data["limits"]]
    titles += ["least modulus", "least delay (samples)", heading("torque_reversals_hz"), "p99 (µs)"]
    rows = []
    for label, row in _labelled(data):
        iqm = row["metrics"]["cost"]["iqm"]
        cells = [f"{iqm:.0f}", f"×{ratio_text(row['worst'] / iqm)}"]
        cells += [f"×{ratio_text(effect['iqm'], effect['left'])}" for effect in row["limits"]]
        cells += _least(row["loop"]) if "loop" in row else ["–", "–"]
        cells.append(number(row["metrics"]["torque_reversals_hz"]["iqm"], 1))
        cells.append(number(row["times"]["slow"], 0) if "times" in row else "–")
        rows.append([label, *cells])
    return markdown_table(titles, rows)


def _least(loop: Data) -> list[str]:
    if not loop["stable"]:
        return ["unstable", "–"]
    return [_MARGINS[name][1](_known(loop["worst"][name]["value"])) for name in ("modulus", "delay")]


def _margins(ranked: Data) -> str:
    """On the design model each margin's worst over the angles, with the angle."""
    rows = []
    for name, row in ranked.items():
        loop = row["loop"]
        cells = ["yes" if loop["stable_design"] else "no"]
        for column, (_, text) in _MARGINS.items():
            worst = loop["worst_design"][column]
            shown = text(_known(worst["value"])) if loop["stable_design"] else "–"
            cells.append(shown if shown == "–" else f"{shown} at {worst['degrees']:.0f}°")
        rows.append([name, *cells, number(loop["slowest"], 1 if loop["slowest"] < -1 else 2)])
    return markdown_table(["controller", "stable", *_MARGIN_TITLES, "slowest pole (1/s)"], rows)


def _corners(ranked: Data) -> str:
    """Least modulus and delay margin over arms and angles, with where."""
    rows = []
    for name, row in ranked.items():
        cells = ["yes" if row["loop"]["stable"] else "no"]
        for column in ("modulus", "delay"):
            worst = row["loop"]["worst"][column]
            cells += [_MARGINS[column][1](_known(worst["value"])), f"{worst['arm']}, {worst['degrees']:.0f}°"]
        rows.append([name, *cells])
    return markdown_table(["controller", "stable", "modulus", "where", "delay (samples)", "where"], rows, "llrlrl")


def _by_arm(arms: list[str], ranked: Data) -> str:
    """Least modulus margin over the angles on each arm."""
    loops = [row["loop"] for row in ranked.values()]
    rows = [[arm, *(number(loop["modulus_by_arm"][k], 2) for loop in loops)] for k, arm in enumerate(arms)]
    return markdown_table(["arm", *ranked], rows)


def _costs(data: Data) -> str:
    """Metrics on arms as they are built, and cost on the design model."""
    head = ["controller", "cost, design model", *(heading(name) for name in SHOWN_METRICS)]
    titles = [*head, "mean cost", "worst 5 %", "left", *(heading(name) for name in TORQUES)]
    rows = []
    for label, row in _labelled(data):
        metrics = {name: Estimate(**value) for name, value in row["metrics"].items()}
        cells = [f"{row['design']:.0f}", *(cell(name, metrics[name]) for name in SHOWN_METRICS)]
        cells += [f"{row['mean']:.0f}", f"{row['worst']:.0f}", str(row["left"])]
        rows.append([label, *cells, *(numbers(name, metrics[name])[0] for name in TORQUES)])
    return markdown_table(titles, rows)


def _changes(data: Data) -> str:
    """A row for each change of the design model, a column for each controller."""
    effects = [row["changes"] for row in data["controllers"].values()]
    rows = [
        [title, *(ratio_text(effect[k]["mean"], effect[k]["left"]) for effect in effects)]
        for k, title in enumerate(data["changes"])
    ]
    return markdown_table(["change", *(_label(data, name) for name in data["controllers"])], rows)


def _limits(data: Data) -> str:
    """Cost beyond the training ranges over that within: of interquartile means, and of means."""
    rows = []
    for label, row in _labelled(data):
        pairs = ((ratio_text(e["iqm"]), ratio_text(e["mean"], e["left"])) for e in row["limits"])
        rows.append([label, *(text for pair in pairs for text in pair)])
    titles = [f"{title}, {kind}" for title in data["limits"] for kind in ("IQM", "mean")]
    return markdown_table(["controller", *titles], rows)


def _prices(ranked: Data) -> str:
    """Cost with and without margins, and what margins are left without; empty if nothing is comparable."""
    rows = []
    for name, row in ranked.items():
        if price := row["price"]:
            left = "unstable" if price["unstable"] else f"{price['modulus']:.2f}, {number(_known(price['delay']), 1)}"
            costs = [f"{price[key]:.0f}" for key in ("with", "without", "mean_with", "mean_without")]
            ratio = f"×{ratio_text(price['with'] / price['without'])}"
            rows.append([name, *costs[:2], ratio, *costs[2:], left, price["where"]])
    titles = ["controller", "cost with", "without", "price", "mean with", "without", "modulus, delay without", "where"]
    return markdown_table(titles, rows, "lrrrrrrl") if rows else ""


def _found_nothing(tuning: Data) -> bool:
    return tuning["cost"] == tuning["cost_untuned"]


def _gap(data: Data) -> str:
    """Costs over those of the clairvoyant optimum, scenario by scenario and in the mean of each kind."""
    names, optimum = data["optimum"]["names"], np.array(data["optimum"]["costs"])
    kinds = [name.split(":")[0] for name in names]
    groups = {kind: np.array([other == kind for other in kinds]) for kind in dict.fromkeys(kinds)}
    rows = [["*optimum's cost*", *(number(optimum[m].mean(), 1) for m in groups.values())]]
    rows[0] += [number(cost, 1) for cost in optimum]
    for label, row in _labelled(data):
        costs = np.array(row["optimum"])
        means = [costs[m].sum() / optimum[m].sum() for m in groups.values()]
        rows.append([label, *(ratio_text(value) for value in [*means, *costs / optimum])])
    return markdown_table(["controller", *(f"{kind}, all" for kind in groups), *names], rows)


def _gains(entry: Data) -> str:
    """Gains of one controller: symbol, value, unit and the range that is searched."""
    rows = []
    for gain in entry["values"]:
        symbol, unit = MEANING.get(gain["name"], ("", ""))
        rows.append([f"`{gain['name']}`", symbol, f"{gain['value']:.4g}", unit, _range(gain["searched"])])
    return markdown_table(["gain", "symbol", "value", "unit", "searched"], rows, "llrll")


def _range(limits: Data | None) -> str:
    return f"{limits['low']:g} to {limits['high']:g}{', log' if limits['log'] else ''}" if limits else "not tuned"


def _shown(loop: Data) -> str:
    """Margins and poles of one controller on the design model at some angles."""
    rows = []
    for row in loop["shown"]:
        cells = [text(_known(row[column])) for column, (_, text) in _MARGINS.items()]
        cells = cells if row["stable"] else ["unstable", *["–"] * (len(cells) - 1)]
        poles = np.array([complex(*pole) for pole in row["poles"]])
        rows.append([f"{np.degrees(row['angle']):.0f}°", *cells, poles_text(poles)])
    return markdown_table(["angle", *_MARGIN_TITLES, "slowest poles (1/s)"], rows)
