"""Command line of all training scripts: one run in this process, or several seeds side by side in their own.

Ctrl-C and SIGTERM stop runs between two updates and save them; a second one stops at once, with what the last
checkpoint has.
"""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from agents.runs.checkpoint import CHECKPOINT, COMMAND, CONFIG, RunFolder
from agents.runs.settings import RunConfig
from agents.runs.training import News, train
from baselines.engines.parallel import Channel, Failure, Interrupted, StopRequest, run_side_by_side, stop_on_signals
from baselines.engines.workplace import Workplace
from baselines.tools.command import resume_command, run_command, this_python
from baselines.tools.files import require_writable
from baselines.tools.options import note_options, noted_options
from baselines.tools.progress import progress_rows
from baselines.tools.provenance import command_line


def main(kind: type[RunConfig], description: str | None) -> None:
    """Run a training script with its options, and what `--help` says of it."""
    run_command(f"train/{kind.algorithm}.py", kind, run, description, begun_options)


def run(config: RunConfig) -> None:
    """Run the trainings of a command; an interruption says how to go on."""
    config.check()
    try:
        _run(config, Console())
    except Interrupted as interruption:
        said = str(interruption)
    except KeyboardInterrupt:
        said = "stopped at once, with what the last checkpoint has"
    else:
        return
    print(f"{said}; to continue:\n  {resume_command(f'train/{config.algorithm}.py')}")
    sys.exit(130)


def begun_options(config: RunConfig) -> dict[str, Any]:
    """Options that the runs to be resumed were begun with, or resumed with last; where none are noted here, the usual.

    Raises:
        ValueError: If the file that notes them is damaged.
    """
    if not config.resume:
        return config.usual()
    command = config.out / COMMAND  # else a run that another program began
    noted = noted_options(command if command.exists() else config.out / CONFIG, "out", "resume", "overwrite")
    return noted or config.usual()  # what is resumed from a storage alone notes none here


def runs_of(config: RunConfig, workplace: Workplace) -> dict[str, RunConfig]:
    """Options of each seed's run, by the name of its folder; with `--resume`, runs that have not begun do so.

    One seed alone has the folder of `--out`, several have their own in it.

    Raises:
        FileNotFoundError: If there is nothing to resume.
        ValueError: If a run is there already, and is neither to be resumed nor to be overwritten.
        OSError: If what is to be resumed cannot be fetched.
    """
    runs = {}
    for seed in range(config.seed, config.seed + config.seeds):
        name = f"seed{seed}"
        folder = RunFolder(config.out if config.seeds == 1 else config.out / name)
        workplace.prepare(name, folder.folder, resume=config.resume, overwrite=config.overwrite)
        resume = config.resume and folder.config.exists()
        runs[name] = run = replace(config, out=folder.folder, seed=seed, seeds=1, resume=resume)
        folder.check(run)
    if config.resume and not any(run.resume for run in runs.values()):
        raise FileNotFoundError(f"nothing to resume in {config.out}: run once without --resume")
    return runs


def _run(config: RunConfig, console: Console) -> None:
    """Run all trainings; one in this process, several in their own, where one that fails leaves the others alone."""
    alone, stop, failed = config.seeds == 1 and config.engine == "local", StopRequest(), list[str]()
    if not config.resume:
        require_writable(config.out)
    with Workplace(config, config.out) as workplace:
        runs = runs_of(config, workplace)
        if alone:
            runs = dict(zip([config.algorithm], runs.values(), strict=True))
        if config.overwrite:  # once: a run that is begun again is not to delete itself
            for run in runs.values():
                with RunFolder(run.out).locked(run):
                    pass
        if noted := not config.resume:
            note_options(config.out / COMMAND, config)
        tasks = {
            name: workplace.task(name, run.out, partial(run_in, run, command_line()), CHECKPOINT)
            for name, run in runs.items()
        }
        asked = partial(console.print, "stopping after this update; press Ctrl-C again to stop at once")
        with stop_on_signals(stop, asked), progress_rows(runs, config.length, console) as show:

            def tell(name: str, news: News) -> None:
                """Show how far a run is; where nobody watches a terminal, as a line for each validation."""
                nonlocal noted
                if not noted:  # a run that has news was found to fit its checkpoint
                    note_options(config.out / COMMAND, config)
                    noted = True
                show(name, news.steps, news.scores)
                if news.cost is not None and not console.is_terminal:
                    console.print(f"{name}: {news.steps} steps, {news.scores}", soft_wrap=True)

            with closing(run_side_by_side(tasks, config, threads=config.threads, stop=stop, tell=tell)) as ends:
                for name, end in ends:
                    if isinstance(end, Failure):
                        if alone:
                            raise end.error
                        show(name, None, end.message)
                        if not isinstance(end.error, Interrupted):
                            failed.append(f"{name}: {end.resumable_message}")
                    else:
                        show(name, end.steps, f"done, {end.scores}")
                    workplace.collect(name, runs[name].out)
    if failed:
        saved = len(runs) - len(failed)
        raise ValueError("\n".join(failed + [f"{saved} other runs are saved in {config.out}"] * (saved > 0)))
    if stop.made:
        raise Interrupted(f"interrupted; all runs that had started are saved in {config.storage or config.out}")
    print(f"saved in {config.out}; learning curves: {this_python()} eval/curves.py --runs {config.out}")
    print(f"compare: {compare_command([run.out / 'best' for run in runs.values()])}")


def compare_command(policies: Sequence[Path]) -> str:
    """Command that compares policies with the project's methods, where they may be chosen: not on the test set."""
    arguments = [word for policy in policies for word in ("--policy", str(policy))]
    arguments += ["--scenarios", "development", "--out", "results/development"]
    return f"{this_python()} {shlex.join(['eval/compare.py', *arguments])}"


def run_in(config: RunConfig, command: str, folder: Path, channel: Channel) -> News:
    """Train in a folder, as a task: begun again after its process died, it goes on from its checkpoint.

    Returns how far the run has come; raises the errors of `train`.
    """
    resume = config.resume or RunFolder(folder).checkpoint.exists()
    own = replace(config, resume=resume, overwrite=False, jobs=None, engine="local", address=None, storage=None)
    monitor = train(own, channel, command, folder)
    return News(monitor.curve[-1][0], monitor.progress["scores"])
