"""Tables of a comparison: the content of a results.json, put into one structure, and rendered for each medium.

`Results` makes the tables that page, report, README and terminal show alike. Markdown and the terminal have their
renderers here, HTML has it in `parts.html`.
"""

import textwrap
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import accumulate
from math import inf, nan
from types import SimpleNamespace
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table as TerminalTable

from beltarm_env.metrics import NOT_ARRIVED, TORQUES, heading
from eval.comparison.check import PERIOD_US
from eval.comparison.methods import EFFORT, project_names
from eval.comparison.results import PAIRED_METRICS
from eval.comparison.sets import SetLabel
from eval.comparison.splits import SPLITS, main_split
from eval.report.text import cell, markdown_table, number, numbers

_MARKDOWN = {"best": "**{}**", "tie": "<ins>{}</ins>"}
_TERMINAL = {"best": "[bold]{}*[/bold]", "tie": "[underline]{}=[/underline]"}
_NAME_WIDTH, _LEAST_NAME_WIDTH, _HEAD_WIDTH = 24, 11, 7  # columns of a terminal: a long name is cut, and no number


@dataclass(frozen=True, slots=True)
class Cell:
    """Cell of a table."""

    text: str
    interval: str = ""
    details: tuple[str, ...] = ()  # more lines of small print
    value: float | None = None  # by which a page sorts; None is last
    mark: str = ""  # "best" or "tie", or "late" beyond the control period


@dataclass(frozen=True, slots=True)
class Row:
    """Row of a table: a method and its cells."""

    method: str
    kind: str
    seeds: int
    cells: list[Cell]

    @property
    def ranked(self) -> bool:
        """Whether it is compared with others."""
        return self.kind != "privileged"


@dataclass(frozen=True, slots=True)
class Table:
    """Table of methods; those that are not ranked are at the bottom."""

    title: str
    columns: list[str]
    rows: list[Row]

    @property
    def ranked(self) -> list[Row]:
        """Methods that are compared with others."""
        return [row for row in self.rows if row.ranked]

    @property
    def unranked(self) -> list[Row]:
        """Methods that see what no other does."""
        return [row for row in self.rows if not row.ranked]


def to_markdown(table: Table, *, intervals: bool = True, seeds: bool = False) -> str:
    """Render a table as Markdown without details; with `seeds` their number stands beside a learned method's name."""
    rows = []
    for row in table.rows:
        count = f" ({row.seeds} seed{'s' * (row.seeds > 1)})" if seeds and row.kind == "learned" else ""
        texts = [_MARKDOWN.get(cell.mark, "{}").format(cell.text) for cell in row.cells]
        if intervals:
            texts = [f"{text} {cell.interval}".rstrip() for text, cell in zip(texts, row.cells, strict=True)]
        rows.append([text if row.ranked else f"*{text}*" for text in (row.method + count, *texts)])
    return markdown_table(["method", *table.columns], rows)


def to_terminal(table: Table, columns: int) -> TerminalTable:
    """Render a table for a terminal of some columns: a star marks the best of a column, an equals sign a tie."""
    shown = TerminalTable(
        title=table.title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0)
    )
    heads = [textwrap.wrap(column, _HEAD_WIDTH, break_long_words=False) for column in table.columns]
    marked = [any(row.cells[k].mark in _TERMINAL for row in table.rows) for k in range(len(heads))]
    texts = [[len(row.cells[k].text) + marked[k] for row in table.rows] for k in range(len(heads))]
    widths = [max(*map(len, head), *lengths) for head, lengths in zip(heads, texts, strict=True)]
    room = columns - 1 - _LEAST_NAME_WIDTH
    fitting = max(sum(used <= room for used in accumulate(width + 2 for width in widths)), 1)
    heads, widths = heads[:fitting], widths[:fitting]
    left = columns - 1 - sum(width + 2 for width in (0, *widths))
    shown.add_column("method", no_wrap=True, max_width=min(max(left, _LEAST_NAME_WIDTH), _NAME_WIDTH))
    for head, width in zip(heads, widths, strict=True):
        shown.add_column("\n".join(head), justify="right", no_wrap=True, min_width=width)
    if missing := ", ".join(table.columns[fitting:]):
        shown.caption, shown.caption_justify = f"Not shown, for the terminal is too narrow: {missing}.", "left"
    for row in table.rows:
        fit = zip(row.cells[:fitting], marked, strict=False)
        cells = [_TERMINAL.get(cell.mark, "{} " if mark else "{}").format(escape(cell.text)) for cell, mark in fit]
        shown.add_row(escape(row.method), *cells, style="" if row.ranked else "dim italic")
    return shown


Record = dict[str, Any]
"""Row of a results.json: a method on a split."""
Show = Callable[[Record], Cell]


class Results:
    """Content of a results.json; methods come in the order of their cost on the main split, unranked ones last."""

    def __init__(self, content: dict[str, Any]) -> None:
        self.content = content
        self.records: dict[tuple[str, str], Record] = {(row["method"], row["split"]): row for row in content["rows"]}
        self.splits = list(dict.fromkeys(row["split"] for row in content["rows"]))
        self.main = main_split(self.splits)
        self.episodes: int = max(row["episodes"] for row in content["rows"])

    @cached_property
    def methods(self) -> list[Record]:
        """A record of every method, that of the main split if there is one."""
        first = {row["method"]: row for row in reversed(self.content["rows"])}
        chosen: list[Record] = [self.records.get((name, self.main)) or row for name, row in first.items()]
        costs = {row["method"]: estimate(row, "cost").iqm for row in chosen if row["split"] == self.main}
        return sorted(chosen, key=lambda r: (r["kind"] == "privileged", costs.get(r["method"], inf), r["method"]))

    def on(self, split: str) -> list[Record]:
        """Records of a split."""
        return [record for row in self.methods if (record := self.records.get((row["method"], split)))]

    def of_kind(self, *kinds: str) -> list[str]:
        """Names of the methods of some kinds that ran on the main split, the lowest cost first."""
        return [row["method"] for row in self.on(self.main) if row["kind"] in kinds]

    def best_classical(self, split: str) -> str | None:
        """Classical method of the lowest cost on a split."""
        classical = [row for row in self.on(split) if row["kind"] == "classical"]
        return min(classical, key=lambda row: estimate(row, "cost").iqm)["method"] if classical else None

    def against(self, word: str, split: str) -> dict[str, dict[str, Any]]:
        """Paired comparisons of a split by method; `word` is one of `eval.comparison.schema.AGAINST`."""
        pairs = {p["method"]: p for p in self.content["paired"] if (p["against"], p["split"]) == (word, split)}
        return {row["method"]: pairs[row["method"]] for row in self.on(split) if row["method"] in pairs}

    @property
    def label(self) -> SetLabel:
        """Set of scenarios."""
        return SetLabel(**self.content["scenario_set"])

    @property
    def note(self) -> str:
        """Sentences about what the numbers are worth."""
        names, known = [row["method"] for row in self.methods], project_names()
        return self.label.note_with([name for name in names if name.removesuffix("+guard") not in known])

    def seed_note(self, methods: Iterable[str]) -> str:
        """Sentence that names the training seeds that represent learned methods; empty without any of several seeds."""
        shown = set(methods)
        several = [row for row in self.methods if row["method"] in shown and row["seeds"] > 1]
        if not several:
            return ""
        named = "; ".join(f"{row['method']} by seed {row['median_seed']} of 0 to {row['seeds'] - 1}" for row in several)
        return f"A learned method is shown by the training seed of median cost on {self.main}: {named}."

    def main_table(self) -> Table:
        """Cost on the main split by every average, failures beside it, and the error of the arm's end."""
        shows: dict[str, Show] = {
            "cost": partial(_metric, "cost"),
            "mean": lambda row: Cell(number(row.get("cost_mean", nan), 0), value=row.get("cost_mean")),
            "worst 5\u00a0%": lambda row: Cell(number(row.get("cost_worst", nan), 0), value=row.get("cost_worst")),
        }
        shows |= {word: lambda row, word=word: _share(_failing(row)[word]) for word in ("fail", "left", "not arrived")}
        shows |= {heading(name): partial(_metric, name) for name in PAIRED_METRICS if name != "cost"}
        about = f"{self.main}: {SPLITS[self.main].description}; {self.episodes} scenarios"
        return self._table(about, {title: (self.main, show) for title, show in shows.items()})

    def across_splits(self, metric: str) -> Table:
        """One metric on all splits; details of the cost are its mean and tail, and failures."""
        show = partial(_metric, metric)
        shown = (lambda row: replace(show(row), details=_tail(row))) if metric == "cost" else show
        return self._table(f"{heading(metric)} on every split", {split: (split, shown) for split in self.splits})

    def of_split(self, split: str, metrics: Sequence[str]) -> Table:
        """Some metrics on one split, of those that its results have."""
        known = {name for row in self.on(split) for name in row["metrics"]}
        return self._table(split, {heading(name): (split, partial(_metric, name)) for name in metrics if name in known})

    def tails(self) -> Table:
        """Mean of the cost, mean of its worst 5 %, and failures, on all splits."""
        shown: Show = lambda row: Cell("; ".join(_tail(row)))  # noqa: E731
        return self._table("mean and tail of the cost", {split: (split, shown) for split in self.splits})

    def torques(self) -> Table:
        """Torques on the main split."""
        return replace(self.of_split(self.main, TORQUES), title=f"Torques on {self.main}")

    def effort(self) -> Table:
        """Samples and time of tuning or training, of its search, and time per action."""
        columns = ["samples per seed (million)", "seconds per seed", "trials", "refused", "base's samples (million)"]
        columns += ["per action (µs)", "99\u00a0% (µs)", "sensitive (%)"]
        rows = [Row(row["method"], row["kind"], row["seeds"], self._effort(row)) for row in self.methods]
        return Table("What each method takes", columns, rows)

    def _effort(self, row: Record) -> list[Cell]:
        steps, seconds, trials, refused, of_base = (max(row["training"].get(name, [0])) for name in EFFORT)
        amounts = [(steps / 1e6, 1), (seconds, 0), (trials, 0), (refused, 0), (of_base / 1e6, 1)]
        cells = [Cell(number(value, digits) if value else "–", value=value) for value, digits in amounts]
        for time in (row["action_us"]["p50"], row["action_us"]["p99"]):
            mark = "late" if time > PERIOD_US else ""
            share = f"{'late: ' if mark else ''}{time / PERIOD_US:.0%} of the period"
            cells.append(Cell(f"{time:.0f}", details=(share,), value=time, mark=mark))
        share = self.records.get((row["method"], self.main), {}).get("sensitivity")
        return [*cells, Cell("–") if share is None else Cell(number(100 * share, 1), value=share)]

    def _table(self, title: str, columns: dict[str, tuple[str, Show]]) -> Table:
        rows = []
        for row in self.methods:
            records = [(show, self.records.get((row["method"], split))) for split, show in columns.values()]
            cells = [show(record) if record else Cell("failed") for show, record in records]
            rows.append(Row(row["method"], row["kind"], row["seeds"], cells))
        return Table(title, list(columns), rows)


def estimate(row: Record, metric: str) -> SimpleNamespace:
    """Estimate of a metric: `iqm`, `low` and `high`, not numbers where there is none."""
    return SimpleNamespace(**row["metrics"].get(metric, {"iqm": nan, "low": nan, "high": nan}))


def difference_texts(pair: dict[str, Any]) -> list[str]:
    """Paired comparison in words: for each metric the difference and the probability of improvement.

    A star marks a difference that is not shown after Holm's correction.
    """
    texts = []
    for metric in PAIRED_METRICS:
        if metric not in pair["metrics"]:
            texts += ["not compared", "–"]
            continue
        compared = estimate(pair, metric)
        wins = f"{compared.win_rate:.0%} [{compared.win_rate_low:.0%}, {compared.win_rate_high:.0%}]"
        star = "*" if compared.verdict in ("better", "worse") and compared.p_holm >= 0.05 else ""
        texts += [f"{compared.verdict}{star}: {cell(metric, compared, 1)}", wins]
    return texts


def _metric(name: str, row: Record) -> Cell:
    """Cell of a metric: its estimate with the interval, and a mark where it is the best or a tie."""
    if name not in row["metrics"]:
        return Cell("–")
    value = estimate(row, name)
    point, low, high = numbers(name, value)
    return Cell(point, f"[{low}, {high}]", (), value.iqm, row.get("marks", {}).get(name, ""))


def _share(value: float) -> Cell:
    return Cell("<1%" if 0 < value <= 0.005 else f"{value:.0%}", value=value) if value == value else Cell("–")


def _failing(row: Record) -> dict[str, float]:
    """Shares of moves that never settle, of runs that leave the workspace, of moves that do not arrive, by word."""
    failed = row["failures"]
    left = failed["left_workspace"] / (row["seeds"] * row["episodes"])
    return {"fail": failed["not_settled"] / failed["runs"], "left": left, "not arrived": estimate(row, NOT_ARRIVED).iqm}


def _tail(row: Record) -> tuple[str, ...]:
    """Mean and worst 5 % of the cost, and how many runs failed, if any."""
    averages = " / ".join(number(row.get(key, nan), 0) for key in ("cost_mean", "cost_worst"))
    counts = ", ".join(f"{_share(share).text} {word}" for word, share in _failing(row).items() if share > 0)
    return (averages, counts) if counts else (averages,)
