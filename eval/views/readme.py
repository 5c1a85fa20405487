"""The comparison's block of the README, and the check that summary and pictures are of the same run."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from PIL import Image

from beltarm_env.metrics import TORQUE_QUALITY
from eval.comparison.results import COMPUTING_TIME, TIMED_NOTE
from eval.comparison.sets import SetLabel
from eval.views.frame import frame_of_rows, part
from eval.views.markdown import method_table
from eval.views.plots import RESULTS_KEY

BEGIN, END = "<!-- results: begin -->", "<!-- results: end -->"
_SHOWN = ("tip_rms_mm", "residual_pp_mm", "settling_s", "failure_share", *TORQUE_QUALITY)
_DETAILED = "randomized"


def block(results: dict[str, Any]) -> str:
    """Tables of the README, from the content of results.json: cost on every split, more metrics of one split."""
    found = frame_of_rows(results["rows"])
    splits = list(found.split.unique())
    detailed = _DETAILED if _DETAILED in splits else splits[-1]
    parts = [
        "Cost on every split:",
        method_table(part(found, metric=["cost"]), "split", with_seeds=True),
        f"More of `{detailed}`:",
        method_table(part(found, split=[detailed], metric=_SHOWN), "metric", with_seeds=True),
        _origin(results),
    ]
    return "\n\n".join(parts)


def _origin(results: dict[str, Any]) -> str:
    provenance, episodes = results["provenance"], results["rows"][0]["episodes"]
    label = SetLabel(**results["scenario_set"])
    unranked = any(row["kind"] == "privileged" for row in results["rows"])
    italics = " In italics: what knows its arm and sees its state, a yardstick that is not ranked." if unranked else ""
    fresh = not provenance.get("pairs_kept_before", 0)
    timed = f" {TIMED_NOTE}" if provenance.get(COMPUTING_TIME) else ""
    took = f", which took {provenance['seconds']:.0f} s" if fresh else ", part of it from an earlier run"
    return (
        f"{episodes} scenarios per split of the {label.title}; interquartile means (shares: means) with "
        f"bootstrap 95 % intervals over scenarios and training seeds.{italics}{timed} From `{provenance['command']}`"
        f"{took}."
    )


def updated(readme: str, table: str) -> str:
    """README with `table` between its markers.

    Raises:
        ValueError: If the markers are missing.
    """
    if BEGIN not in readme or END not in readme:
        raise ValueError(f"README.md has no {BEGIN} and {END} to write between")
    before, rest = readme.split(BEGIN, 1)
    _, after = rest.split(END, 1)
    return f"{before}{BEGIN}\n\n{table}\n\n{END}{after}"


def of_other_results(results: Path) -> list[Path]:
    """Summary and pictures beside a results.json that do not carry its SHA-256: they are of other results."""
    digest = hashlib.sha256(results.read_bytes()).hexdigest()
    summary = results.with_name("summary.md")
    stale = [] if summary.is_file() and digest in summary.read_text(encoding="utf-8") else [summary]
    for path in sorted(results.parent.glob("*.png")):
        with Image.open(path) as picture:
            if picture.info.get(RESULTS_KEY) != digest:
                stale.append(path)
    return stale
