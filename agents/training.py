"""What training scripts share: validation, checkpoints, progress, and stopping without losing anything."""

from __future__ import annotations

import csv
import json
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback

from agents.bundle import BundleSpec, save_bundle
from agents.residual import ResidualController
from baselines import CONTROLLERS
from baselines.files import write_atomically, write_text
from beltarm_env.rollout import Controller, rollout

VALIDATION_SEED = 7_000_000
"""Seed of the arms on which checkpoints are compared: training seeds lie below, the comparison's seeds above."""
SCORES = ("cost", "tip_rms_mm", "residual_pp_mm")
_WORDS = ("cost", "tip", "ringing")


def validate(controller: Controller, arms: int, sensors: str = "encoder") -> dict[str, float]:
    """Mean scores over arms drawn from the training ranges with the validation seed."""
    metrics = rollout(controller, arms, seed=VALIDATION_SEED, randomization="train", sensors=sensors).metrics()
    return {name: float(np.mean(metrics[name])) for name in SCORES}


class Checkpoint:
    """The folder of a run: `checkpoint.zip` and `progress.json` to go on from, `best/` the best policy so far."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.model = folder / "checkpoint.zip"
        self.progress = folder / "progress.json"
        self.best = folder / "best"

    def save(self, model: BaseAlgorithm, progress: dict[str, Any]) -> None:
        """Write model and progress, each atomically."""
        write_atomically(self.model, lambda path: model.save(path))
        write_text(self.progress, json.dumps(progress, indent=2) + "\n")

    def load_progress(self) -> dict[str, Any]:
        """Progress of the last save.

        Raises:
            FileNotFoundError: If there is nothing to resume.
        """
        if not (self.model.exists() and self.progress.exists()):
            raise FileNotFoundError(f"nothing to resume in {self.folder}: run once without --resume")
        return json.loads(self.progress.read_text(encoding="utf-8"))


class TrainingMonitor(BaseCallback):
    """Validates every so often, keeps the best policy and a checkpoint, and shows progress.

    Args:
        checkpoint: Where to save.
        spec: What the policy is; its provenance is completed with what was reached.
        total_steps: Steps of the whole run.
        every: Steps between validations.
        arms: Arms per validation.
        progress: What an interrupted run had reached, for `--resume`.
    """

    def __init__(
        self,
        checkpoint: Checkpoint,
        spec: BundleSpec,
        *,
        total_steps: int,
        every: int,
        arms: int,
        progress: dict[str, Any] | None = None,
    ) -> None:
        super().__init__()
        self.checkpoint = checkpoint
        self.spec = spec
        self.total_steps = total_steps
        self.every = every
        self.arms = arms
        self.state = progress or {"steps": 0, "seconds": 0.0, "best_cost": float("inf"), "best_steps": 0}
        self._next = self.state["steps"] + every
        self._before = self.state["seconds"]
        self._began = time.perf_counter()
        base = CONTROLLERS[spec.base]()
        self.base_scores = validate(base, arms, spec.sensors)
        self._display = Progress(
            TextColumn("{task.percentage:3.0f} %"),
            BarColumn(bar_width=16),
            TimeRemainingColumn(),
            TextColumn("{task.fields[scores]}"),
        )
        self._task = self._display.add_task("train", total=total_steps, completed=self.state["steps"], scores="")

    @property
    def seconds(self) -> float:
        """Wall-clock of the run so far, earlier parts included [s]."""
        return self._before + time.perf_counter() - self._began

    def _on_training_start(self) -> None:
        self._display.start()

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        self._display.update(self._task, completed=self.num_timesteps)

    def _on_rollout_start(self) -> None:
        # Between update and rollout, so that what is validated is what is saved.
        if self.num_timesteps >= self._next:
            self.evaluate()
            self._next = self.num_timesteps + self.every

    def _on_training_end(self) -> None:
        self.stop()

    def stop(self) -> None:
        """Validate and save once more, and end the display."""
        self.evaluate()
        self._display.stop()

    def evaluate(self) -> None:
        """Validate, log, keep the policy if it is the best so far, and save a checkpoint."""
        base = CONTROLLERS[self.spec.base]()
        controller = ResidualController(base, self.model.policy, self.spec.residual)  # pyright: ignore[reportArgumentType]
        scores = validate(controller, self.arms, self.spec.sensors)
        ratios = {name: scores[name] / self.base_scores[name] for name in SCORES}
        for name in SCORES:
            self.logger.record(f"validation/{name}", scores[name])
            self.logger.record(f"validation/{name}_over_base", ratios[name])
        self.state.update(steps=self.num_timesteps, seconds=round(self.seconds, 1))
        if scores["cost"] < self.state["best_cost"]:
            self.state.update(best_cost=scores["cost"], best_steps=self.num_timesteps)
            save_bundle(self.checkpoint.best, self._completed_spec(scores), self.model.policy)
        self._append({"steps": self.num_timesteps, "seconds": round(self.seconds, 1), **scores})
        self.checkpoint.save(self.model, self.state)
        shown = ", ".join(f"{word} {ratios[name]:.2f}x" for name, word in zip(SCORES, _WORDS, strict=True))
        self._display.update(self._task, completed=self.num_timesteps, scores=f"{shown} of the base")

    def _completed_spec(self, scores: dict[str, float]) -> BundleSpec:
        reached = {"steps": self.num_timesteps, "seconds": round(self.seconds, 1), "validation": scores}
        provenance = {**self.spec.provenance, "reached": reached, "validation_of_base": self.base_scores}
        return replace(self.spec, provenance=provenance)

    def _append(self, row: dict[str, float]) -> None:
        """Add a line to validation.csv, which a resumed run goes on with."""
        path = self.checkpoint.folder / "validation.csv"
        new = not path.exists()
        with path.open("a", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, fieldnames=list(row))
            if new:
                writer.writeheader()
            writer.writerow(row)


@contextmanager
def interruptible() -> Iterator[None]:
    """Let SIGTERM interrupt like Ctrl-C, so that both can be caught as KeyboardInterrupt."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
