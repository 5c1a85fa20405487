"""Output of a comparison: the main table and the verdict on the terminal, and all files of its folder but the page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape

from baselines.tools.files import write_text
from beltarm_env.metrics import ARRIVAL_BOUND
from eval.comparison.failures import Failure
from eval.comparison.results import Comparison
from eval.comparison.schema import write_results
from eval.comparison.splits import EPISODES, Split
from eval.comparison.statistics import LEAST_OF_TAIL
from eval.report.page import render
from eval.report.plots import plots
from eval.report.recordings import record_scenes
from eval.report.style import save_figures
from eval.report.table import Results, to_terminal
from eval.report.verdict import verdict


def publish(
    comparison: Comparison, splits: dict[str, Split], folder: Path, jobs: int | None = None
) -> tuple[dict[str, Any], list[Failure]]:
    """Write report.html, results.json, episodes.csv and pictures of a comparison of some splits.

    Returns:
        The content of results.json, and all failures, also of methods that were run once more to be shown.

    Raises:
        OSError: If a file cannot be written.
    """
    scenes, traces, failures = record_scenes(comparison, splits, jobs)
    comparison = comparison.with_failures(failures)
    content = write_results(comparison, folder, *verdict(comparison))
    write_text(folder / "report.html", render(content, scenes))
    save_figures(plots(Results(content), traces), folder)
    return content, comparison.failures


def print_results(content: dict[str, Any], console: Console) -> None:
    """Print the main split, best method first, and the verdict."""
    results = Results(content)
    console.print(to_terminal(results.main_table()))
    for sentence in content["verdict"]:
        console.print(escape(sentence), style="bold", highlight=False)
    console.print(escape(results.note), highlight=False)
    episodes = results.episodes
    few = f" {episodes} of {EPISODES} scenarios show less than all." if episodes < EPISODES else ""
    least = f" (of {LEAST_OF_TAIL} scenarios or more)" if episodes < LEAST_OF_TAIL else ""
    console.print(
        "*: best of its column; =: not shown to differ from it, in the paired test after Holm's correction. Cost: "
        "minus the return (errors of the arm's end, and changes of the torque), averaged over the middle half of all "
        f"runs; mean: over all runs; worst 5 %: over the worst of them{least}; residual p-p: vibration after the move, "
        f"of arms that arrive, within {1000 * ARRIVAL_BOUND:g} mm in the mean.{few}",
        style="dim",
        highlight=False,
    )
