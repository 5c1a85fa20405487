"""Tune the hyper-parameters of a training script: `python train/tune.py ppo`.

Each trial is a training run with other settings, and is stopped early if it is worse than most
(`agents/learners/tuning.py`). Trials are validated on the same arms as all trainings, never on those of the comparison.
They are kept in a journal, from which `--resume` continues; their policies are not kept. At the end, the command
prints how to train with the best settings.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import resume_command, run_command, stop_without

try:
    from agents.learners.tuning import TuningConfig, counted, training_command, tune
    from baselines.engines.parallel import StopRequest, stop_on_signals
    from baselines.tools.files import write_text
except ModuleNotFoundError as error:
    stop_without("train/tune.py", error)


def run(config: TuningConfig) -> None:
    """Tune, and print the command that trains with the settings found; an interruption says how to go on."""
    stop = StopRequest()
    try:
        with stop_on_signals(stop, lambda: print("stopping soon; press Ctrl-C again to stop at once", flush=True)):
            study = tune(config, stop, lambda line: print(line, flush=True))
        if stop.made:
            raise KeyboardInterrupt
        command, table = training_command(config, study), config.file("csv")
        write_text(
            table, study.trials_dataframe(("number", "value", "params", "state", "duration")).to_csv(index=False)
        )
        print(f"{len(counted(study))} trials, see {table}; lowest validation cost {study.best_value:.1f}")
        print(f"to train with it:\n  {command}")
    except KeyboardInterrupt:
        again = resume_command("train/tune.py")
        print(f"interrupted; trials are kept in {config.file('journal')}; to continue:\n  {again}")
        sys.exit(130)


def main() -> None:
    """Command line."""
    run_command(__file__, TuningConfig, run, __doc__, TuningConfig.begun)


if __name__ == "__main__":
    main()
