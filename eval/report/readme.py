"""The comparison's parts of the README, and the check that summary and pictures are of the same run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd
from PIL import Image

from baselines.tools.files import sha256_of
from beltarm_env.metrics import NOT_ARRIVED, TORQUE_QUALITY
from eval.comparison.methods import shipped_policies
from eval.comparison.results import COMPUTING_TIME, TIMED_NOTE
from eval.comparison.sets import SetLabel
from eval.comparison.splits import SPLITS, main_split
from eval.report.frame import frame_of_rows, lines, part
from eval.report.markdown import method_table
from eval.report.plots import RESULTS_KEY
from eval.report.text import markdown_table, number, numbers, with_unit

_SHOWN = ("tip_rms_mm", "residual_pp_mm", "settling_s", "failure_share", NOT_ARRIVED, *TORQUE_QUALITY)
_ANSWERED = {
    "cost": "cost",
    "tip_rms_mm": "error of the arm's end, RMS (mm)",
    "residual_pp_mm": "vibration after the move, peak to peak (mm)",
}
_ROWS = 5  # of the answer's table


def blocks(results: dict[str, Any]) -> dict[str, str]:
    """Parts of the README by the name of their markers, from the content of results.json."""
    return {"answer": answer(results), "results": tables(results)}


def answer(results: dict[str, Any]) -> str:
    """The answer in two sentences, and methods on the main split: the best, and the paper's controller."""
    found = frame_of_rows(results["rows"])
    home = main_split(list(found.split.unique()))
    on_main = _best_first(part(found, split=[home], metric=list(_ANSWERED)))
    on_main = on_main.sort_values("metric", key=lambda names: names.map(list(_ANSWERED).index), kind="stable")
    ranked = list(dict.fromkeys(on_main[on_main.kind != "privileged"].method))
    reference = results["rows"][0]["method"]
    best = [name for name in ranked if name != reference][: _ROWS - 1]
    shown = part(on_main, method=[*best, reference])
    rows = [[f"{line.method} ({line.kind})", *line.cells] for line in lines(shown, "metric", _precise, "–")]
    table = markdown_table(["method", *_ANSWERED.values()], rows)
    note = (
        f"{SPLITS[home].description.capitalize()}; interquartile means, lower is better. "
        f"{SetLabel(**results['scenario_set']).note_with(_own(results))}"
    )
    return "\n\n".join([in_short(results, home), table, f"*{note}*"])


def _own(results: dict[str, Any]) -> list[str]:
    """Methods that do not come with the project."""
    shipped = {folder.parent.name for folder in shipped_policies()}
    own = {
        row["method"]
        for row in results["rows"]
        if row["kind"] == "learned" and row["method"].removesuffix("+guard") not in shipped
    }
    return sorted(own | {row["method"] for row in results["rows"] if row["kind"] == "added"})


def in_short(results: dict[str, Any], split: str) -> str:
    """The primary comparison on one split in two sentences; the verdict's first sentence where it was not decided."""
    duels = {row["metric"]: row for row in results.get("primary", []) if row["split"] == split}
    if not duels:
        return f"**{next(iter(results['verdict']), 'There is no verdict.')}**"
    cost, vibration = duels["cost"], duels.get("residual_pp_mm")
    here = {row["method"]: row for row in results["rows"] if row["split"] == split}
    classical = [name for name, row in here.items() if row["kind"] == "classical"]
    best = min(classical, key=lambda name: here[name]["metrics"]["cost"]["iqm"]) == cost["classical"]
    one = f"the learned correction, `{cost['challenger']}`,"
    other = f"the {'best ' if best else ''}classical controller, `{cost['classical']}`"
    less = "lower" if cost["relative"] < 0 else "higher"
    costs = {
        "open": f"No difference in cost is shown between {one} and {other}",
        "shown": f"Scenario by scenario, {one} has a cost {abs(cost['relative']):.0%} {less} than {other}",
    }
    first = costs["open" if cost["result"] == "open" else "shown"]
    swings = f" {_swings(vibration, here)}" if vibration else ""
    return f"**{first}.**{swings}{_elsewhere(results['primary'])}"


def _swings(duel: dict[str, Any], here: dict[str, Any]) -> str:
    """Sentence about the vibration, by its duel and the rows of its split."""
    before, after = (
        with_unit("residual_pp_mm", f"{here[duel[name]]['metrics']['residual_pp_mm']['iqm']:.2f}")
        for name in ("classical", "challenger")
    )
    words = {
        "better": f"falls from {before} to {after}",
        "worse": f"rises from {before} to {after}",
        "open": f"is not shown to differ: {after} and {before}",
    }
    return f"The vibration after the move {words[duel['result']]}."


def _precise(row: Any) -> str:
    """An average, to a hundredth where it is a length."""
    return numbers(row.metric, row)[0] if row.metric == "cost" else number(row.iqm, 2)


def _elsewhere(duels: list[dict[str, Any]]) -> str:
    """On how many splits the cost of the challenger is lower, higher or not shown to differ."""
    found = [duel["result"] for duel in duels if duel["metric"] == "cost"]
    if len(found) == 1:
        return ""
    words = {"better": "lower on {}", "worse": "higher on {}", "open": "not shown to differ on {}"}
    parts = [text.format(found.count(result)) for result, text in words.items() if result in found]
    return f" Of {len(found)} kinds of scenarios the cost is {', '.join(parts)}."


def tables(results: dict[str, Any]) -> str:
    """Cost on every split, and more metrics of the main one; best first, without intervals, which the summary has."""
    found = frame_of_rows(results["rows"])
    home = main_split(list(found.split.unique()))
    parts = [
        " ".join(results["verdict"]),
        "Cost on every split:",
        method_table(_best_first(part(found, metric=["cost"])), "split", with_seeds=True, intervals=False),
        f"More of `{home}`:",
        method_table(_best_first(part(found, split=[home], metric=_SHOWN), found), "metric", True, intervals=False),
        _origin(results),
    ]
    return "\n\n".join(part for part in parts if part)


def _best_first(found: pd.DataFrame, of: pd.DataFrame | None = None) -> pd.DataFrame:
    """Rows by the method's cost on the main split; `of` has it where `found` has not."""
    costs = part(found if of is None else of, metric=["cost"])
    home = main_split(list(costs.split.unique()))
    by_cost = part(costs, split=[home]).set_index("method").iqm
    order = found.method.map(by_cost)
    return found.assign(order=order).sort_values("order", kind="stable").drop(columns="order")


def _origin(results: dict[str, Any]) -> str:
    provenance, episodes = results["provenance"], results["rows"][0]["episodes"]
    label = SetLabel(**results["scenario_set"])
    unranked = any(row["kind"] == "privileged" for row in results["rows"])
    italics = " In italics: a yardstick, told the true arm and its state, not ranked." if unranked else ""
    fresh = not provenance.get("pairs_kept_before", 0)
    timed = f" {TIMED_NOTE}" if provenance.get(COMPUTING_TIME) else ""
    took = f", which took {provenance['seconds']:.0f} s" if fresh else ", part of it from an earlier run"
    return (
        f"{episodes} scenarios per split of the {label.title}; interquartile means (shares: means); "
        f"intervals are in the summary.{italics}{timed} From `{provenance['command']}`"
        f"{took}."
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


def of_other_results(results: Path) -> list[Path]:
    """Summary and pictures beside a results.json that do not carry its SHA-256: they are of other results."""
    digest = sha256_of(results)
    summary = results.with_name("summary.md")
    stale = [] if summary.is_file() and digest in summary.read_text(encoding="utf-8") else [summary]
    for path in sorted(results.parent.glob("*.png")):
        with Image.open(path) as picture:
            if picture.info.get(RESULTS_KEY) != digest:
                stale.append(path)
    return stale
