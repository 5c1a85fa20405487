"""Write the comparison's numbers into the README: `python eval/readme.py`, or `make readme` to measure first.

Everything between the two markers comes from `docs/comparison/results.json`; `--check` fails where the README differs,
and where the summary or a picture beside that file was not written with it.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import tyro
from PIL import Image

from baselines.tools.command import one_line_errors
from baselines.tools.files import write_text
from eval.comparison.estimates import Estimate
from eval.style.markdown_table import markdown_table
from eval.views.plots import RESULTS_KEY
from eval.views.terminal import COLUMNS, cell, heading

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "docs" / "comparison" / "results.json"
README = ROOT / "README.md"
BEGIN, END = "<!-- results: begin -->", "<!-- results: end -->"
_SHOWN = ("tip_rms_mm", "residual_pp_mm", "settling_s", "failure_share")
_DETAILED = "randomized"
_TITLES = {name: heading(name) for name in COLUMNS}


@dataclass(frozen=True)
class Config:
    """Write the comparison's numbers into the README."""

    check: bool = False
    """Change nothing; exit with 1 if README, summary or pictures are not of the committed results."""


def block(results: dict[str, Any]) -> str:
    """The README's tables, from the content of results.json: the cost on every split, and more of one split."""
    rows = sorted(results["rows"], key=lambda row: row["kind"] == "privileged")
    splits = list(dict.fromkeys(row["split"] for row in rows))
    shown = _DETAILED if _DETAILED in splits else splits[-1]
    parts = [
        "Cost on every split:",
        _table(rows, splits, lambda row, split: row["split"] == split, lambda row, _: _cell("cost", row)),
        f"More of `{shown}`:",
        _table(
            [row for row in rows if row["split"] == shown], _SHOWN, lambda *_: True, lambda row, name: _cell(name, row)
        ),
        _origin(results),
    ]
    return "\n\n".join(parts)


def _table(
    rows: list[dict[str, Any]],
    columns: Iterable[str],
    belongs: Callable[[dict[str, Any], str], bool],
    show: Callable[[dict[str, Any], str], str],
) -> str:
    """A row per method; each cell from the first of its rows that belongs in the column."""
    columns, lines = list(columns), []
    for method in dict.fromkeys(row["method"] for row in rows):
        mine = [row for row in rows if row["method"] == method]
        cells = [next((show(row, name) for row in mine if belongs(row, name)), "failed") for name in columns]
        lines.append([_name(mine[0]), *cells])
    return markdown_table(["method", *(_TITLES.get(name, name) for name in columns)], lines)


def _name(row: dict[str, Any]) -> str:
    seeds = f" ({row['seeds']} seeds)" if row["kind"] == "learned" else ""
    return f"*{row['method']}*" if row["kind"] == "privileged" else row["method"] + seeds


def _cell(name: str, row: dict[str, Any]) -> str:
    shown = cell(name, Estimate(**row["metrics"][name]))
    return f"*{shown}*" if row["kind"] == "privileged" else shown


def _origin(results: dict[str, Any]) -> str:
    provenance, episodes = results["provenance"], results["rows"][0]["episodes"]
    unranked = any(row["kind"] == "privileged" for row in results["rows"])
    italics = " In italics: what knows its arm and sees its state, a yardstick that is not ranked." if unranked else ""
    fresh = not provenance.get("pairs_kept_before", 0)
    took = f", which took {provenance['seconds']:.0f} s" if fresh else ", part of it from an earlier run"
    return (
        f"{episodes} scenarios per split; interquartile means (shares: means) with bootstrap 95 % intervals over "
        f"scenarios and training seeds.{italics} From `{provenance['command']}`{took}."
    )


def updated(readme: str, table: str) -> str:
    """The README with `table` between its markers.

    Raises:
        ValueError: If the markers are missing.
    """
    if BEGIN not in readme or END not in readme:
        raise ValueError(f"README.md has no {BEGIN} and {END} to write between")
    before, rest = readme.split(BEGIN, 1)
    _, after = rest.split(END, 1)
    return f"{before}{BEGIN}\n\n{table}\n\n{END}{after}"


def of_other_results(results: Path) -> list[Path]:
    """What lies beside a results.json but was not written with it: summary and pictures have its SHA-256."""
    digest = hashlib.sha256(results.read_bytes()).hexdigest()
    summary = results.with_name("summary.md")
    stale = [] if summary.is_file() and digest in summary.read_text(encoding="utf-8") else [summary]
    for path in sorted(results.parent.glob("*.png")):
        with Image.open(path) as picture:
            if picture.info.get(RESULTS_KEY) != digest:
                stale.append(path)
    return stale


def main() -> None:
    """Command line."""
    config = tyro.cli(Config, description=__doc__)
    with one_line_errors("eval/readme.py"):
        readme = README.read_text(encoding="utf-8")
        fresh = updated(readme, block(json.loads(RESULTS.read_text(encoding="utf-8"))))
        if not config.check:
            write_text(README, fresh)
            return
        stale = [README] if fresh != readme else []
        stale += of_other_results(RESULTS)
        if stale:
            names = ", ".join(str(path.relative_to(ROOT)) for path in stale)
            print(f"eval/readme.py: not of {RESULTS.relative_to(ROOT)}: {names}; run `make readme`", file=sys.stderr)
            sys.exit(1)


if __name__ == "__main__":
    main()
