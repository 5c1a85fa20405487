"""Page of a comparison, `docs/results/comparison/page.md.j2`: its tables, from the content of a results.json alone."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

from beltarm_env.metrics import ARRIVAL_BOUND, METRICS, REVERSAL_SWING, SHOWN, TORQUES, heading
from eval.comparison.perturbation import CHANGE, PERTURBATION
from eval.comparison.results import MOSTLY, PAIRED_METRICS
from eval.comparison.schema import AGAINST
from eval.comparison.splits import EDITION, SPLITS
from eval.comparison.statistics import LEAST_OF_TAIL, LEAST_P, LEAST_SCENARIOS, RESAMPLES
from eval.report.table import Results, difference_texts, to_markdown
from eval.report.text import cell, markdown_table

_RESULTS = {"better": "**better**", "worse": "**worse**", "open": "no difference shown"}


def tables(content: dict[str, Any]) -> dict[str, Any]:
    """Tables and numbers of the template."""
    results = Results(content)
    return {
        "note": results.note,
        "costs": to_markdown(results.across_splits("cost")),
        "tails": to_markdown(results.tails()),
        "torques": to_markdown(results.torques()),
        "primary": _primary(content["primary"]),
        "splits": [
            {
                "name": split,
                "description": SPLITS[split].description,
                "table": to_markdown(results.of_split(split, SHOWN)),
                "pairs": _pairs(results, split),
            }
            for split in results.splits
        ],
        "effort": to_markdown(results.effort(), seeds=True),
        "main_split": results.main,
        "label": results.label,
        "episodes": results.episodes,
        "seed_note": results.seed_note(row["method"] for row in results.methods),
        "compared": _listed(PAIRED_METRICS),
        "edition": EDITION,
        "torque_names": _listed(TORQUES),
        **constants(),
    }


def constants() -> dict[str, Any]:
    """Numbers of the method, for page and report."""
    return {
        "arrival_mm": 1000 * ARRIVAL_BOUND,
        "mostly": MOSTLY,
        "resamples": RESAMPLES,
        "least_p": LEAST_P,
        "least_scenarios": LEAST_SCENARIOS,
        "least_of_tail": LEAST_OF_TAIL,
        "change": CHANGE,
        "perturbation": PERTURBATION,
        "reversal_swing": REVERSAL_SWING,
    }


def _listed(metrics: Sequence[str]) -> str:
    *first, last = (METRICS[name].title for name in metrics)
    return f"{', '.join(first)} and {last}"


def _primary(rows: list[dict[str, Any]]) -> str:
    """Pairwise tests of the primary comparison, metric by metric and split by split."""

    def mean(row: dict[str, Any]) -> SimpleNamespace:
        return SimpleNamespace(iqm=row["mean"], low=row["mean_low"], high=row["mean_high"])

    cells = [
        [
            METRICS[row["metric"]].title,
            row["split"],
            _RESULTS[row["result"]],
            cell(row["metric"], SimpleNamespace(**row)),
            f"{100 * row['relative']:+.0f} %",
            f"{row['p_holm']:.3f}",
            cell(row["metric"], mean(row)),
        ]
        for row in rows
    ]
    return markdown_table(
        ["metric", "split", "result", "difference", "share", "p", "mean difference"], cells, "lllrrrr"
    )


def _pairs(results: Results, split: str) -> str:
    """Paired differences on one split: from the best classical method, and of learned methods from their base."""
    rows = [
        [name, f"{pair['other']}{suffix}", *difference_texts(pair)]
        for word, suffix in zip(AGAINST, ("", ", its base"), strict=True)
        for name, pair in results.against(word, split).items()
    ]
    titles = ["method", "against", *(part for name in PAIRED_METRICS for part in (heading(name), "improves"))]
    return markdown_table(titles, rows, "ll" + "lr" * len(PAIRED_METRICS)) if rows else ""
