"""Verification of a submission: what it submits is run again, and has to score as it was said to."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from eval.comparison.run import choose_methods, compare
from eval.leaderboard.archive import extract
from eval.leaderboard.scores import Scores, score
from eval.leaderboard.submission import Rules, Submission


def require_trust(submission: Submission, trust: bool, where: str) -> None:
    """Check that running a submission is wanted, where that executes code of its author.

    Raises:
        ValueError: If it is not.
    """
    if submission.is_code and not trust:
        code = ", ".join(name for name in submission.files if name.endswith(".py"))
        raise ValueError(
            f"{where} submits a controller in Python, and to verify it is to run its author's code with all your "
            f"rights ({code}): read it first, run it where there is nothing to lose, and say so with --trust"
        )


def rerun(
    submission: Submission, rules: Rules, jobs: int, done: Callable[[int, int], object] = lambda *_: None
) -> Scores:
    """Run a submission and its references in a temporary folder; no command of the archive is executed.

    Args:
        submission: What to run; see `require_trust`.
        rules: On which scenarios.
        jobs: Number of processes.
        done: Called with the number of pairs of method and split that are done, and of all.

    Raises:
        ValueError: If a method cannot be run to the end.
        OSError: If the folder cannot be written.
    """
    name, sources = submission.method, submission.content["sources"]
    with TemporaryDirectory(prefix="beltarm-") as temporary:
        home, results = Path(temporary, "submission"), Path(temporary, "results")
        extract(submission.files, home)
        paths = [str(home / source) for source in sources]
        policies, added = ([], paths) if submission.is_code else ([f"{name}={path}" for path in paths], [])
        methods = choose_methods([name, *rules.references], policies, added)
        comparison = compare(methods, rules.scenarios, rules.episodes, results, jobs, done=done)
    for failure in comparison.failures:
        raise ValueError(f"{failure.method} failed on {failure.split}: {failure.message}")
    found: Scores = {method: {} for method in (name, *rules.references)}
    for outcome in comparison.outcomes:
        found[outcome.method.name][outcome.split] = score(outcome.metrics)
    return found
