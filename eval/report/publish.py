"""Output of a comparison: tables in the terminal, and all files of its folder."""

from __future__ import annotations

import gc
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from baselines.engines import parallel
from baselines.tools.files import sha256_of, write_text
from eval.comparison.failures import explained
from eval.comparison.results import Comparison
from eval.comparison.schema import write_results
from eval.comparison.splits import Split
from eval.report.maps import robustness_maps
from eval.report.markdown import markdown
from eval.report.page import write_report
from eval.report.plots import plots, save_plot
from eval.report.scenes import Recordings, record_scenes
from eval.report.terminal import print_results
from eval.report.traces import record
from eval.report.verdict import verdict


def publish(
    comparison: Comparison,
    splits: dict[str, Split],
    folder: Path,
    console: Console,
    *,
    maps: bool = False,
    verbose: bool = False,
    jobs: int | None = None,
) -> Comparison:
    """Print the main split and the verdict, and write report.html, results.json, episodes.csv, summary.md and pictures.

    Args:
        comparison: What was found.
        splits: Splits that were compared, by name.
        folder: Where to write.
        console: Where to print.
        maps: Whether the report has robustness maps, which are simulated first.
        verbose: Whether all splits are printed, with intervals and differences.
        jobs: Number of processes that record and draw, by default one per core.

    Returns:
        The comparison, with the failures of methods that were run once more to be shown.

    Raises:
        OSError: If a file cannot be written.
    """
    calls: dict[str, Callable[[], Any]] = {
        "traces": partial(record, comparison, splits),
        "scenes": partial(record_scenes, comparison, splits),
    }
    if maps:
        calls["maps"] = partial(robustness_maps, comparison)
    recorded = _side_by_side(calls, jobs)
    comparison = comparison.with_failures([failure for _, failures in recorded.values() for failure in failures])
    traces, *others = (found for found, _ in recorded.values())
    said = verdict(comparison)
    write_results(comparison, folder, said.sentences, said.rows())
    digest = sha256_of(folder / "results.json")
    report = partial(write_report, comparison, said.sentences, Recordings(*others), folder)
    drawn = plots(comparison, traces)
    pictures = {name: partial(save_plot, draw, folder / name, digest) for name, draw in drawn.items()}
    _side_by_side({"report": report, **dict(reversed(pictures.items()))}, jobs)  # what takes longest comes first
    write_text(folder / "summary.md", markdown(comparison, said, list(pictures), digest))
    print_results(comparison, said.sentences, console, verbose=verbose)
    console.print(f"Written to {folder}: report.html, summary.md, results.json, episodes.csv, pictures", soft_wrap=True)
    return comparison


def _side_by_side(calls: dict[str, Callable[[], Any]], jobs: int | None) -> dict[str, Any]:
    """Results of some calls, each in a process of its own, in their order.

    Raises:
        Exception: Whatever one of them raises, see `eval.comparison.failures.explained`.
    """
    found = {}
    with closing(parallel.run_side_by_side({name: partial(_called, calls[name]) for name in calls}, jobs)) as results:
        for name, result in results:
            if isinstance(result, parallel.Failure):
                raise explained(result, jobs)
            found[name] = result
    return {name: found[name] for name in calls}


def _called(call: Callable[[], Any], _: parallel.Channel) -> Any:
    gc.freeze()  # drawing makes many objects, and garbage would be looked for among all others too
    return call()
