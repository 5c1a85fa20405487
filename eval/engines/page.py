"""What tasks side by side take, as a page in Markdown."""

from __future__ import annotations

from typing import NamedTuple

from eval.engines.memory import Use
from eval.engines.study import ARMS, METHOD, Overhead
from eval.report.text import markdown_table, number


class Findings(NamedTuple):
    """All that was measured."""

    jobs: int
    empty: int  # tasks that do nothing
    overheads: dict[str, Overhead]  # by engine
    equal: dict[int, dict[str, float]]  # seconds by number of tasks, by engine
    comparisons: dict[tuple[str, int], dict[str, Use]]  # by method and scenarios, by engine


def markdown(found: Findings, origin: str) -> str:
    """Write the page."""
    return f"""# Tasks side by side, measured

{origin}

<!-- numbers: begin -->

Measured with {found.jobs} processes on one machine: what a cluster adds is the network.

**What an engine costs.** {found.empty} tasks that do nothing:

{_overheads(found)}

**Equal tasks.** `{METHOD}` on {ARMS} scenarios, so many times, once the workers are warm:

{_equal(found)}

**Comparisons.** One method on fresh scenarios of `randomized`, from the command's start to its end. Memory is that of
all processes together at the peak, Ray's own included. The first one may have compiled kernels:

{_comparisons(found)}
"""


def _overheads(found: Findings) -> str:
    rows = [[f"`{name}`", number(of.begin, 1), number(1000 * of.each, 1)] for name, of in found.overheads.items()]
    return markdown_table(["engine", "until the first result (s)", "each of them (ms)"], rows)


def _equal(found: Findings) -> str:
    engines = list(found.overheads)
    heads = [f"`{name}`, {what}" for name in engines for what in ("s", "s per task")]
    rows = []
    for count, seconds in found.equal.items():
        cells = [(number(seconds[name], 1), number(seconds[name] / count, 2)) for name in engines]
        rows.append([str(count), *(cell for pair in cells for cell in pair)])
    return markdown_table(["tasks", *heads], rows)


def _comparisons(found: Findings) -> str:
    engines = list(found.overheads)
    heads = [f"`{name}`, {what}" for name in engines for what in ("s", "MB")]
    rows = []
    for (method, scenarios), uses in found.comparisons.items():
        cells = [
            (number(uses[n].seconds, 0), number(uses[n].megabytes, 0)) if n in uses else ("–", "–") for n in engines
        ]
        rows.append([f"`{method}`", f"{scenarios:,}".replace(",", " "), *(cell for pair in cells for cell in pair)])
    return markdown_table(["method", "scenarios", *heads], rows)
