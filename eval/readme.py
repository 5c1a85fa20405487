"""Write the comparison's numbers into the README: `python eval/readme.py`, or `make readme` to measure first.

Everything between the two markers comes from `docs/comparison/results.json`; `--check` fails where the README differs.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import tyro

from baselines.files import write_text
from eval.estimates import Estimate
from eval.summary import COLUMNS, cell

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "docs" / "comparison" / "results.json"
README = ROOT / "README.md"
BEGIN, END = "<!-- results: begin -->", "<!-- results: end -->"
_SHOWN = ("tip_rms_mm", "residual_pp_mm", "failure_share", "cost")


@dataclass(frozen=True)
class Config:
    """Write the comparison's numbers into the README."""

    check: bool = False
    """Change nothing; exit with 1 if the README is out of date."""


def block(results: dict) -> str:
    """The README's table, from the content of results.json."""
    titles = [f"{title} ({unit})" if unit != "-" else title for title, unit in (COLUMNS[name] for name in _SHOWN)]
    lines = ["| split | method | " + " | ".join(titles) + " |", "|---|---|" + "---:|" * len(_SHOWN)]
    for row in results["rows"]:
        seeds = f" ({row['seeds']} seeds)" if row["kind"] == "learned" else ""
        values = [cell(name, Estimate(**row["metrics"][name])) for name in _SHOWN]
        lines.append(f"| {row['split']} | {row['method']}{seeds} | " + " | ".join(values) + " |")
    provenance = results["provenance"]
    episodes = results["rows"][0]["episodes"]
    lines += [
        "",
        f"{episodes} scenarios per split; interquartile means (shares: means) with bootstrap 95 % intervals over "
        f"scenarios and training seeds. From `{provenance['command']}`, which took {provenance['seconds']:.0f} s.",
    ]
    return "\n".join(lines)


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


def main() -> None:
    """Command line."""
    config = tyro.cli(Config, description=__doc__)
    try:
        readme = README.read_text(encoding="utf-8")
        fresh = updated(readme, block(json.loads(RESULTS.read_text(encoding="utf-8"))))
    except (OSError, ValueError) as error:
        print(f"eval/readme.py: {error}", file=sys.stderr)
        sys.exit(2)
    if config.check:
        if fresh != readme:
            print("README.md is out of date: run `make readme`", file=sys.stderr)
            sys.exit(1)
        return
    write_text(README, fresh)


if __name__ == "__main__":
    main()
