"""Calls side by side in processes, with their progress shown and the first failure raised."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from functools import partial
from typing import Any, TypeVar

from rich.console import Console

from baselines.engines.parallel import Channel, Failure, run_side_by_side
from baselines.tools.progress import progress_count

Case = TypeVar("Case", bound=tuple[Any, ...])
Result = TypeVar("Result")


def side_by_side(
    title: str, work: Callable[..., Result], cases: Sequence[Case], jobs: int | None
) -> dict[Case, Result]:
    """Call `work` with the arguments of each case, in processes side by side.

    Args:
        title: Name of the progress that is shown.
        work: Function of a module, so that a process can import it.
        cases: Arguments of each call, all different.
        jobs: Number of processes; None for one per core.

    Returns:
        Results by case, in the order of the cases.

    Raises:
        OSError: If a process died.
        ValueError: If a call is refused.
    """
    tasks = {str(k): partial(_call, work, case) for k, case in enumerate(cases)}
    results: dict[str, Result] = {}
    with progress_count(title, Console(stderr=True)) as show, closing(run_side_by_side(tasks, jobs)) as outcomes:
        for name, outcome in outcomes:
            if isinstance(outcome, Failure):
                raise outcome.error
            results[name] = outcome
            show(len(results), len(tasks))
    return {case: results[str(k)] for k, case in enumerate(cases)}


def _call(work: Callable[..., Result], case: tuple[Any, ...], _: Channel) -> Result:
    return work(*case)
