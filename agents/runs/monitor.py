"""Monitor of a training run: validation, the best policy, checkpoints and progress.

The library's logger writes the training log. Its `EvalCallback` is not enough: it scores rewards of a `VecEnv`, not the
task's metrics beside those of the base, and only for models of its own, which a student is none of.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple, Protocol

import numpy as np
from stable_baselines3.common.logger import Logger

from agents.policy.actor import Actor
from agents.policy.bundle import BundleSpec, save_bundle
from agents.policy.network import NetworkPolicy
from agents.residual.bases import make_base
from agents.residual.controller import ResidualController
from agents.runs.checkpoint import RunFolder
from agents.runs.settings import RunConfig
from baselines.engines.parallel import Channel, Interrupted
from beltarm_env.rollout import Controller, rollout
from beltarm_env.task.seeds import VALIDATION

SCORES = ("cost", "tip_rms_mm", "residual_pp_mm")
_WORDS: dict[str, str] = dict(zip(SCORES, ("cost", "tip", "ringing"), strict=True))
_LEAST = 1e-6  # of a score of the base to compare with: an arm without one is at rest, but for rounding
_NEWS_EVERY = 0.5  # [s]


def validate(controller: Controller, arms: int, sensors: Any = "encoder") -> dict[str, float]:
    """Compute mean scores over arms drawn from the training ranges with the validation seed."""
    metrics = rollout(controller, arms, seed=VALIDATION.first, randomization="train", sensors=sensors).metrics()
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

    def close(self) -> None:
        """Release resources."""
        ...


class TrainingMonitor:
    """Validates a run, keeps its best policy and a checkpoint, reports progress, and stops on request.

    A learner calls it between two updates, where the state of the run is complete.

    Args:
        config: Options of the run.
        folder: Where to save.
        learner: The learner.
        spec: Specification of the policy; the scores reached are added to its provenance.
        logger: The training log.
        channel: Gets news, twice a second at most, and after every validation; asks the run to stop.
        progress: Progress of the interrupted run that is resumed.
    """

    def __init__(
        self,
        config: RunConfig,
        folder: RunFolder,
        learner: Learner,
        spec: BundleSpec,
        logger: Logger,
        channel: Channel,
        progress: dict[str, Any] | None = None,
    ) -> None:
        self.config = config
        self.folder = folder
        self.learner = learner
        self.spec = spec
        self.logger = logger
        self.channel = channel
        self.progress: dict[str, Any] = progress or {"seconds": 0.0, "best_cost": np.inf, "scores": "", "curve": []}
        channel.report(News(learner.steps, self.progress["scores"] or "validating the base and the untrained policy"))
        self.base_scores = validate(make_base(config.base, config.sensors), config.validation_arms, config.sensors)
        self._before = self.progress["seconds"]
        self._began = self._told = time.perf_counter()

    @property
    def seconds(self) -> float:
        """Wall-clock of the run so far, earlier parts included [s]."""
        return self._before + time.perf_counter() - self._began

    @property
    def curve(self) -> list[tuple[int, float, float]]:
        """Agent steps, seconds and validation cost of all validations."""
        return [(row["steps"], row["seconds"], row["cost"]) for row in self.progress["curve"]]

    def begin(self) -> None:
        """Validate the untrained policy, save the first checkpoint and write the first row of the log."""
        if not self.folder.checkpoint.exists():
            self.evaluate()
            self.log()

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
        if time.perf_counter() - self._told >= _NEWS_EVERY:
            self._told = time.perf_counter()
            self.channel.report(News(steps, self.progress["scores"]))

    def evaluate(self) -> None:
        """Validate, log, keep the best policy and save a checkpoint, once per number of steps."""
        steps = self.learner.steps
        if self.progress["curve"] and self.progress["curve"][-1]["steps"] == steps:
            return
        weights = self.learner.actor().weights()
        policy, base = NetworkPolicy(weights), make_base(self.config.base, self.config.sensors)
        controller = ResidualController(base, policy, self.spec.residual)
        scores = validate(controller, self.config.validation_arms, self.config.sensors)
        of_base = self.base_scores
        ratios = {name: scores[name] / of_base[name] for name in SCORES if of_base[name] > _LEAST}
        for name in SCORES:
            self.logger.record(f"validation/{name}", scores[name])
        for name, ratio in ratios.items():
            self.logger.record(f"validation/{name}_over_base", ratio)
        words = ", ".join(f"{_WORDS[name]} {ratio:.2f}x" for name, ratio in ratios.items())
        self.progress["scores"] = f"{words} of the base"
        self.progress["curve"].append({"steps": steps, "seconds": round(self.seconds, 1), **scores})
        if scores["cost"] < self.progress["best_cost"]:
            self.progress["best_cost"] = scores["cost"]
            save_bundle(self.folder.best, self.completed_spec(scores), weights)
        self.save()
        self.channel.report(News(steps, self.progress["scores"], scores["cost"]))

    def save(self) -> None:
        """Save a checkpoint."""
        self.progress["seconds"] = self.seconds
        self.folder.save(self.learner.snapshot(), self.progress)

    def provenance(self) -> dict[str, Any]:
        """Steps, time and learning curve so far, for the provenance of policies."""
        run = {"steps": self.learner.steps, "seconds": round(self.seconds, 1)}
        return {"run": run, "curve": [list(point) for point in self.curve]}

    def completed_spec(self, scores: dict[str, float]) -> BundleSpec:
        """Specification of the policy that reached these validation scores just now."""
        known = self.provenance()
        reached = {"reached": {**known["run"], "validation": scores}, "validation_of_base": self.base_scores}
        return replace(self.spec, provenance={**self.spec.provenance, **known, **reached})


Maker = Callable[[Any], Learner]
"""Makes an untrained learner from options."""
