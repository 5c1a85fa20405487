"""The leaderboard's table."""

from __future__ import annotations

from collections.abc import Sequence

from beltarm_env.metrics import METRICS
from eval.leaderboard.entries import SEALED, TEST, Entry
from eval.leaderboard.scores import on_main_split, over_all_splits
from eval.report.text import markdown_table, number

_TITLES = ("method", "author", "kind", "IQM", "mean", "worst 5 %", "all splits")
_SEALED_TITLES = ("sealed: IQM", "sealed: all splits")
NONE = "Nothing has been submitted yet."


def table(entries: Sequence[Entry], folder: str) -> str:
    """Table of all entries and of the references beside them, best first.

    Args:
        entries: See `eval.leaderboard.entries.read_entries`.
        folder: Of the archives, as seen from the page.
    """
    if not entries:
        return NONE
    opened = any(SEALED in entry.record for entry in entries)
    newest = max(entries, key=lambda entry: (SEALED in entry.record, entry.record[TEST]["date"]))
    lines = [_reference(name, newest, opened) for name in newest.references]
    lines += [_line(entry, opened, folder) for entry in entries]
    titles = [*_TITLES, *(_SEALED_TITLES if opened else ()), "verified", "archive, SHA-256"]
    ordered = [cells for _, cells in sorted(lines, key=lambda line: line[0])]
    return markdown_table(titles, ordered, "lll" + "r" * (len(titles) - 5) + "ll")


def _line(entry: Entry, opened: bool, folder: str) -> tuple[float, list[str]]:
    content, run = entry.submission.content, entry.record[TEST]
    seeds = len(content["sources"])
    kind = "controller" if entry.submission.is_code else f"policy, {seeds} {'seed' if seeds == 1 else 'seeds'}"
    verified = f"{run['by']}, {run['date']}, `{run['software']['commit']}`"
    archive = f"[`{entry.record['sha256'][:12]}`]({folder}/{entry.record['archive']})"
    cost, cells = _cells(entry, content["method"], opened)
    return cost, [f"**{content['method']}**", content["author"], kind, *cells, verified, archive]


def _reference(name: str, entry: Entry, opened: bool) -> tuple[float, list[str]]:
    cost, cells = _cells(entry, name, opened)
    return cost, [name, "this project", "reference", *cells, "", ""]


def _cells(entry: Entry, method: str, opened: bool) -> tuple[float, list[str]]:
    """Cost on the main split, by which a line is sorted, and the cells of all numbers."""
    scores = entry.scores()
    found, digits = on_main_split(scores, method), METRICS["cost"].digits
    cells = [number(found[quantity], digits) for quantity in ("iqm", "mean", "worst")]
    first = entry.references[0]
    cells.append(number(over_all_splits(scores, method, first), 2))
    if opened and SEALED in entry.record:
        sealed = entry.scores(SEALED)
        cells += [number(on_main_split(sealed, method)["iqm"], digits)]
        cells.append(number(over_all_splits(sealed, method, first), 2))
    return found["iqm"], cells + ["–"] * (2 if opened and SEALED not in entry.record else 0)
