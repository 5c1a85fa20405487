"""Tables and numbers of a comparison's page, and of its parts of the README, from a results.json alone.

The words are in `docs/results/comparison`: `page.md.j2`, and for the README a template for each of `BLOCKS`.
"""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from beltarm_env import metrics
from eval.comparison.cache import CHANGE, PERTURBATION
from eval.comparison.results import MOSTLY, PAIRED_METRICS
from eval.comparison.schema import AGAINST
from eval.comparison.splits import EDITION, SPLITS
from eval.comparison.statistics import LEAST_OF_TAIL, LEAST_P, LEAST_SCENARIOS, RESAMPLES
from eval.report.table import Results, Table, difference_texts, estimate, to_markdown
from eval.report.text import markdown_table
from eval.report.verdict import PRACTICALLY_EQUAL, called, is_tie

_RESULTS = {"better": "**better**", "worse": "**worse**", "open": "no difference shown"}
_ANSWERED = {
    "cost": "cost",
    "still_s": "time until still (s)",
    "tip_rms_mm": "error of the arm's end, RMS (mm)",
    "residual_pp_mm": "vibration after the move, peak to peak (mm)",
}
CONSTANTS: dict[str, Any] = {
    "arrival_mm": 1000 * metrics.ARRIVAL_BOUND,
    "mostly": MOSTLY,
    "practically_equal": PRACTICALLY_EQUAL,
    "is_tie": is_tie,
    "resamples": RESAMPLES,
    "least_p": LEAST_P,
    "least_scenarios": LEAST_SCENARIOS,
    "least_of_tail": LEAST_OF_TAIL,
    "change": CHANGE,
    "perturbation": PERTURBATION,
    "reversal_swing": metrics.REVERSAL_SWING,
}
"""Numbers of the method, for page and report."""
BLOCKS = ("answer", "results", "methods")
"""Parts of the README, each between markers of its name."""
_METHODS: list[dict[str, Any]] = json.loads(Path(__file__).with_name("methods.json").read_text(encoding="utf-8"))
_ROWS = 5  # of the answer's table


def tables(content: dict[str, Any]) -> dict[str, Any]:
    """Tables and numbers of the template."""
    results = Results(content)
    costs = results.across_splits("cost")
    return {
        "note": results.note,
        "costs": to_markdown(costs),
        "plain_costs": to_markdown(costs, intervals=False, seeds=True),
        "answer": to_markdown(_answer(results), intervals=False),
        "headline": headline(results),
        "methods": described(results),
        "oracle": bool(costs.unranked),
        "tails": to_markdown(results.tails()),
        "torques": to_markdown(results.torques()),
        "answers": _RESULTS,
        "titles": {name: metrics.METRICS[name].title for name in PAIRED_METRICS},
        "splits": [
            {
                "name": split,
                "description": SPLITS[split].description,
                "table": to_markdown(results.of_split(split, metrics.SHOWN)),
                "pairs": _pairs(results, split),
            }
            for split in results.splits
        ],
        "effort": to_markdown(results.effort(), seeds=True),
        "main_split": results.main,
        "main_description": SPLITS[results.main].description,
        "label": results.label,
        "episodes": results.episodes,
        "seed_note": results.seed_note(row["method"] for row in results.methods),
        "compared": _listed(PAIRED_METRICS),
        "edition": EDITION,
        "torque_names": _listed(metrics.TORQUES),
        **CONSTANTS,
    }


def _listed(names: Sequence[str]) -> str:
    *first, last = (metrics.METRICS[name].title for name in names)
    return f"{', '.join(first)} and {last}"


def _pairs(results: Results, split: str) -> str:
    """Paired differences on one split: from the best classical method, and of learned methods from their base."""
    rows = [
        [name, f"{pair['other']}{suffix}", *difference_texts(pair)]
        for word, suffix in zip(AGAINST, ("", ", its base"), strict=True)
        for name, pair in results.against(word, split).items()
    ]
    titles = ["method", "against", *(part for name in PAIRED_METRICS for part in (metrics.heading(name), "improves"))]
    return markdown_table(titles, rows, "ll" + "lr" * len(PAIRED_METRICS)) if rows else ""


def headline(results: Results) -> str:
    """Answer of the primary comparison on the main split, in one sentence; empty where nothing is decided."""
    tests = {row["metric"]: row for row in results.content["primary"] if row["split"] == results.main}
    if "still_s" not in tests:
        return ""
    cost = tests["cost"]
    pair = [results.records[cost[role], results.main] for role in ("challenger", "classical")]
    after = "a move of a working shift" if results.main == "shift" else f"a move on {results.main}"
    names = [called(row["method"], row["kind"], results.of_kind(row["kind"])) for row in pair]
    times = [f"{1000 * estimate(row, 'still_s').iqm:.0f} ms with {name}" for name, row in zip(names, pair, strict=True)]
    still = ", and in ".join(times) + (" (no difference is shown)" if tests["still_s"]["result"] == "open" else "")
    if cost["result"] == "open":
        change = "no difference in the cost of the move is shown that holds in both averages"
    else:
        tie, way = is_tie("cost", cost["result"], cost["relative"]), "less" if cost["relative"] < 0 else "more"
        size = f"{100 * abs(cost['relative']):.{int(tie)}f} % {way}"
        change = f"the move costs {size}{', a practical tie' if tie else ''}"
    return f"After {after} the arm's end is still in {still}, on average; {change}."


def described(results: Results) -> list[dict[str, Any]]:
    """Methods that took part, in lines that some of them share, the user's own last."""
    kinds = {row["method"]: row["kind"] for row in results.methods}
    known = {name for group in _METHODS for name in group["methods"]}
    own = [{"methods": [name for name in kinds if name not in known], "text": "the user's own, or with the guard"}]
    groups = [{**group, "methods": [name for name in group["methods"] if name in kinds]} for group in _METHODS + own]
    return [{**group, "kind": kinds[group["methods"][0]]} for group in groups if group["methods"]]


def _answer(results: Results) -> Table:
    """Methods on the main split: the best, and the first of all, the paper's controller."""
    table = results.of_split(results.main, list(_ANSWERED))
    reference = results.content["rows"][0]["method"]
    rows = [row for row in table.ranked if row.method != reference][: _ROWS - 1]
    rows += [row for row in table.ranked if row.method == reference]
    named = [replace(row, method=f"{row.method} ({row.kind})") for row in rows]
    return Table(table.title, list(_ANSWERED.values()), named)
