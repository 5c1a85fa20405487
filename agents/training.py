"""A training run, from its options to its policies; `agents.runs` is the command line around it."""

from __future__ import annotations

import json
import platform
from collections.abc import Callable
from dataclasses import asdict, replace
from importlib.metadata import version

import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import Logger, make_output_format

from agents.bases import make_base
from agents.bundle import BundleSpec, annotate, save_bundle
from agents.checkpoint import RunFolder
from agents.monitor import Maker, News, StopRequest, TrainingMonitor
from agents.residual_env import ResidualVecEnv
from agents.settings import RunConfig, first_arm_seed
from baselines.provenance import command_line, commit
from beltarm_env import BeltArmVectorEnv, __version__

_PACKAGES = ("numpy", "torch", "stable-baselines3", "sb3-contrib")


def make_env(config: RunConfig) -> ResidualVecEnv:
    """The training arms."""
    arms = BeltArmVectorEnv(config.arms, sensors=config.sensors, randomization="train", autoreset_mode="SameStep")
    return ResidualVecEnv(
        arms,
        make_base(config.base),
        config.residual,
        reward_scale=config.reward_scale / config.hold,
        worst_reward=config.worst_reward,
    )


def train(
    config: RunConfig,
    make_model: Maker,
    report: Callable[[News], object] = lambda _: None,
    stop: StopRequest | None = None,
) -> TrainingMonitor:
    """Run a training, from the beginning or from its checkpoint, to its end.

    Args:
        config: Options.
        make_model: Makes the untrained model.
        report: Called with news.
        stop: Whether to stop early, saving what there is.

    Returns:
        The monitor, which knows what came out.

    Raises:
        Interrupted: If it was asked to stop; it can be resumed.
        ValueError: If an option is not allowed, the folder holds another run, or the training diverges.
        OSError: If files cannot be written; the last checkpoint stays.
    """
    config.check()
    torch.set_num_threads(config.threads)
    folder = RunFolder(config.out)
    folder.begin(config)
    env = make_env(config)
    model = make_model(config, env)
    env.seed(first_arm_seed(config.seed))
    progress = folder.load(model, env) if config.resume else None
    suffix = f"_from_{model.num_timesteps}" if config.resume else ""
    formats = [make_output_format(kind, str(config.out), suffix) for kind in ("csv", "tensorboard")]
    model.set_logger(logger := Logger(str(config.out), formats))
    spec = config.spec(**_origin(config))
    monitor = TrainingMonitor(config, folder, env, spec, report, stop or StopRequest(), progress)
    monitor.init_callback(model)
    try:
        remaining = config.total_steps - model.num_timesteps
        if remaining > 0:
            _learn(model, remaining, monitor)
            _finish(monitor, spec)
    finally:
        logger.close()
        env.close()
    return monitor


def _learn(model: BaseAlgorithm, steps: int, monitor: TrainingMonitor) -> None:
    """Train for so many agent steps; ValueError, naming the remedy, if the training diverges."""
    config = monitor.config
    try:
        model.learn(steps, monitor, config.log_interval, reset_num_timesteps=not config.resume)
    except ValueError as error:
        if any(word in str(error) for word in ("nan", "inf", "finite")):
            message = f"diverged at {model.num_timesteps} steps: begin anew with a smaller --learning-rate"
            raise ValueError(message) from None
        raise


def _finish(monitor: TrainingMonitor, spec: BundleSpec) -> None:
    """Leave the last policy, and in the best one what has become of the run since."""
    folder, known = monitor.folder, monitor.provenance()
    scores = {name: value for name, value in monitor.progress["curve"][-1].items() if name not in ("steps", "seconds")}
    reached = {**known["run"], "validation": scores}
    provenance = {**spec.provenance, **known, "reached": reached, "validation_of_base": monitor.base_scores}
    save_bundle(folder.last, replace(spec, provenance=provenance), monitor.actor())
    annotate(folder.best, **known)


def _origin(config: RunConfig) -> dict[str, object]:
    """Where a policy comes from."""
    return {
        "command": command_line(),
        "version": __version__,
        "commit": commit(),
        "versions": {"python": platform.python_version(), **{name: version(name) for name in _PACKAGES}},
        "config": json.loads(json.dumps(asdict(config), default=str)),
    }
