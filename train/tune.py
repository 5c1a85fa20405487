"""Tune the hyper-parameters of a training script: `python train/tune.py ppo`.

Optuna's tree-structured Parzen estimator proposes settings; a trial is a training run with them, whose value is its
lowest validation cost, and it is stopped where its validation cost is above the median of the trials before it [1].
All trials simulate the same number of samples, however long they hold a residual. Validation arms are those of all
runs, never the comparison's. Trials are kept in an SQLite file, from which `--resume` goes on, and in which several
processes work together. A trial's own run is not kept: at the end, the command is printed that trains with the settings
found.

[1] D. Golovin et al.: Google Vizier: A Service for Black-Box Optimization, KDD 2017.
"""

from __future__ import annotations

import importlib
import shlex
import shutil
import signal
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import optuna
import tyro
from optuna.trial import Trial, TrialState

from agents.learners.reinforcement import ReinforcementConfig
from agents.learners.spaces import SPACES, Algorithm
from agents.runs.command_line import ASKING, start_process, stoppable
from agents.runs.monitor import Interrupted, News, StopRequest
from agents.runs.training import train
from baselines.tools.files import require_writable, write_text


@dataclass(frozen=True)
class Config:
    """Tune the hyper-parameters of a training script."""

    algorithm: tyro.conf.Positional[Algorithm]
    """Whose hyper-parameters."""
    trials: int = 40
    """Trials, those before an interruption included."""
    jobs: int = 2
    """Trials side by side, each in a process of its own."""
    samples: int = 6_000_000
    """Simulated samples of a trial, `hold` to an agent step; validated ten times."""
    seed: int = 0
    """Seed of the search; trial k trains with seed 500 + k."""
    base: str = "paper"
    """Controller that the residual corrects."""
    arms: int = 512
    """Arms simulated side by side in a trial."""
    validation_arms: int = 128
    """Arms per validation."""
    out: Path = Path("results/train-tune")
    """Folder of the SQLite files, ALGORITHM.db, and of the tables made of them, ALGORITHM.csv."""
    resume: bool = False
    """Go on with the study that is there."""

    @property
    def file(self) -> Path:
        """The study's SQLite file."""
        return self.out / f"{self.algorithm}.db"

    @property
    def table(self) -> Path:
        """The trials, to read."""
        return self.out / f"{self.algorithm}.csv"

    def check(self) -> None:
        """Check the options.

        Raises:
            ValueError: Naming the option.
            FileNotFoundError: If there is nothing to resume.
        """
        for name, least in (("trials", 1), ("jobs", 1), ("samples", 1000), ("seed", 0)):
            if getattr(self, name) < least:
                raise ValueError(f"--{name.replace('_', '-')} must be at least {least}, got {getattr(self, name)}")
        if self.trials > _MOST_TRIALS:
            raise ValueError(f"--trials must be at most {_MOST_TRIALS}, got {self.trials}")
        self.run({}, 0).check()
        if self.resume and not self.file.exists():
            raise FileNotFoundError(f"nothing to resume: {self.file} is missing; run once without --resume")
        if self.file.exists() and not self.resume:
            raise ValueError(f"{self.file} holds a study already: go on with it by --resume, or choose another --out")

    def run(self, settings: dict[str, Any], number: int) -> ReinforcementConfig:
        """The training run of a trial."""
        options = {**settings}
        if "hidden" in settings:
            options["hidden"] = tuple(int(width) for width in settings["hidden"].split())
        script = _script(self.algorithm).Config
        steps = self.samples // options.get("hold", script.hold)
        return script(
            out=self.out / f"{self.algorithm}-trial{number}",
            seed=_FIRST_SEED + number,
            base=self.base,
            total_steps=steps,
            arms=self.arms,
            validation_every=max(steps // _VALIDATIONS, 1),
            validation_arms=self.validation_arms,
            overwrite=True,
            **options,
        )

    def own(self) -> dict[str, Any]:
        """The script's own settings, as the study has them."""
        run = self.run({}, 0)
        values = {name: getattr(run, name) for name in SPACES[self.algorithm]}
        if "hidden" in values:
            values["hidden"] = " ".join(str(width) for width in run.hidden)
        return values


_FIRST_SEED = 500
_MOST_TRIALS = 400
_VALIDATIONS = 10  # per trial


def _script(algorithm: str) -> Any:
    return importlib.import_module(f"train.{algorithm}")


def open_study(config: Config, worker: int = 0) -> optuna.Study:
    """The study in the SQLite file, or a new one that begins with the script's own settings.

    Raises:
        ValueError: If the file is damaged, or was begun with other options.
    """
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    try:
        study = optuna.create_study(
            study_name=config.algorithm,
            storage=f"sqlite:///{config.file.resolve()}",
            load_if_exists=True,
            sampler=optuna.samplers.TPESampler(seed=100 * config.seed + worker, multivariate=True),
            pruner=optuna.pruners.MedianPruner(n_startup_trials=5, n_warmup_steps=_VALIDATIONS // 3),
        )
    except Exception as error:  # SQLAlchemy's, of many kinds
        raise ValueError(f"{config.file} cannot be read ({type(error).__name__}): choose another --out") from None
    begun = {name: getattr(config, name) for name in ("samples", "base", "arms", "validation_arms", "seed")}
    if study.user_attrs.get("begun", begun) != begun:
        raise ValueError(f"{config.file} was begun with {study.user_attrs['begun']}: give the same, or another --out")
    study.set_user_attr("begun", begun)
    return study


def _prepare(config: Config) -> None:
    """Begin the study, or mark as failed what an interruption left running."""
    study = open_study(config)
    for trial in study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
        study.tell(trial.number, state=TrialState.FAIL)
    if not study.get_trials(deepcopy=False):
        study.enqueue_trial(config.own())


def _work(config: Config, worker: int) -> None:
    """Body of a process."""
    stop = StopRequest()
    with stoppable(stop, (signal.SIGTERM,)):
        _search(config, worker, stop)


def _search(config: Config, worker: int, stop: StopRequest) -> None:
    """Trials until there are enough."""
    study = open_study(config, worker)
    while not stop.made and len(counted(study)) < config.trials:
        trial = study.ask(SPACES[config.algorithm])
        try:
            value = _value(config, trial, stop)
        except optuna.TrialPruned:
            study.tell(trial, state=TrialState.PRUNED)
        except (Interrupted, ValueError) as error:
            trial.set_user_attr("failure", str(error))
            study.tell(trial, state=TrialState.FAIL)
        else:
            study.tell(trial, value)
            print(f"trial {trial.number}: cost {value:.1f}, best {study.best_value:.1f}", flush=True)
        finally:
            shutil.rmtree(config.run({}, trial.number).out, ignore_errors=True)


def counted(study: optuna.Study) -> list[Any]:
    """All trials but those that an interruption cost."""
    return [
        trial
        for trial in study.get_trials(deepcopy=False)
        if trial.state not in (TrialState.FAIL, TrialState.WAITING) or "diverged" in trial.user_attrs.get("failure", "")
    ]


def _value(config: Config, trial: Trial, stop: StopRequest) -> float:
    """Lowest validation cost of a run with the trial's settings."""
    costs: list[float] = []

    def judge(news: News) -> None:
        if news.cost is None:
            return
        costs.append(news.cost)
        trial.report(news.cost, len(costs))
        if trial.should_prune():
            raise optuna.TrialPruned

    train(config.run(trial.params, trial.number), _script(config.algorithm).make_learner, judge, stop)
    return min(costs)


def tune(config: Config, stop: StopRequest) -> optuna.Study:
    """Run trials until there are enough, or until asked to stop.

    Raises:
        ValueError: If an option is not allowed, there is another study in the file, or all trials failed.
        OSError: If files cannot be written, or there is nothing to resume.
    """
    config.check()
    require_writable(config.out)
    _prepare(config)
    if config.jobs == 1:
        _search(config, 0, stop)
        return open_study(config)
    processes = [start_process(_work, (config, worker), 1) for worker in range(config.jobs)]
    asked = False
    while any(process.is_alive() for process in processes):
        if stop.made and not asked:
            asked = True
            for process in processes:
                process.terminate()
        for process in processes:
            process.join(0.2)
    return open_study(config)


def trials(study: optuna.Study) -> str:
    """All trials as CSV: number, validation cost, settings, and whether one was stopped before its end."""
    table = study.trials_dataframe(attrs=("number", "value", "params", "state", "duration"))
    return table.to_csv(index=False)


def command(config: Config, study: optuna.Study) -> str:
    """The command that trains with the settings found.

    Raises:
        ValueError: If no trial was completed.
    """
    if not study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,)):
        failures = [trial.user_attrs.get("failure", "") for trial in study.get_trials(deepcopy=False)]
        raise ValueError(f"no trial of {config.file} was completed; {next(filter(None, failures), 'none was run')}")
    options = {"base": config.base, **study.best_params}
    words = [w for name, value in options.items() for w in (f"--{name.replace('_', '-')}", *_shown(value).split())]
    return shlex.join(["python", f"train/{config.algorithm}.py", *words, "--arms", str(config.arms)])


def _shown(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def main() -> None:
    """Command line."""
    config, stop = tyro.cli(Config, description=__doc__), StopRequest()
    try:
        with stoppable(stop, ASKING):
            study = tune(config, stop)
        if stop.made:
            raise KeyboardInterrupt
        found = command(config, study)
        write_text(config.table, trials(study))
        print(f"{len(counted(study))} trials, see {config.table}; lowest validation cost {study.best_value:.1f}")
        print(f"to train with it:\n  {found}")
    except KeyboardInterrupt:
        again = shlex.join(["python", "train/tune.py", *(a for a in sys.argv[1:] if a != "--resume"), "--resume"])
        print(f"interrupted; trials are kept in {config.file}; to go on:\n  {again}")
        sys.exit(130)
    except (OSError, ValueError) as error:
        print(f"train/tune.py: {error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
