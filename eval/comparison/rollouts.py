"""Runs of studies: shipped controllers by name, records of their memories, and calls side by side."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from typing import Any, Generic, TypeVar

from rich.console import Console

from baselines.engines.parallel import Channel, Failure, run_side_by_side
from baselines.tools.progress import progress_count
from beltarm_env.rollout import Controller
from eval.comparison.failures import explained
from eval.comparison.methods import Method, chosen, classical_methods, learned_methods, shipped_policies

Case = TypeVar("Case", bound=tuple[Any, ...])
Result = TypeVar("Result")
Note = TypeVar("Note")


def shipped_methods(names: Sequence[str] = ()) -> list[Method]:
    """Choose shipped methods by name, by default all; of a learned one the policy of its first training seed.

    Raises:
        ValueError: If a name is unknown.
    """
    known = [*classical_methods(), *learned_methods(shipped_policies())]
    wanted = chosen("controller", names, [method.name for method in known])
    return [replace(method, sources=method.sources[:1]) for method in known if method.name in wanted]


def shipped_controller(name: str) -> Controller:
    """Make a shipped controller; of a learned method that of its first training seed."""
    (method,) = shipped_methods((name,))
    return method.controller(0, [])


class Recorder(Generic[Note]):
    """Controller that keeps a note for each sample, which `note` makes from its memory after it."""

    def __init__(self, controller: Any, note: Callable[[Any], Note]) -> None:
        self.params, self.notes = controller.params, list[Note]()
        self._controller, self._note = controller, note

    def predict(self, *arguments: Any, **named: Any) -> Any:
        """Call the controller; see `Controller`."""
        action, memory = self._controller.predict(*arguments, **named)
        self.notes.append(self._note(memory))
        return action, memory


def side_by_side(
    title: str, work: Callable[..., Result], cases: Sequence[Case], jobs: int | None
) -> dict[Case, Result]:
    """Results of `work`, a function of a module, by its arguments, a case each; see `calls_side_by_side`."""
    results = calls_side_by_side(title, {str(k): partial(work, *case) for k, case in enumerate(cases)}, jobs)
    return dict(zip(cases, results.values(), strict=True))


def calls_side_by_side(title: str, calls: Mapping[str, Callable[[], Result]], jobs: int | None) -> dict[str, Result]:
    """Results of calls by name, in their order: they run in processes, by default one per core, under a progress title.

    Raises:
        OSError: If a process died.
        Exception: Whatever a call raises.
    """
    tasks = {name: partial(_called, call) for name, call in calls.items()}
    results: dict[str, Result] = {}
    with progress_count(title, Console(stderr=True)) as show, closing(run_side_by_side(tasks, jobs)) as outcomes:
        for name, outcome in outcomes:
            if isinstance(outcome, Failure):
                raise explained(outcome, jobs)
            results[name] = outcome
            show(len(results), len(tasks))
    return {name: results[name] for name in calls}


def _called(call: Callable[[], Result], _: Channel) -> Result:
    return call()
