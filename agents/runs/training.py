"""Training run from options to policies: validation, the best policy, checkpoints, progress and the training log.

`agents.runs.command_line` is the command line around it. Stable-Baselines3's `EvalCallback` is not enough: it scores
rewards of a `VecEnv`, not the task's metrics beside those of the base, and only models of its own, not a student.
"""

from __future__ import annotations

import json
import time
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
import torch
from stable_baselines3.common.logger import Logger, make_output_format

from agents.policy.actor import Actor
from agents.policy.bundle import annotate, read_spec, save_bundle
from agents.policy.description import BundleError, BundleSpec
from agents.policy.network import NetworkPolicy
from agents.residual.bases import make_base
from agents.residual.controller import ResidualController
from agents.runs.checkpoint import RunFolder, written_by
from agents.runs.settings import RunConfig
from baselines.engines.parallel import Channel, Interrupted
from baselines.tools.files import errors_about
from baselines.tools.provenance import command_line
from beltarm_env.observation import Sensors
from beltarm_env.rollout import Controller, rollout
from beltarm_env.task.seeds import VALIDATION

SCORES = {"cost": "cost", "tip_rms_mm": "tip", "residual_pp_mm": "ringing"}
"""Metrics of a validation, and what progress calls them."""
_LEAST = 1e-6  # of a score of the base to compare with: an arm without one is at rest, but for rounding
_NEWS_EVERY = 0.5  # [s]


def validate(controller: Controller, arms: int, moves: int = 1, sensors: Sensors = "encoder") -> dict[str, float]:
    """Compute mean scores over arms of the training ranges, drawn with the validation seed."""
    run = rollout(controller, arms, seed=VALIDATION.first, randomization="train", moves=moves, sensors=sensors)
    metrics = run.metrics()
    return {name: float(np.mean(metrics[name])) for name in SCORES}


class News(NamedTuple):
    """Progress of a run."""

    steps: int
    scores: str  # of the last validation, in words
    cost: float | None = None  # of a validation just made


class Learner(Protocol):
    """Protocol of a learner: an actor, and the whole state of its training."""

    @property
    def steps(self) -> int:
        """Agent steps so far, each of `hold` simulated samples."""
        ...

    def actor(self) -> Actor:
        """Copy of the current policy."""
        ...

    def learn(self, monitor: TrainingMonitor) -> None:
        """Learn to the end of the run, calling the monitor; raises ValueError, with a remedy, if it diverges."""
        ...

    def snapshot(self) -> dict[str, Any]:
        """State that determines the next step, without the random generators of Python, NumPy and PyTorch."""
        ...

    def restore(self, state: dict[str, Any]) -> None:
        """Restore a snapshot into a new learner of the same options."""
        ...


class TrainingMonitor:
    """Validates a run, keeps its best policy and a checkpoint, reports progress, and stops on request.

    A learner calls it between two updates, where the state of the run is complete. The channel gets news, twice a
    second at most and after every validation. The policies' provenance has the command that began the run, and those
    that gave it another length.
    """

    def __init__(self, config: RunConfig, folder: RunFolder, channel: Channel, command: str) -> None:
        self.config = config
        self.folder = folder
        self.channel = channel
        self.learner = config.make_learner()
        begun = {"command": command, "length": config.length}
        self.progress: dict[str, Any] = {"seconds": 0.0, "best_cost": np.inf, "scores": "", "curve": [], **begun}
        resumed = config.resume and folder.checkpoint.exists()  # else it was killed before it had one
        if resumed:
            self.progress = folder.load(self.learner.restore)
            if config.length < min(self.learner.steps, self.progress["length"]):  # a rollout may go beyond it
                raise ValueError(
                    f"the run in {folder.folder} has {self.learner.steps} agent steps already, more than it is now "
                    f"to end at, {config.length}: give a larger --total-steps or --rounds"
                )
        self._has_another_length = self.progress["length"] != config.length
        if self._has_another_length:
            self.progress |= {"command": f"{self.progress['command']} && {command}", "length": config.length}
        folder.note(config, self.progress["curve"] if resumed else None)
        options = json.loads(json.dumps(asdict(config), default=str))
        self.spec = config.spec(command=self.progress["command"], **written_by(), config=options)
        logs, suffix = str(folder.folder), f"_from_{self.learner.steps}" if resumed else ""
        self.logger = Logger(logs, [make_output_format(kind, logs, suffix) for kind in ("csv", "tensorboard")])
        self._report(self.learner.steps, self.progress["scores"] or "validating the base and the untrained policy")
        self.base_scores = self._validate(make_base(config.base, config.sensors))
        self._began = time.perf_counter() - self.progress["seconds"]

    @property
    def seconds(self) -> float:
        """Wall-clock of the run so far, earlier parts included [s]."""
        return time.perf_counter() - self._began

    @property
    def curve(self) -> list[tuple[int, float, float]]:
        """Agent steps, seconds and validation cost of all validations."""
        return [(row["steps"], row["seconds"], row["cost"]) for row in self.progress["curve"]]

    def run(self) -> None:
        """Learn to the end, and write the last policy; of a run that is finished already, only what is missing."""
        if self.learner.steps < self.config.length:
            self.learner.learn(self)
        if not self._is_finished():
            scores = {name: self.progress["curve"][-1][name] for name in SCORES}
            annotate(self.folder.best, **self._provenance())
            save_bundle(self.folder.last, self._completed_spec(scores), self.learner.actor().weights())

    def close(self) -> None:
        """Close the log."""
        self.logger.close()

    def begin(self) -> None:
        """Validate the untrained policy, save the first checkpoint and write the first row of the log.

        Of a run that was given another length, save the command that says so.
        """
        if not self.folder.checkpoint.exists():
            self.evaluate()
            self.log()
        elif self._has_another_length:
            self.save()

    def log(self) -> None:
        """Write a row of the training log; raises OSError if it cannot be written."""
        self.logger.record("time/total_timesteps", self.learner.steps)
        self.logger.dump(self.learner.steps)

    def stop_if_asked(self, save: bool = True) -> None:
        """Raise Interrupted on a request to stop, after saving a checkpoint if `save`; OSError if that fails."""
        if self.channel.stop.made:
            if save:
                self.save()
            raise Interrupted(f"interrupted at {self.learner.steps} steps, saved in {self.config.out}")

    def tell(self, steps: int) -> None:
        """Report the steps reached, twice a second at most."""
        if time.perf_counter() - self._reported >= _NEWS_EVERY:
            self._report(steps, self.progress["scores"])

    def evaluate(self) -> None:
        """Validate, log, keep the best policy and save a checkpoint, once per number of steps."""
        steps = self.learner.steps
        if self.progress["curve"] and self.progress["curve"][-1]["steps"] == steps:
            return
        weights = self.learner.actor().weights()
        base = make_base(self.config.base, self.config.sensors)
        scores = self._validate(ResidualController(base, NetworkPolicy(weights), self.spec.residual))
        ratios = {name: scores[name] / value for name, value in self.base_scores.items() if value > _LEAST}
        logged = scores | {f"{name}_over_base": ratio for name, ratio in ratios.items()}
        for name, value in logged.items():
            self.logger.record(f"validation/{name}", value)
        summary = ", ".join(f"{SCORES[name]} {ratio:.2f}x" for name, ratio in ratios.items())
        self.progress["scores"] = f"{summary} of the base"
        self.progress["curve"].append({"steps": steps, "seconds": round(self.seconds, 1), **scores})
        if scores["cost"] < self.progress["best_cost"]:
            self.progress["best_cost"] = scores["cost"]
            save_bundle(self.folder.best, self._completed_spec(scores), weights)
        self.save()
        self._report(steps, self.progress["scores"], scores["cost"])

    def save(self) -> None:
        """Save a checkpoint."""
        self.progress["seconds"] = self.seconds
        self.folder.save(self.learner.snapshot(), self.progress)

    def _report(self, steps: int, scores: str, cost: float | None = None) -> None:
        self._reported = time.perf_counter()
        self.channel.report(News(steps, scores, cost))

    def _validate(self, controller: Controller) -> dict[str, float]:
        return validate(controller, self.config.validation_arms, self.config.moves, self.config.sensors)

    def _provenance(self) -> dict[str, Any]:
        """Steps, time and learning curve so far, for the provenance of policies."""
        run = {"steps": self.learner.steps, "seconds": round(self.seconds, 1)}
        return {"run": run, "curve": [list(point) for point in self.curve]}

    def _completed_spec(self, scores: dict[str, float]) -> BundleSpec:
        """Specification of the policy that reached these validation scores just now."""
        known = self._provenance()
        reached = {"reached": {**known["run"], "validation": scores}, "validation_of_base": self.base_scores}
        return replace(self.spec, provenance={**self.spec.provenance, **known, **reached})

    def _is_finished(self) -> bool:
        """Whether the last policy, which is written at the very end, is there and of these steps."""
        try:
            return read_spec(self.folder.last)[0].provenance["run"]["steps"] == self.learner.steps
        except (BundleError, KeyError):
            return False


def train(
    config: RunConfig, channel: Channel | None = None, command: str | None = None, place: Path | None = None
) -> TrainingMonitor:
    """Run a training, from the beginning or from its checkpoint, to its end.

    The channel gets `News`; a request to stop saves what there is. The command is by default that of this process, and
    `place`, where it works, the folder `config.out`.

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
        with closing(TrainingMonitor(config, folder, channel or Channel(), command or command_line())) as monitor:
            monitor.run()
    return monitor
