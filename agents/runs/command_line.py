"""The command line of all training scripts: one run in this process, or several seeds side by side in their own.

Ctrl-C and SIGTERM stop runs between two updates and save them; a second one stops at once, with what the last
checkpoint has.
"""

from __future__ import annotations

import os
import shlex
import signal
import sys
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Literal, NamedTuple

import tyro
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from agents.runs.checkpoint import RunFolder
from agents.runs.monitor import Interrupted, Maker, News, StopRequest
from agents.runs.settings import RunConfig
from agents.runs.training import train

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
ASKING = (signal.SIGINT, signal.SIGTERM)


class Ended(NamedTuple):
    """How a run ended."""

    how: Literal["finished", "interrupted", "failed"]
    message: str


def main(kind: type[Any], make_learner: Maker, description: str | None) -> None:
    """Command line of a training script.

    Args:
        kind: The script's options, a `RunConfig`.
        make_learner: Makes the script's learner.
        description: What `--help` says.
    """
    config: RunConfig = tyro.cli(kind, description=description)
    script = f"train/{config.algorithm}.py"
    try:
        config.check()
        run = _run_one if config.seeds == 1 else _run_seeds
        run(config, make_learner, Console())
    except Interrupted as interruption:
        print(f"{interruption}; to go on:\n  {_resume_command(script)}")
        sys.exit(130)
    except KeyboardInterrupt:
        print(f"stopped at once; to go on from the last checkpoint:\n  {_resume_command(script)}")
        sys.exit(130)
    except (OSError, ValueError) as error:
        for line in str(error).splitlines():
            print(f"{script}: {line}", file=sys.stderr)
        sys.exit(2)


def _resume_command(script: str) -> str:
    arguments = [argument for argument in sys.argv[1:] if argument not in ("--resume", "--overwrite")]
    return shlex.join(["python", script, *arguments, "--resume"])


def _display(console: Console) -> Progress:
    columns = (TextColumn("{task.description}"), TextColumn("{task.percentage:3.0f} %"), BarColumn(bar_width=16))
    return Progress(*columns, TimeRemainingColumn(), TextColumn("{task.fields[scores]}"), console=console)


@contextmanager
def stoppable(stop: StopRequest, signals: tuple[signal.Signals, ...], console: Console | None = None) -> Iterator[None]:
    """Let signals ask a run to stop; the second of them raises KeyboardInterrupt."""

    def ask(*_: object) -> None:
        if stop.made:
            raise KeyboardInterrupt
        stop.made = True
        if console is not None:
            console.print("stopping after this update; once more to stop at once")

    before = {number: signal.signal(number, ask) for number in signals}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _run_one(config: RunConfig, make_learner: Maker, console: Console) -> None:
    """One run, in this process."""
    stop = StopRequest()
    with stoppable(stop, ASKING, console), _display(console) as display:
        row = display.add_task(config.algorithm, total=config.length, scores="")

        def show(news: News) -> None:
            display.update(row, completed=news.steps, scores=news.scores)

        monitor = train(config, make_learner, show, stop)
    steps, seconds, _ = monitor.curve[-1]
    print(f"{steps} steps in {seconds:.0f} s; best policy: {config.out / 'best'}")
    print(f"compare it: python eval/compare.py --policy {config.out / 'best'}")


def runs_of(config: RunConfig) -> dict[str, RunConfig]:
    """The run of each seed, by the name of its folder; with `--resume`, those without a checkpoint begin.

    Raises:
        FileNotFoundError: If there is nothing to resume.
        ValueError: If a run is there already, and is neither to be resumed nor to be overwritten.
    """
    runs = {}
    for seed in range(config.seed, config.seed + config.seeds):
        folder = RunFolder(config.out / f"seed{seed}")
        resume = config.resume and folder.checkpoint.exists()
        runs[folder.folder.name] = run = replace(config, out=folder.folder, seed=seed, seeds=1, resume=resume)
        folder.check(run)
    if config.resume and not any(run.resume for run in runs.values()):
        raise FileNotFoundError(f"nothing to resume in {config.out}: run once without --resume")
    return runs


def _run_seeds(config: RunConfig, make_learner: Maker, console: Console) -> None:
    """Several runs, in processes of their own; one that fails leaves the others alone."""
    runs, stop, ends = runs_of(config), StopRequest(), dict[str, Ended]()
    news_of_all = run_all(runs, make_learner, config.jobs, stop)
    with stoppable(stop, ASKING, console), _display(console) as display, closing(news_of_all):
        rows = {name: display.add_task(name, total=config.length, start=False, scores="") for name in runs}
        for name, news in news_of_all:
            display.start_task(rows[name])
            if isinstance(news, Ended):
                ends[name] = news
                display.update(rows[name], scores=news.message)
            else:
                display.update(rows[name], completed=news.steps, scores=news.scores)
    failed = [f"{name}: {end.message}" for name, end in ends.items() if end.how == "failed"]
    if failed:
        raise ValueError("\n".join([*failed, f"{len(runs) - len(failed)} other runs are saved in {config.out}"]))
    if stop.made:
        raise Interrupted(f"interrupted; what was begun is saved in {config.out}")
    print(f"{len(runs)} runs in {config.out}; learning curves: python eval/curves.py --runs {config.out}")
    policies = " ".join(f"--policy {run.out / 'best'}" for run in runs.values())
    print(f"compare them: python eval/compare.py {policies}")


def run_all(
    runs: dict[str, RunConfig], make_learner: Maker, jobs: int, stop: StopRequest
) -> Generator[tuple[str, News | Ended]]:
    """Run trainings in processes of their own, some at a time; yields what they tell, an `Ended` at last."""
    waiting, running, processes = list(reversed(runs)), dict[Connection, str](), list[BaseProcess]()
    asked = False
    try:
        while running or (waiting and not stop.made):
            while waiting and len(running) < jobs and not stop.made:
                name = waiting.pop()
                process, connection = _start(runs[name], make_learner)
                processes.append(process)
                running[connection] = name
            if stop.made and not asked:
                asked = True
                for process in processes:
                    process.terminate()
            for connection in wait(list(running), timeout=0.5):
                assert isinstance(connection, Connection)
                try:
                    news = connection.recv()
                except EOFError:
                    how = "interrupted" if stop.made else "failed"
                    news = Ended(how, "the process broke off; to go on, use --resume")
                yield running[connection], news
                if isinstance(news, Ended):
                    del running[connection]
    finally:
        for connection in running:
            connection.close()  # a run stops, and is saved, when there is nobody left to tell
        for process in processes:
            process.join(5)
            process.kill()


def _start(config: RunConfig, make_learner: Maker) -> tuple[BaseProcess, Connection]:
    """Start a run in a process of its own, which tells its news to the connection."""
    ours, theirs = get_context("spawn").Pipe(duplex=False)
    process = start_process(_work, (config, make_learner, theirs), config.threads)
    theirs.close()  # so that the end of the process ends what we read
    return process, ours


def start_process(body: Callable[..., None], arguments: tuple[Any, ...], threads: int) -> BaseProcess:
    """Start a process whose libraries keep to so many threads, and which leaves Ctrl-C to this one."""
    process = get_context("spawn").Process(target=body, args=arguments)
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, str(threads)))
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)  # which the new process inherits
    process.start()
    signal.signal(signal.SIGINT, handler)
    for name, value in before.items():
        if value is None:
            del os.environ[name]
        else:
            os.environ[name] = value
    return process


def _work(config: RunConfig, make_learner: Maker, connection: Connection) -> None:
    """Body of a process: one run."""
    stop = StopRequest()

    def tell(news: News | Ended) -> None:
        try:
            connection.send(news)
        except OSError:  # nobody listens any more
            stop.made = True

    with stoppable(stop, (signal.SIGTERM,)):
        try:
            monitor = train(config, make_learner, tell, stop)
            tell(News(monitor.curve[-1][0], monitor.progress["scores"]))
            tell(Ended("finished", f"done, {monitor.progress['scores']}"))
        except Interrupted as interruption:
            tell(Ended("interrupted", str(interruption)))
        except (OSError, ValueError) as error:
            tell(Ended("failed", str(error).replace("\n", " ")))
