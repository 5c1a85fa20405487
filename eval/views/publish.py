"""Output of a comparison: tables in the terminal, and all files of its folder."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from baselines.tools.files import sha256_of, write_text
from eval.comparison.results import Comparison
from eval.comparison.schema import write_results
from eval.comparison.splits import Split
from eval.views.markdown import markdown
from eval.views.plots import save_plots
from eval.views.report import Recordings, record_scenes, robustness_maps, write_report
from eval.views.terminal import print_results
from eval.views.traces import record
from eval.views.verdict import verdict


def publish(
    comparison: Comparison,
    splits: dict[str, Split],
    folder: Path,
    console: Console,
    *,
    maps: bool = False,
    verbose: bool = False,
) -> Comparison:
    """Print the main split and the verdict, and write report.html, results.json, episodes.csv, summary.md and pictures.

    Args:
        comparison: What was found.
        splits: Splits that were compared, by name.
        folder: Where to write.
        console: Where to print.
        maps: Whether the report has robustness maps, which are simulated first.
        verbose: Whether all splits are printed, with intervals and differences.

    Returns:
        The comparison, with the failures of methods that were run once more to be shown.

    Raises:
        OSError: If a file cannot be written.
    """
    traces, unrecorded = record(comparison, splits)
    scenes, unseen = record_scenes(comparison, splits)
    drawn, unmapped = robustness_maps(comparison) if maps else ([], [])
    comparison = comparison.with_failures([*unrecorded, *unseen, *unmapped])
    said = verdict(comparison)
    write_results(comparison, folder, said.sentences, said.rows())
    digest = sha256_of(folder / "results.json")
    pictures = save_plots(comparison, traces, folder, digest)
    write_text(folder / "summary.md", markdown(comparison, said, [path.name for path in pictures], digest))
    write_report(comparison, said.sentences, Recordings(scenes, drawn), folder)
    print_results(comparison, said.sentences, console, verbose=verbose)
    console.print(f"written to {folder}: report.html, summary.md, results.json, episodes.csv, pictures", soft_wrap=True)
    return comparison
