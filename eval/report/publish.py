"""Output of a comparison: the main table and the verdict on the terminal, and all files of its folder but the page."""

from __future__ import annotations

import gc
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape

from baselines.engines import parallel
from beltarm_env.metrics import ARRIVAL_BOUND, METRICS
from eval.comparison.failures import Failure, explained
from eval.comparison.results import PAIRED_METRICS, Comparison
from eval.comparison.schema import AGAINST, read_results, write_results
from eval.comparison.splits import EPISODES, Split
from eval.comparison.statistics import LEAST_OF_TAIL
from eval.report.page import write_report
from eval.report.plots import plots
from eval.report.recordings import record_scenes, record_traces
from eval.report.style import save_figure
from eval.report.table import Results, difference_texts, parts_of, to_terminal
from eval.report.verdict import verdict

_METHOD_WIDTH, _SPLIT_WIDTH = 16, 13  # columns of a terminal


def publish(
    comparison: Comparison, splits: dict[str, Split], folder: Path, jobs: int | None = None
) -> tuple[dict[str, Any], list[Failure]]:
    """Write report.html, results.json, episodes.csv and pictures.

    Args:
        comparison: What was measured.
        splits: Splits that were compared, by name.
        folder: Where to write.
        jobs: Number of processes that record and draw, by default one per core.

    Returns:
        The content of results.json, and all failures, also of methods that were run once more to be shown.

    Raises:
        OSError: If a file cannot be written.
    """
    calls = {"traces": partial(record_traces, comparison, splits), "scenes": partial(record_scenes, comparison, splits)}
    recorded = side_by_side(calls, jobs)
    comparison = comparison.with_failures([failure for _, failures in recorded.values() for failure in failures])
    (traces, _), (scenes, _) = recorded.values()
    said = verdict(comparison)
    write_results(comparison, folder, said.sentences, said.rows())
    content = read_results(folder / "results.json")
    drawn = plots(Results(content), traces)
    pictures = {name: partial(_save, draw, folder / name) for name, draw in drawn.items()}
    report = partial(write_report, content, scenes, folder / "report.html")
    side_by_side({"report": report, **dict(reversed(pictures.items()))}, jobs)  # those that take longest come first
    return content, comparison.failures


def _save(draw: Callable[[], Any], path: Path) -> None:
    save_figure(draw(), path)


def side_by_side(calls: dict[str, Callable[[], Any]], jobs: int | None) -> dict[str, Any]:
    """Return the results of some calls, each in a process of its own, in their order.

    Raises:
        Exception: Whatever one of them raises, see `eval.comparison.failures.explained`.
    """
    results = {}
    with closing(parallel.run_side_by_side({name: partial(_called, calls[name]) for name in calls}, jobs)) as fresh:
        for name, result in fresh:
            if isinstance(result, parallel.Failure):
                raise explained(result, jobs)
            results[name] = result
    return {name: results[name] for name in calls}


def _called(call: Callable[[], Any], _: parallel.Channel) -> Any:
    gc.freeze()  # drawing makes many objects, and garbage would be looked for among all others too
    return call()


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
