"""Training run from options to policies; `agents.runs.command_line` is the command line around it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import asdict
from pathlib import Path

import torch
from stable_baselines3.common.logger import Logger, make_output_format

from agents.policy.bundle import BundleError, annotate, read_spec, save_bundle
from agents.runs.checkpoint import RunFolder, written_by
from agents.runs.monitor import SCORES, Maker, TrainingMonitor, log_errors
from agents.runs.settings import RunConfig
from baselines.engines.parallel import Channel
from baselines.tools.provenance import command_line


def train(
    config: RunConfig,
    make_learner: Maker,
    channel: Channel | None = None,
    command: str | None = None,
    place: Path | None = None,
) -> TrainingMonitor:
    """Run a training, from the beginning or from its checkpoint, to its end.

    Args:
        config: Options.
        make_learner: Makes the untrained learner.
        channel: Gets `News`; a request to stop saves what there is.
        command: What the policies' provenance says made them; by default the command of this process.
        place: Folder to work in, where that is not `config.out`: on another machine.

    Returns:
        The monitor, with the learning curve.

    Raises:
        Interrupted: If it was asked to stop; it can be resumed.
        ValueError: If an option is not allowed, the folder holds another run, another process works in it, or the
            training diverges.
        OSError: If files cannot be written; the last checkpoint stays.
    """
    config.check()
    torch.set_num_threads(config.threads)
    folder = RunFolder(place or config.out)
    with folder.locked(config):
        return _train(config, make_learner, channel or Channel(), command or command_line(), folder)


def _train(
    config: RunConfig, make_learner: Maker, channel: Channel, command: str, folder: RunFolder
) -> TrainingMonitor:
    folder.begin(config)
    learner = make_learner(config)
    goes_on = config.resume and folder.checkpoint.exists()  # else it was killed before it had one
    progress = folder.load(learner.restore) if goes_on else None
    folder.note(config, progress)
    suffix = f"_from_{learner.steps}" if goes_on else ""
    spec = config.spec(**_origin(config, command))
    with closing(learner), _training_log(folder.folder, suffix) as logger:
        monitor = TrainingMonitor(config, folder, learner, spec, logger, channel, progress)
        if learner.steps < config.length:
            learner.learn(monitor)
        if not _is_finished(monitor):
            _finish(monitor)
    return monitor


@contextmanager
def _training_log(folder: Path, suffix: str) -> Iterator[Logger]:
    """Open the training log, and close it whatever happens."""
    with log_errors(folder):
        logger = Logger(str(folder), [make_output_format(kind, str(folder), suffix) for kind in ("csv", "tensorboard")])
    try:
        yield logger
    except BaseException:
        with suppress(OSError):  # what went wrong before says more
            logger.close()
        raise
    with log_errors(folder):
        logger.close()


def _is_finished(monitor: TrainingMonitor) -> bool:
    """Whether both policies are there, and say all of the run."""
    try:
        found = [read_spec(folder)[0].provenance for folder in (monitor.folder.last, monitor.folder.best)]
    except BundleError:
        return False
    return all(provenance.get("run", {}).get("steps") == monitor.learner.steps for provenance in found)


def _finish(monitor: TrainingMonitor) -> None:
    """Save the last policy, and complete the provenance of the best one."""
    scores = {name: monitor.progress["curve"][-1][name] for name in SCORES}
    save_bundle(monitor.folder.last, monitor.completed_spec(scores), monitor.learner.actor().weights())
    annotate(monitor.folder.best, **monitor.provenance())


def _origin(config: RunConfig, command: str) -> dict[str, object]:
    """Provenance of a policy."""
    return {
        "command": command,
        **written_by(),
        "config": json.loads(json.dumps(asdict(config), default=str)),
    }
