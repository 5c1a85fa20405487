"""Run of the tuner: searches of several controllers side by side, and the gains that they find, written to the file."""

from __future__ import annotations

from contextlib import closing
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar

import tyro
from rich.console import Console

from baselines.engines.parallel import Interrupted, StopRequest, run_side_by_side, stop_on_signals
from baselines.engines.workplace import WithStorage, Workplace
from baselines.gains import FILE, Gains, read_file, write_entry
from baselines.loops.condition import MarginCondition, least_margins
from baselines.registry import TUNABLE
from baselines.tools.command import require_bounds, require_known
from baselines.tools.files import require_writable
from baselines.tools.options import Groups, note_options, noted_options
from baselines.tools.progress import progress_rows
from baselines.tools.provenance import command_line, commit
from baselines.tuning.search import SearchProgress, SearchResult, Terms, search_in, split_budget
from baselines.tuning.study import begin_anew
from beltarm_env import __version__
from beltarm_env.task.seeds import GAIN_CHOICE
from beltarm_env.task.shift import MOST_MOVES


@dataclass(frozen=True)
class TuningConfig(WithStorage):
    """Options of `baselines/tune.py`."""

    groups: ClassVar[Groups] = {
        "basic": ("names", "all", "resume", "out"),
        "search": (),
        "run": ("jobs", "engine", "address", "storage"),
    }

    names: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[NAME ...]")] = ()
    """Controllers to tune."""
    all: bool = False
    """Tune every controller that has gains to tune."""
    budget: int = 48_000_000
    """Simulated samples for each controller. A run of `train/ppo.py --base paper` takes half as many; the gains in
    baselines/gains.json were found with 16 million."""
    moves: int = 4
    """Moves of each arm in a row, with parts and motors that give before they slip; 1 for arms of `TRAIN_RANGES`."""
    seed: int = 0
    """Seed of the optimiser. The arms are the same for every seed."""
    out: Path = FILE
    """File of gains. Entries of other controllers are kept."""
    journals: Path = Path("results/tune")
    """Folder of the journals."""
    margins: bool = True
    """Also accept gains whose loop lacks the margins of `baselines/loops/condition.py`, to see what the margins
    cost."""
    resume: bool = False
    """Continue the searches that have a journal, and start the others."""

    @property
    def terms(self) -> Terms:
        """What every search is to keep to."""
        return Terms(self.budget, self.seed, self.moves, MarginCondition() if self.margins else None)

    def file(self, name: str, kind: str) -> Path:
        """File of a controller's search: its "journal", or the "json" of the options that it had last."""
        return self.journals / f"{name}.{kind}"

    def chosen(self) -> list[str]:
        """Names of the controllers to tune.

        Raises:
            ValueError: If a name is unknown, or there is none.
        """
        if self.all == bool(self.names):
            raise ValueError(f"name controllers to tune or give --all, not both; there are {', '.join(TUNABLE)}")
        require_known(self.names, TUNABLE, "no controller {} to tune")
        return list(dict.fromkeys(self.names)) or list(TUNABLE)

    def begun(self) -> dict[str, Any]:
        """Options with which the searches to be resumed were begun, or resumed last.

        Raises:
            ValueError: If they are not the same for all, or a file that notes them is damaged.
        """
        if not self.resume:
            return {}
        of_this_run = ("names", "all", "journals", "resume")
        noted = {name: noted_options(self.file(name, "json"), *of_this_run) for name in self.chosen()}
        first, *others = [name for name, options in noted.items() if options] or [""]
        for name in others:
            if noted[name] != noted[first]:
                raise ValueError(f"the searches of {first} and {name} have other options: resume them one at a time")
        return noted.get(first, {})


def tune(config: TuningConfig, console: Console) -> None:
    """Tune controllers side by side, and write the gains of each as soon as they are found.

    Raises:
        ValueError: If an option is out of range, a name unknown, a file bad, or there is nothing to resume; once the
            others are through, if searches failed.
        OSError: If files cannot be written.
        Interrupted: If a signal asked to stop; the journals are in order.
    """
    require_bounds(config, seed=(0, None), moves=(1, MOST_MOVES))
    split_budget(config.budget, config.moves)
    config.check_engine()
    names = config.chosen()
    if not config.margins and config.out.resolve() == FILE.resolve():
        raise ValueError(f"--no-margins is not for {FILE.name}: give another file with --out")
    read_file(config.out)
    require_writable(config.out.parent)
    require_writable(config.journals)
    at = commit()  # before the first gains are written, which may be a file of the commit
    stop, errors = StopRequest(), list[str]()
    with (
        Workplace(config, config.journals) as workplace,
        stop_on_signals(stop, lambda: console.print("stopping soon; press Ctrl-C again to stop at once")),
        progress_rows(names, config.budget, console) as show,
    ):
        for name in names:
            workplace.prepare(name, config.journals, resume=config.resume, overwrite=True)
            if not config.resume:
                begin_anew(config.file(name, "journal"))
        if config.resume and not any(config.file(name, "journal").exists() for name in names):
            raise ValueError(f"nothing to resume in {config.journals}: run once without --resume")
        for name in names:
            note_options(config.file(name, "json"), config)
        console.print(f"searching with {config.budget} samples for each: {', '.join(names)}", soft_wrap=True)
        searches = {
            name: workplace.task(name, config.journals, partial(search_in, name, config.terms), Path(f"{name}.journal"))
            for name in names
        }

        def tell(name: str, state: SearchProgress) -> None:
            show(name, state.steps, f"{state.trials} trials, best cost {state.best:.1f}")

        outcomes = run_side_by_side(searches, config, stop=stop, tell=tell)
        with closing(outcomes):
            for name, found in outcomes:
                workplace.collect(name, config.journals)
                if isinstance(found, SearchResult):
                    gains = TUNABLE[name].gains_type(**found.gains)
                    write_entry(name, gains, provenance(config, name, gains, found, at), config.out)
                    effort = f"{found.trials} trials, {found.refused} refused, {found.seconds:.0f} s"
                    costs = f"cost {found.cost:.1f}, untuned {found.cost_untuned:.1f}"
                    show(name, config.budget, f"{costs}, {effort}")
                elif not isinstance(found.error, Interrupted):
                    errors.append(f"{name}: {found.resumable_message}")
    if errors:
        raise ValueError("\n".join(errors))
    if stop.made:
        raise Interrupted
    console.print(f"written to {config.out}: {', '.join(names)}")


def provenance(config: TuningConfig, name: str, gains: Gains, found: SearchResult, at: str) -> dict[str, object]:
    """Provenance of gains found at a commit: the search, its effort, and the margins asked for and reached."""
    effort = {name: value for name, value in asdict(found).items() if name not in ("gains", "arms")}
    margins = config.terms.margins
    if margins is not None:
        least = least_margins(TUNABLE[name](gains))
        reached = {"modulus": round(least.modulus, 3), "modulus_at": least.modulus_at}
        reached |= {"delay_samples": round(least.delay, 2), "delay_at": least.delay_at}
        margins["reached"] = reached
    return {
        "command": command_line(),
        "seed": config.seed,
        "budget": config.budget,
        **effort,
        "moves": config.moves,
        "measured_on": f"{found.arms} arms of the training ranges, seeds from {GAIN_CHOICE.first}",
        "date": datetime.now(UTC).date().isoformat(),
        "version": __version__,
        "commit": at,
        "margins": margins or "not asked for",
    }
