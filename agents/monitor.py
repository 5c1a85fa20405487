"""What goes on beside a training run: validation, keeping the best policy, checkpoints, telling how far it has come."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback

from agents.actor import Actor, actor_of
from agents.bases import make_base
from agents.bundle import BundleSpec, save_bundle
from agents.checkpoint import RunFolder
from agents.residual import ResidualController
from agents.residual_env import ResidualVecEnv
from agents.settings import RunConfig
from beltarm_env.rollout import Controller, rollout

VALIDATION_SEED = 7_000_000
"""Seed of the arms on which checkpoints are compared: training seeds lie below, the comparison's seeds above."""
SCORES = ("cost", "tip_rms_mm", "residual_pp_mm")
_WORDS = ("cost", "tip", "ringing")
_NEWS_EVERY = 0.5  # [s]


def validate(controller: Controller, arms: int, sensors: Any = "encoder") -> dict[str, float]:
    """Mean scores over arms drawn from the training ranges with the validation seed."""
    metrics = rollout(controller, arms, seed=VALIDATION_SEED, randomization="train", sensors=sensors).metrics()
    return {name: float(np.mean(metrics[name])) for name in SCORES}


class News(NamedTuple):
    """How far a run has come."""

    steps: int
    scores: str  # of the last validation, in words
    cost: float | None = None  # of a validation just made


class StopRequest:
    """Asks a run to stop between two updates, where it loses nothing."""

    def __init__(self) -> None:
        self.made = False


class Interrupted(Exception):  # noqa: N818
    """A run stopped because it was asked to, and is saved."""


class TrainingMonitor(BaseCallback):
    """Validates every so often, keeps the best policy and a checkpoint, tells about progress, and stops when asked.

    It acts between update and rollout, where everything that a run consists of is at rest.

    Args:
        config: Options of the run.
        folder: Where to save.
        env: The arms.
        spec: What the policy is; its provenance is completed with what was reached.
        report: Called with news, twice a second at most, and after every validation.
        stop: Whether to stop.
        progress: What an interrupted run had reached.
    """

    def __init__(
        self,
        config: RunConfig,
        folder: RunFolder,
        env: ResidualVecEnv,
        spec: BundleSpec,
        report: Callable[[News], object],
        stop: StopRequest,
        progress: dict[str, Any] | None = None,
    ) -> None:
        super().__init__()
        self.config = config
        self.folder = folder
        self.env = env
        self.spec = spec
        self.report = report
        self.stop = stop
        base = validate(make_base(config.base), config.validation_arms, config.sensors)
        new = {"seconds": 0.0, "best_cost": np.inf, "next": config.validation_every, "scores": "", "curve": []}
        self.progress: dict[str, Any] = progress or new
        self.base_scores = base
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

    def _on_step(self) -> bool:
        return True

    def _on_training_start(self) -> None:
        if not self.folder.checkpoint.exists():
            self.evaluate()  # where the curve begins; and a run can be resumed from its first moment on

    def _on_rollout_start(self) -> None:
        if self.stop.made:
            self.save()
            raise Interrupted(f"interrupted at {self.num_timesteps} steps, saved in {self.config.out}")
        if self.num_timesteps >= self.progress["next"]:
            self.progress["next"] = self.num_timesteps + self.config.validation_every
            self.evaluate()

    def _on_rollout_end(self) -> None:
        if time.perf_counter() - self._told >= _NEWS_EVERY:
            self._told = time.perf_counter()
            self.report(News(self.num_timesteps, self.progress["scores"]))

    def _on_training_end(self) -> None:
        self.evaluate()

    def actor(self) -> Actor:
        """The policy as it acts, a copy."""
        return actor_of(self.model.policy, self.spec.shape())

    def evaluate(self) -> None:
        """Validate, log, keep the policy if it is the best so far, and save a checkpoint; once for every state."""
        if self.progress["curve"] and self.progress["curve"][-1]["steps"] == self.num_timesteps:
            return
        actor = self.actor()
        controller = ResidualController(make_base(self.config.base), actor, self.spec.residual)
        scores = validate(controller, self.config.validation_arms, self.config.sensors)
        ratios = {name: scores[name] / self.base_scores[name] for name in SCORES}
        for name in SCORES:
            self.logger.record(f"validation/{name}", scores[name])
            self.logger.record(f"validation/{name}_over_base", ratios[name])
        words = ", ".join(f"{word} {ratios[name]:.2f}x" for name, word in zip(SCORES, _WORDS, strict=True))
        self.progress["scores"] = f"{words} of the base"
        self.progress["curve"].append({"steps": self.num_timesteps, "seconds": round(self.seconds, 1), **scores})
        if scores["cost"] < self.progress["best_cost"]:
            self.progress["best_cost"] = scores["cost"]
            save_bundle(self.folder.best, self._completed_spec(scores), actor)
        self.save()
        self.report(News(self.num_timesteps, self.progress["scores"], scores["cost"]))

    def save(self) -> None:
        """Save a checkpoint."""
        self.progress["seconds"] = self.seconds
        self.folder.save(self.model, self.env, self.progress)

    def provenance(self) -> dict[str, Any]:
        """What is known of the run by now, for the provenance of its policies."""
        run = {"steps": self.num_timesteps, "seconds": round(self.seconds, 1)}
        return {"run": run, "curve": [list(point) for point in self.curve]}

    def _completed_spec(self, scores: dict[str, float]) -> BundleSpec:
        reached = {"steps": self.num_timesteps, "seconds": round(self.seconds, 1), "validation": scores}
        known = {**self.spec.provenance, **self.provenance(), "reached": reached}
        return replace(self.spec, provenance={**known, "validation_of_base": self.base_scores})


Maker = Callable[[Any, ResidualVecEnv], BaseAlgorithm]
"""Makes an untrained model from a script's options and the arms."""
