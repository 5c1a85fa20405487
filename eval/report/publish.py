"""Output of a comparison: the main table and the verdict on the terminal, and all files of its folder but the page."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape

from beltarm_env.metrics import ARRIVAL_BOUND, METRICS
from eval.comparison.failures import Failure
from eval.comparison.results import PAIRED_METRICS, Comparison
from eval.comparison.rollouts import calls_side_by_side
from eval.comparison.schema import AGAINST, write_results
from eval.comparison.splits import EPISODES, Split
from eval.comparison.statistics import LEAST_OF_TAIL
from eval.report.page import write_report
from eval.report.plots import plots
from eval.report.recordings import record_scenes
from eval.report.style import save_figure
from eval.report.table import Results, difference_texts, parts_of, to_terminal
from eval.report.verdict import verdict

_METHOD_WIDTH, _SPLIT_WIDTH = 16, 13  # columns of a terminal


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
    report = partial(write_report, content, scenes, folder / "report.html")
    drawn = reversed(plots(Results(content), traces).items())
    pictures = {name: partial(_save, draw, folder / name) for name, draw in drawn}
    calls_side_by_side("pictures", {"report": report, **pictures}, jobs)  # those that take longest come first
    return content, comparison.failures


def _save(draw: Callable[[], Any], path: Path) -> None:
    save_figure(draw(), path)


def print_results(content: dict[str, Any], console: Console, *, verbose: bool = False) -> None:
    """Print the main split, best method first, and the verdict; `verbose` adds all splits with their intervals."""
    results = Results(content)
    if verbose:
        _print_splits(results, console)
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


def _print_splits(results: Results, console: Console) -> None:
    """Print two metrics over all splits, and each challenger's differences from the best classical controller."""
    fitting = max(1, (console.width - _METHOD_WIDTH) // _SPLIT_WIDTH)
    for metric in ("cost", "residual_pp_mm"):
        for table in parts_of(results.across_splits(metric), fitting):
            console.print(to_terminal(table, intervals=True))
    console.print("Interquartile means with bootstrap 95 % intervals.")
    for split in results.splits:
        for name, pair in results.against(AGAINST[0], split).items():
            if results.records[name, split]["kind"] == "classical":
                continue
            texts = difference_texts(pair)
            parts = [
                f"{METRICS[metric].title} {text}, wins {wins}"
                for metric, text, wins in zip(PAIRED_METRICS, texts[::2], texts[1::2], strict=True)
            ]
            console.print(escape(f"{split}: {name} against {pair['other']}: {'; '.join(parts)}."), soft_wrap=True)
