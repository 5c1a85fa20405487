"""Run of the tuner: searches of several controllers side by side, and the gains that they find, written to the file."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from baselines.engines.options import WithStorage
from baselines.engines.parallel import Channel, Interrupted, StopRequest, run_side_by_side, stop_on_signals
from baselines.engines.workplace import Workplace
from baselines.gains import read_file, write_entry
from baselines.loops.condition import MarginCondition, least_margins
from baselines.registry import TUNABLE
from baselines.tools.files import require_writable
from baselines.tools.progress import progress_rows
from baselines.tools.provenance import command_line, commit
from baselines.tools.resuming import note_options, noted_options
from baselines.tuning.search import SearchProgress, SearchResult, search
from baselines.tuning.study import begin_anew
from beltarm_env import __version__
from beltarm_env.rollout import Controller
from beltarm_env.task.seeds import GAIN_CHOICE


def journal_file(folder: Path, name: str) -> Path:
    """Return the journal of a controller's search."""
    return folder / f"{name}.journal"


def noted_file(folder: Path, name: str) -> Path:
    """Return the file of the options with which a controller's search was begun, or resumed last."""
    return folder / f"{name}.json"


def begun_options(names: Sequence[str], journals: Path, *but: str) -> dict[str, Any]:
    """Options with which the searches of some controllers were begun, or resumed last, without those in `but`.

    Raises:
        ValueError: If they are not the same for all, or a file that notes them is damaged.
    """
    noted = {name: noted_options(noted_file(journals, name), *but) for name in names}
    begun = {name: options for name, options in noted.items() if options}
    first = next(iter(begun), "")
    for name, options in begun.items():
        if options != begun[first]:
            raise ValueError(f"the searches of {first} and {name} have other options: resume them one at a time")
    return begun.get(first, {})


def tune(
    names: Sequence[str],
    *,
    budget: int,
    seed: int,
    options: WithStorage,
    out: Path,
    journals: Path,
    resume: bool,
    condition: MarginCondition | None,
    console: Console,
) -> None:
    """Tune controllers, and write the gains of each as soon as they are found.

    Args:
        names: Of the controllers, see `TUNABLE`.
        budget: Simulated steps for each.
        seed: Of the optimiser.
        options: Of the command; they say where the searches run side by side, and are noted for a resumption.
        out: File of gains.
        journals: Folder of the journals.
        resume: Whether to go on with the searches that have a journal.
        condition: Margins that every loop has to keep; None for none.
        console: Where to show how far they are.

    Raises:
        ValueError: If a file is bad, there is nothing to resume, or, once the others are through, if searches failed.
        OSError: If files cannot be written.
        Interrupted: If a signal asked to stop; the journals are in order.
    """
    read_file(out)
    require_writable(out.parent)
    require_writable(journals)
    at = commit()  # before the first gains are written, which may be a file of the commit
    stop, errors = StopRequest(), list[str]()
    with (
        Workplace(options, journals) as workplace,
        stop_on_signals(stop, lambda: console.print("stopping soon; press Ctrl-C again to stop at once")),
        progress_rows(names, budget, console) as rows,
    ):
        for name in names:
            workplace.prepare(name, journals, resume=resume, overwrite=True)
            if not resume:
                begin_anew(journal_file(journals, name))
        if resume and not any(journal_file(journals, name).exists() for name in names):
            raise ValueError(f"nothing to resume in {journals}: run once without --resume")
        for name in names:
            note_options(noted_file(journals, name), options)
        console.print(f"searching with {budget} samples for each: {', '.join(names)}", soft_wrap=True)
        searches = {
            name: workplace.task(
                name, journals, partial(_search_in, name, budget, seed, condition), journal_file(Path(), name)
            )
            for name in names
        }

        def tell(name: str, state: SearchProgress) -> None:
            rows.show(name, state.steps, f"{state.trials} trials, best cost {state.best:.1f}")

        outcomes = run_side_by_side(searches, options.jobs, engine=options.runs_on, stop=stop, tell=tell)
        with closing(outcomes):
            for name, found in outcomes:
                workplace.collect(name, journals)
                if isinstance(found, SearchResult):
                    gains = TUNABLE[name].gains(**found.gains)
                    origin = _provenance(budget, seed, found, at) | _margins(TUNABLE[name].controller(gains), condition)
                    write_entry(name, gains, origin, out)
                    rows.show(name, budget, _summary(found))
                elif not isinstance(found.error, Interrupted):
                    errors.append(f"{name}: {found.resumable_message}")
    if errors:
        raise ValueError("\n".join(errors))
    if stop.made:
        raise Interrupted
    console.print(f"written to {out}: {', '.join(names)}")


def _search_in(
    name: str, budget: int, seed: int, condition: MarginCondition | None, folder: Path, channel: Channel
) -> SearchResult:
    """Search for a controller's gains with the journal in a folder."""
    return search(TUNABLE[name], budget, seed, journal_file(folder, name), channel, condition)


def _provenance(budget: int, seed: int, found: SearchResult, at: str) -> dict[str, object]:
    """Provenance of gains that were found at a commit."""
    return {
        "command": command_line(),
        "seed": seed,
        "budget": budget,
        "steps": found.steps,
        "trials": found.trials,
        "pruned": found.pruned,
        "failed": found.failed,
        "refused": found.refused,
        "cost": round(found.cost, 2),
        "cost_untuned": round(found.cost_untuned, 2),
        "measured_on": f"{found.arms} arms of the training ranges, seeds from {GAIN_CHOICE.first}",
        "date": datetime.now(UTC).date().isoformat(),
        "version": __version__,
        "commit": at,
        "seconds": round(found.seconds, 1),
    }


def _margins(controller: Controller, condition: MarginCondition | None) -> dict[str, object]:
    """Margins that were asked for, and the least ones reached over arms and angles, with where."""
    if condition is None:
        return {"margins": "not asked for"}
    least = least_margins(controller, condition.arms)
    reached = {"modulus": round(least.modulus, 3), "modulus_at": least.modulus_at}
    reached |= {"delay_samples": round(least.delay, 2), "delay_at": least.delay_at}
    return {"margins": {**asdict(condition), "reached": reached}}


def _summary(found: SearchResult) -> str:
    """One-line summary of a search."""
    effort = f"{found.trials} trials, {found.refused} refused, {found.seconds:.0f} s"
    return f"cost {found.cost:.1f}, untuned {found.cost_untuned:.1f}, {effort}"
