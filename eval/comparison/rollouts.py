"""Runs of controllers: failures, which are reported and affect nothing else; and what studies run, side by side."""

import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

from rich.console import Console

import agents
import baselines
import beltarm_env
import eval
from agents.policy.bundle import load_controller
from baselines import CONTROLLERS
from baselines.engines import parallel
from baselines.engines.isolated import run_isolated
from baselines.tools.progress import progress_count
from beltarm_env.rollout import Controller, nominal_profile
from eval.comparison.methods import Method, chosen, classical_methods, learned_methods, shipped_policies

_LONGEST_MESSAGE = 300
_INSTALLED = {"site-packages", "lib", "<string>"}  # folders of code that is not a user's own
Case = TypeVar("Case", bound=tuple[Any, ...])
Result = TypeVar("Result")
Note = TypeVar("Note")


@dataclass(frozen=True, slots=True)
class Failure:
    """A method that could not be run to the end on a split."""

    method: str
    split: str
    message: str
    trace: str = ""  # the whole traceback
    varies: bool = False  # whether a run costs something else each time


def run_controller(method: Method, split: str, run: Callable[[], Result], where: str = "") -> Result | Failure:
    """Run the controllers of a method on a split; an added one's in a process of its own, whose end is a `Failure` too.

    `run` must be picklable; `where` begins a failure's message.
    """
    if method.kind != "added":
        return attempt(method.name, split, run, where)
    try:
        return run_isolated(partial(attempt, method.name, split, run, where), method.sources[0], method.time_limit)
    except parallel.BrokenOff as end:
        return Failure(method.name, split, f"{where}: {end}" if where else str(end))


def attempt(method: str, split: str, run: Callable[[], Result], where: str = "") -> Result | Failure:
    """Run something of a method; an exception becomes a `Failure`, and so does a request to exit."""
    try:
        return run()
    except (Exception, SystemExit) as error:
        message = " ".join(f"{where}{': ' if where else ''}{type(error).__name__}: {error}".split())
        return Failure(method, split, message[:_LONGEST_MESSAGE] + place(error), trace(error))


def changed(method: Method, split: str = "") -> Failure | None:
    """Return a failure if a method's files changed while it ran: nobody knows which of them its results are of."""
    words = "its files changed while it ran: run again, and let nothing write into its folder meanwhile"
    return Failure(method.name, split, words) if method.changed() else None


def trace(error: BaseException) -> str:
    """The whole traceback of an exception."""
    return "".join(traceback.format_exception(error))


def place(error: BaseException) -> str:
    """File and line of a user's own code in which an exception was raised, in brackets; empty if it was in none."""
    ours = tuple(str(Path(package.__path__[0])) for package in (beltarm_env, baselines, agents, eval))
    frames = traceback.extract_tb(error.__traceback__)
    own = [f for f in frames if not f.filename.startswith(ours) and not {*Path(f.filename).parts} & _INSTALLED]
    return f" ({Path(own[-1].filename).name}:{own[-1].lineno})" if own else ""


def explained(failure: parallel.Failure, jobs: int | None) -> Exception:
    """Return the error of a task, with a remedy where its process died."""
    if isinstance(failure.error, parallel.BrokenOff):
        fewer = max(1, (jobs or parallel.default_jobs()) // 2)
        return OSError(f"{failure.message}: try again with --jobs {fewer}")
    return failure.error


# Studies


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
    return CONTROLLERS[name]() if name in CONTROLLERS else load_controller(*shipped_policies(1, name))


class Recorder(Generic[Note]):
    """Controller that keeps a note for each sample, which `note` makes from its memory after it."""

    def __init__(self, controller: Any, note: Callable[[Any], Note]) -> None:
        self.params, self.profile, self.notes = controller.params, nominal_profile(controller), list[Note]()
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
    tasks = {name: lambda _, call=call: call() for name, call in calls.items()}
    results: dict[str, Result] = {}
    with (
        progress_count(title, Console(stderr=True)) as show,
        closing(parallel.run_side_by_side(tasks, parallel.SideBySide(jobs=jobs))) as outcomes,
    ):
        for name, outcome in outcomes:
            if isinstance(outcome, parallel.Failure):
                raise explained(outcome, jobs)
            results[name] = outcome
            show(len(results), len(tasks))
    return {name: results[name] for name in calls}
