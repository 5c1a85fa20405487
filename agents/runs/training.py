"""Training run from options to policies; `agents.runs.command_line` is the command line around it."""

from __future__ import annotations

import json
from contextlib import closing
from dataclasses import asdict
from pathlib import Path

import torch
from stable_baselines3.common.logger import Logger, make_output_format

from agents.policy.bundle import annotate, read_spec, save_bundle
from agents.policy.description import BundleError
from agents.runs.checkpoint import RunFolder, written_by
from agents.runs.monitor import SCORES, Maker, TrainingMonitor
from agents.runs.settings import RunConfig
from baselines.engines.parallel import Channel
from baselines.tools.files import errors_about
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
    with folder.locked(config), errors_about(folder.folder):
        return _train(config, make_learner, channel or Channel(), command or command_line(), folder)


def _train(
    config: RunConfig, make_learner: Maker, channel: Channel, command: str, folder: RunFolder
) -> TrainingMonitor:
    learner = make_learner(config)
    goes_on = config.resume and folder.checkpoint.exists()  # else it was killed before it had one
    progress = folder.load(learner.restore) if goes_on else None
    folder.note(config, progress)
    options = json.loads(json.dumps(asdict(config), default=str))
    spec = config.spec(command=command, **written_by(), config=options)
    logs, suffix = str(folder.folder), f"_from_{learner.steps}" if goes_on else ""
    formats = [make_output_format(kind, logs, suffix) for kind in ("csv", "tensorboard")]
    with closing(learner), closing(Logger(logs, formats)) as logger:
        monitor = TrainingMonitor(config, folder, learner, spec, logger, channel, progress)
        if learner.steps < config.length:
            learner.learn(monitor)
        if not _is_finished(monitor):
            scores = {name: monitor.progress["curve"][-1][name] for name in SCORES}
            save_bundle(folder.last, monitor.completed_spec(scores), learner.actor().weights())
            annotate(folder.best, **monitor.provenance())
    return monitor


def _is_finished(monitor: TrainingMonitor) -> bool:
    """Whether both policies are there, and say all of the run."""
    try:
        found = [read_spec(folder)[0].provenance for folder in (monitor.folder.last, monitor.folder.best)]
    except BundleError:
        return False
    return all(provenance.get("run", {}).get("steps") == monitor.learner.steps for provenance in found)
