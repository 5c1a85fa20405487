"""Output of a study of tails: a table in the terminal, tails.md, tails.json and pictures."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from rich.console import Console

from baselines.tools.files import write_text
from eval.comparison.splits import EDITION, VERSION
from eval.report.style import save_figure
from eval.tails.page import distribution, page, picture_of
from eval.tails.pictures import draw
from eval.tails.study import Outcome, Study

FORMAT = "beltarm-tails"


def publish(study: Study, folder: Path, console: Console) -> None:
    """Print the costs, and write tails.md, tails.json and a picture for each split.

    Raises:
        OSError: If a file cannot be written.
    """
    for split, outcomes in study.outcomes.items():
        if outcomes:
            save_figure(draw(outcomes), folder / picture_of(study, split), dpi=110)
            told = f"Cost on {split}, {study.episodes} scenarios:\n{distribution(outcomes, 'cost')}"
            console.print(told, markup=False, soft_wrap=True)
    write_text(folder / "tails.md", page(study))
    write_text(folder / "tails.json", json.dumps(record(study), indent=1, allow_nan=False) + "\n")
    console.print(f"{study.note}\nWritten to {folder}: tails.md, tails.json, pictures", soft_wrap=True)


def record(study: Study) -> dict[str, Any]:
    """The content of tails.json."""
    return {
        "format": FORMAT,
        "edition": EDITION,
        "version": VERSION,
        "scenario_seed": study.number,
        "episodes": study.episodes,
        "provenance": study.provenance,
        "failures": [{"method": one.method, "split": one.split, "message": one.message} for one in study.failures],
        "splits": {
            split: {one.method.name: _record_of(one) for one in outcomes} for split, outcomes in study.outcomes.items()
        },
    }


def _record_of(outcome: Outcome) -> dict[str, Any]:
    found = {
        "kind": outcome.method.kind,
        "tails": outcome.tails,
        "cost_of_few": outcome.few,
        "cost_by_policy": outcome.policies,
        "left_workspace": outcome.left,
        "not_settled": outcome.not_settled,
        "not_arrived": outcome.not_arrived,
        "against_best_classical": outcome.against,
        "worst": outcome.worst,
        "arms_in_the_tail": outcome.unlike,
        "cpu_seconds": round(outcome.seconds, 1),
    }
    return {name: _plain(value) for name, value in found.items()}


def _plain(value: Any) -> Any:
    """What JSON can hold of estimates: objects of their fields, and nothing for what is not a number."""
    if hasattr(value, "_asdict"):
        return _plain(value._asdict())
    if isinstance(value, dict):
        return {str(key): _plain(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_plain(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
