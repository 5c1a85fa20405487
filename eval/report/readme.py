"""The comparison's parts of the README, from the content of its results.json."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from beltarm_env.metrics import NOT_ARRIVED, TORQUE_QUALITY
from eval.comparison.splits import SPLITS
from eval.report.table import Results, Table, to_markdown

_SHOWN = ("tip_rms_mm", "residual_pp_mm", "settling_s", "failure_share", NOT_ARRIVED, *TORQUE_QUALITY)
_ANSWERED = {
    "cost": "cost",
    "tip_rms_mm": "error of the arm's end, RMS (mm)",
    "residual_pp_mm": "vibration after the move, peak to peak (mm)",
}
_ROWS = 5  # of the answer's table


def blocks(content: dict[str, Any]) -> dict[str, str]:
    """Parts of the README by the name of their markers."""
    results = Results(content)
    return {"answer": _answer(results), "results": _tables(results)}


def _answer(results: Results) -> str:
    """The verdict, and methods on the main split: the best, and the first of all, the paper's controller."""
    first, *others = results.content["verdict"] or ["There is no verdict."]
    table = results.of_split(results.main, list(_ANSWERED))
    reference = results.content["rows"][0]["method"]
    rows = [row for row in table.ranked if row.method != reference][: _ROWS - 1]
    rows += [row for row in table.ranked if row.method == reference]
    shown = Table(
        table.title, list(_ANSWERED.values()), [replace(row, method=f"{row.method} ({row.kind})") for row in rows]
    )
    note = f"{SPLITS[results.main].description.capitalize()}; interquartile means, lower is better. {results.note}"
    return "\n\n".join([" ".join([f"**{first}**", *others]), to_markdown(shown, intervals=False), f"*{note}*"])


def _tables(results: Results) -> str:
    """Cost on every split, and more metrics of the main one, without intervals."""
    costs, more = results.across_splits("cost"), results.of_split(results.main, _SHOWN)
    origin = results.content["provenance"]
    took = ", part of it from an earlier run" if origin["pairs_kept_before"] else f", {origin['seconds']:.0f} s"
    oracle = " In italics: an oracle, told the true arm and its state, not ranked." if costs.unranked else ""
    return "\n\n".join(
        [
            "Cost on every split:",
            to_markdown(costs, intervals=False, seeds=True),
            f"More of `{results.main}`:",
            to_markdown(more, intervals=False, seeds=True),
            f"{results.episodes} scenarios per split of the {results.label.title}; interquartile means (shares: "
            f"means). **Bold**: the best of its column; <ins>underlined</ins>: not shown to differ from it.{oracle} "
            f"From `{origin['command']}`{took}.",
        ]
    )


def updated(readme: str, parts: dict[str, str]) -> str:
    """README with each part between its markers.

    Raises:
        ValueError: If markers are missing.
    """
    for name, text in parts.items():
        begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
        if begin not in readme or end not in readme:
            raise ValueError(f"README.md has no {begin} and {end} to write between")
        before, rest = readme.split(begin, 1)
        _, after = rest.split(end, 1)
        readme = f"{before}{begin}\n\n{text}\n\n{end}{after}"
    return readme
