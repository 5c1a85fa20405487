"""Search for the hyper-parameters of a training algorithm.

Optuna's tree-structured Parzen estimator proposes settings; a trial is a training run with them, whose value is its
lowest validation cost, and it is stopped where its validation cost is above the median of the trials before it [1].
All trials simulate the same number of samples, however long they hold a residual. Trials are kept in a journal, in
which several processes work together; those of other machines reach it through Optuna's proxy in this process.

[1] D. Golovin et al.: Google Vizier: A Service for Black-Box Optimization, KDD 2017.
"""

from __future__ import annotations

import shlex
import shutil
import socket
import threading
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

import optuna
import tyro
from optuna.trial import FrozenTrial, Trial, TrialState

from agents.learners.registry import ALGORITHMS, SPACES, Searched
from agents.learners.reinforcement import ReinforcementConfig
from agents.runs.training import News, train
from baselines.engines.parallel import (
    Channel,
    Failure,
    Interrupted,
    SideBySide,
    StopRequest,
    default_jobs,
    run_side_by_side,
)
from baselines.tools.command import require_bounds, this_python
from baselines.tools.files import require_writable
from baselines.tools.options import Groups, note_options, noted_options
from baselines.tuning import study as studies

_FIRST_SEED, _SEEDS = 50, 50  # training seeds of trials; a run to be reported has one below
_VALIDATIONS = 10  # per trial


@dataclass(frozen=True)
class TuningConfig(SideBySide):
    """Options of `train/tune.py`."""

    groups: ClassVar[Groups] = {
        "basic": ("algorithm", "trials", "seed", "out", "resume"),
        "trial": (),
        "run": ("jobs", "engine", "address"),
    }

    algorithm: tyro.conf.Positional[Searched]
    """Algorithm to tune."""
    trials: int = 40
    """Trials in all, with those from before an interruption."""
    samples: int = 6_000_000
    """Simulated samples per trial. An agent step takes `hold` of them. Each trial is validated after
    a tenth of them or little more, as its rollouts end."""
    seed: int = 0
    """Seed of the search. Trial k trains with seed 50 + k modulo 50; those that were interrupted do not count."""
    base: str = "paper"
    """Controller that the agent corrects."""
    moves: int = 1
    """Moves of an episode, in a row."""
    arms: int = 512
    """Arms that a trial simulates at the same time."""
    validation_arms: int = 128
    """Arms in each validation."""
    out: Path = Path("results/train-tune")
    """Folder of the studies, ALGORITHM.journal, of their options and of their tables, ALGORITHM.csv."""
    resume: bool = False
    """Continue the study in --out."""

    def file(self, kind: str) -> Path:
        """File of the study: its "journal", the "json" of its options, or the "csv" table of its trials."""
        return self.out / f"{self.algorithm}.{kind}"

    def begun(self) -> dict[str, Any]:
        """Options that the study to be resumed was begun with, or resumed with last; none where nothing is resumed.

        Raises:
            ValueError: If the file that notes them is damaged.
        """
        return noted_options(self.file("json"), "algorithm", "out", "resume") if self.resume else {}

    def check(self) -> None:
        """Check the options.

        Raises:
            ValueError: Naming the option.
            FileNotFoundError: If there is nothing to resume.
        """
        self.check_engine()
        require_bounds(self, trials=(1, 400), samples=(1000, None), seed=(0, None))
        self.run({}, 0).check()
        journal = self.file("journal")
        if self.resume and not journal.exists():
            raise FileNotFoundError(f"nothing to resume: {journal} is missing; run once without --resume")
        if journal.exists() and not self.resume:
            raise ValueError(f"{journal} already holds a study: continue it with --resume, or choose another --out")

    def run(self, settings: dict[str, Any], number: int) -> ReinforcementConfig:
        """Options of the training run of a trial."""
        kind: Any = ALGORITHMS[self.algorithm]
        shared = {"out": self.out / f"{self.algorithm}-trial{number}", **self.given()}
        options = {**kind(**shared).usual(), **settings, **shared}
        if "hidden" in settings:
            options["hidden"] = [int(width) for width in settings["hidden"].split()]
        steps = self.samples // options.get("hold", kind.hold)
        options |= {"arms": self.arms, "validation_arms": self.validation_arms, "total_steps": steps}
        options["validation_every"] = -(-steps // _VALIDATIONS)
        return kind(seed=_FIRST_SEED + number % _SEEDS, overwrite=True, **options)

    def given(self) -> dict[str, Any]:
        """Options of all trials that are not the script's own; no teacher is, whose samples would count."""
        return {"base": self.base, "moves": self.moves, **({"teacher_rounds": 0} if self.algorithm == "ppo" else {})}

    def defaults(self) -> dict[str, Any]:
        """Settings that the algorithm has by default, as the study notes them."""
        run = self.run({}, 0)
        values = {name: getattr(run, name) for name in SPACES[self.algorithm]}
        if "hidden" in values:
            values["hidden"] = " ".join(str(width) for width in run.hidden)
        return values


def open_study(config: TuningConfig, storage: Any = None) -> optuna.Study:
    """Open the study in the journal, or through a proxy of its storage, or begin one.

    Raises:
        ValueError: If the journal is damaged, or was begun with other code or options.
    """
    begun = {name: getattr(config, name) for name in ("samples", "base", "moves", "arms", "validation_arms", "seed")}
    begun["base_hash"] = config.run({}, 0).identity()["base_hash"]
    pruner = optuna.pruners.MedianPruner(n_startup_trials=5, n_warmup_steps=_VALIDATIONS // 3)
    packages, remedy = ("beltarm_env", "baselines", "agents"), "give the same options, or choose another --out"
    journal = config.file("journal")
    return studies.open_study(journal, begun, pruner, packages=packages, remedy=remedy, storage=storage)


def tune(
    config: TuningConfig, stop: StopRequest | None = None, tell: Callable[[str], object] = lambda _: None
) -> optuna.Study:
    """Run trials until there are enough, or until asked to stop; `tell` gets lines about them.

    Raises:
        ValueError: If an option is not allowed, the journal holds another study or is used by another process, or a
            worker failed.
        OSError: If files cannot be written, or there is nothing to resume.
    """
    config.check()
    require_writable(config.out)
    with studies.own(config.file("journal")):
        done = len(counted(begin(config)))
        note_options(config.file("json"), config)
        jobs = config.jobs or default_jobs()
        remaining = max(config.trials - done, 0)
        tell(f"{remaining} trials of {config.algorithm}, {config.samples} samples each, {jobs} at a time")
        work = run_trials if config.engine == "local" else partial(_run_trials_away, server=_serve(config))
        workers = {f"worker {number}": partial(work, config, number) for number in range(jobs)}
        ends = run_side_by_side(workers, replace(config, jobs=jobs), stop=stop, tell=lambda _, line: tell(line))
        with closing(ends):
            failed = [f"{name}: {end.message}" for name, end in ends if isinstance(end, Failure)]
        if failed:
            raise ValueError("\n".join(failed))
        return open_study(config)


def begin(config: TuningConfig, storage: Any = None, worker: int | None = None) -> optuna.Study:
    """Open the study, which begins with the algorithm's defaults; interrupted trials, or a worker's, are repeated."""
    study = open_study(config, storage)
    for place in studies.repeat_interrupted(study, worker):
        shutil.rmtree(config.run({}, place).out, ignore_errors=True)
    if not study.get_trials(deepcopy=False):
        study.enqueue_trial(config.defaults())
    return study


def _serve(config: TuningConfig) -> tuple[str, int]:
    """Serve the study's storage to other machines for as long as this process lives; gives its host and port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect(("10.255.255.255", 1))  # sends nothing; tells the address that other machines see
        host = probe.getsockname()[0]
    with socket.socket() as probe:
        probe.bind((host, 0))
        port = probe.getsockname()[1]
    warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)  # Optuna's proxy is one
    single = ThreadPoolExecutor(1)  # more calls at a time would give a waiting trial to two workers
    storage = studies.storage_in(config.file("journal"))
    serve = partial(optuna.storages.run_grpc_proxy_server, storage, host=host, port=port, thread_pool=single)
    threading.Thread(target=serve, daemon=True).start()
    return host, port


def _run_trials_away(config: TuningConfig, worker: int, channel: Channel, server: tuple[str, int]) -> None:
    """Run trials on a machine that does not see the study's file, in a folder of its own."""
    host, port = server
    warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
    with TemporaryDirectory(prefix="beltarm-") as folder:
        storage = optuna.storages.GrpcStorageProxy(host=host, port=port)
        storage.wait_server_ready(timeout=60)
        run_trials(replace(config, out=Path(folder)), worker, channel, storage)


def run_trials(config: TuningConfig, worker: int, channel: Channel, storage: Any = None) -> None:
    """Run trials until there are enough; a worker whose process died begins again with a new one."""
    study = begin(config, storage, worker)
    while not channel.stop.made and len(counted(study)) < config.trials:
        trial = studies.ask(study, SPACES[config.algorithm], config.seed, worker)
        run = config.run(trial.params, studies.place(study, trial))
        costs: list[float] = []
        try:
            train(run, Channel(partial(_judge, trial, run, costs), channel.stop))
            cost = min(costs)
        except optuna.TrialPruned:
            study.tell(trial, state=TrialState.PRUNED)
        except Interrupted:
            return  # the trial is repeated when the study goes on
        except ValueError as error:
            trial.set_user_attr("failure", str(error))
            study.tell(trial, state=TrialState.FAIL)
        else:
            study.tell(trial, cost)
            channel.report(f"trial {trial.number}: cost {cost:.1f}, best {study.best_value:.1f}")
        finally:
            shutil.rmtree(run.out, ignore_errors=True)


def _judge(trial: Trial, run: ReinforcementConfig, costs: list[float], news: News) -> None:
    """Add the cost of a validation to those of a trial, and end the trial if it is worse than most at that tenth.

    That of the untrained policy does not count: all trials would have it. Long rollouts pass over some tenths.
    """
    if news.cost is None or news.steps == 0:
        return
    costs.append(news.cost)
    trial.report(news.cost, _VALIDATIONS if news.steps >= run.length else news.steps // run.validation_every)
    if trial.should_prune():
        raise optuna.TrialPruned


def counted(study: optuna.Study) -> list[FrozenTrial]:
    """Trials without those that an interruption cost."""
    return [
        trial
        for trial in study.get_trials(deepcopy=False)
        if trial.state not in (TrialState.FAIL, TrialState.WAITING) or "diverged" in trial.user_attrs.get("failure", "")
    ]


def training_command(config: TuningConfig, study: optuna.Study) -> str:
    """Command that trains with the settings found.

    Raises:
        ValueError: If no trial was completed.
    """
    trials = study.get_trials(deepcopy=False)
    if not any(trial.state == TrialState.COMPLETE for trial in trials):
        failures = filter(None, (trial.user_attrs.get("failure") for trial in trials))
        raise ValueError(f"no trial of {config.file('journal')} was completed; {next(failures, 'none was run')}")
    options = {**config.given(), **study.best_params, "arms": config.arms}
    arguments = list[str]()
    for name, value in options.items():
        shown = f"{value:.6g}" if isinstance(value, float) else str(value)
        arguments += [f"--{name.replace('_', '-')}", *shown.split()]
    return f"{this_python()} {shlex.join([f'train/{config.algorithm}.py', *arguments])}"
