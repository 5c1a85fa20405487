"""What `eval/ablations.py` varies, how it trains each variant, and how it scores what came out.

Every variant is the default run of `train/ppo.py` with one thing changed, started as a reader would start it, so the
command in the results is the command that made them. The last policy is scored, not the best one: choosing the best of
a curve would flatter the variants whose curves are noisy.
"""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from agents.policy.bundle import BundleError, load_controller, read_spec
from agents.runs.checkpoint import RunFolder
from agents.runs.monitor import SCORES
from baselines.tools.files import write_text
from beltarm_env.rollout import Controller, rollout
from eval.curves import find_curves

ROOT = Path(__file__).resolve().parents[2]
SEED = 4_300_000
"""Seed of the first of the arms that score the variants; arm i has this + i.

They are drawn from the training ranges, above all training seeds, and are used for nothing else: neither a run's
validation (from 7 000 000) nor the comparison (from 8 000 000) chooses an option here.
"""
_VALIDATIONS = 10  # per run
_QUICK = ("--arms", "16", "--rollout-steps", "8", "--batch-size", "128", "--validation-arms", "4")
_INTERRUPTED = 130


@dataclass(frozen=True)
class Variant:
    """One run's options."""

    name: str  # its folder's
    factor: str  # key of `QUESTIONS`
    label: str
    options: tuple[str, ...] = ()
    script: str = "ppo"
    common_budget: bool = True  # False for a learner whose steps are not those of PPO


QUESTIONS = {
    "told": "What must the agent be told of the arm?",
    "base": "Which controller should it correct?",
    "hold": "How long should a residual be held?",
    "discount": "How far should it look ahead?",
    "limit": "How much torque may it add?",
    "exploration": "How wildly should it explore?",
    "learning_rate": "How fast should it learn?",
    "network": "How wide must the network be?",
    "arms": "How many arms at once?",
    "activation": "Does the activation function matter?",
    "teacher": "Does a teacher help?",
}
"""What is varied, and the question behind it."""
DEFAULT = Variant("default", "default", "default")
VARIANTS = (
    DEFAULT,
    Variant("nothing", "told", "nothing", ("--knowledge", "none")),
    Variant("lstm", "told", "nothing, with an LSTM", script="recurrent_ppo"),
    Variant("torsion", "told", "true torsion, no belief", ("--sensors", "full", "--knowledge", "none")),
    Variant("torsion-belief", "told", "true torsion and belief", ("--sensors", "full")),
    Variant("base-preview", "base", "preview", ("--base", "preview")),
    Variant("base-lqg", "base", "lqg", ("--base", "lqg")),
    Variant("base-adaptive", "base", "adaptive", ("--base", "adaptive")),
    Variant("small-on-adaptive", "base", "adaptive, 0.1 of limit", ("--base", "adaptive", "--residual-limit", "0.1")),
    Variant("base-none", "base", "none: from scratch", ("--base", "none")),
    Variant("hold-2", "hold", "3 ms, as far ahead", ("--hold", "2", "--gamma", "0.994")),
    Variant("hold-12", "hold", "18 ms, as far ahead", ("--hold", "12", "--gamma", "0.964")),
    Variant("gamma-0.95", "discount", "0.95: 0.12 s", ("--gamma", "0.95")),
    Variant("gamma-0.98", "discount", "0.98: 0.3 s", ("--gamma", "0.98")),
    Variant("gamma-0.995", "discount", "0.995: 1.2 s", ("--gamma", "0.995")),
    Variant("limit-0.3", "limit", "0.3 of the limit", ("--residual-limit", "0.3")),
    Variant("noise-small", "exploration", "0.14 of the range", ("--initial-log-std", "-2")),
    Variant("noise-large", "exploration", "1.0 of the range", ("--initial-log-std", "0")),
    Variant("entropy-1e-4", "exploration", "with hardly any entropy bonus", ("--entropy", "0.0001")),
    Variant("rate-1e-4", "learning_rate", "1e-4", ("--learning-rate", "0.0001")),
    Variant("rate-1e-3", "learning_rate", "1e-3", ("--learning-rate", "0.001")),
    Variant("width-64", "network", "64, 64", ("--hidden", "64", "64")),
    Variant("width-128", "network", "128, 128", ("--hidden", "128", "128")),
    Variant("arms-128", "arms", "128", ("--arms", "128")),
    Variant("tanh", "activation", "tanh", ("--activation", "tanh")),
    Variant("student", "teacher", "a student of a practised teacher", script="student", common_budget=False),
)
DEFAULTS = {
    "told": "belief of the filter",
    "base": "paper",
    "hold": "6 ms",
    "discount": "0.988: 0.5 s",
    "limit": "the whole limit",
    "exploration": "0.52 of the range",
    "learning_rate": "3.5e-4",
    "network": "256, 256",
    "arms": "512",
    "activation": "relu",
    "teacher": "none: PPO",
}
"""What the default run has of each factor."""


@dataclass(frozen=True)
class Run:
    """One training: a variant and a seed."""

    variant: Variant
    seed: int
    steps: int
    runs: Path
    quick: bool = False

    @property
    def folder(self) -> Path:
        """Where it is kept."""
        return self.runs / self.variant.name / f"seed{self.seed}"

    @property
    def words(self) -> list[str]:
        """Script and options."""
        budget = ["--total-steps", self.steps, "--validation-every", max(self.steps // _VALIDATIONS, 1)]
        common = [*budget, *(_QUICK if self.quick else ())] if self.variant.common_budget else []
        script = f"train/{self.variant.script}.py"
        return [str(word) for word in (script, *common, *self.variant.options, "--seed", self.seed)]

    @property
    def command(self) -> str:
        """What a reader would type."""
        return shlex.join(["python", *self.words])

    @property
    def _record(self) -> Path:
        return self.folder / "ablation.json"

    def finished(self, arms: int) -> dict[str, Any] | None:
        """What an earlier call found, if it finished.

        Raises:
            ValueError: If the folder holds another run, or one whose base or filter has other gains by now.
        """
        if not self._record.exists():
            return None
        remedy = f"delete {self.folder}, or choose another --runs"
        try:
            found = json.loads(self._record.read_text(encoding="utf-8"))
            before, scored = found["command"], found["arms"]
            read_spec(self.folder / "last")
        except BundleError as error:
            raise ValueError(f"{error}; {remedy}") from None
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{self._record} is damaged ({error!r}): {remedy}") from None
        if (before, scored) != (self.command, arms):
            held, wanted = f"`{before}` on {scored} arms", f"`{self.command}` on {arms}"
            raise ValueError(f"{self.folder} holds {held}, not {wanted}: {remedy}")
        return found

    def finish(self, arms: int) -> dict[str, Any]:
        """Train, going on where an interrupted run stopped, and score the last policy on so many arms.

        Raises:
            ValueError: If the training fails, with its own message, or the folder holds another run.
            KeyboardInterrupt: If it was interrupted; it is saved.
        """
        self._train()
        controller, spec = load_controller(self.folder / "last")
        (curve,) = find_curves([self.folder / "last"])
        points = np.stack([curve.steps / spec.residual.hold, curve.minutes, curve.cost], axis=1)
        found = {
            "seed": self.seed,
            "command": self.command,
            "base": spec.base,
            "commit": spec.provenance["commit"],
            "minutes": round(float(curve.minutes[-1]), 2),
            "arms": arms,
            "scores": score(controller, arms, spec.sensors),
            "curve": [[round(float(value), 4) for value in point] for point in points],
            "validation_arms": curve.arms,
            "validation_of_base": curve.base_cost,
        }
        write_text(self._record, json.dumps(found, indent=2) + "\n")
        return found

    def _train(self) -> None:
        script, *options = self.words
        resume = ["--resume"] if RunFolder(self.folder).checkpoint.exists() else []
        command = [sys.executable, str(ROOT / script), *options, "--out", str(self.folder), *resume]
        one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
        done = subprocess.run(command, env={**os.environ, **one_thread}, capture_output=True, text=True, check=False)
        if done.returncode == _INTERRUPTED:
            raise KeyboardInterrupt("interrupted; what was begun is saved, the same command goes on")
        if done.returncode != 0:
            last = (done.stderr.strip().splitlines() or ["no message"])[-1]
            raise ValueError(f"{self.variant.name}, seed {self.seed}: {last}")


def score(controller: Controller, arms: int, sensors: str = "encoder") -> dict[str, float]:
    """Means and medians over the arms of `SEED`, and the share that left the workspace (%)."""
    run = rollout(controller, arms, seed=SEED, randomization="train", sensors=sensors)
    metrics = run.metrics()
    found = {f"{name}_mean": float(np.mean(metrics[name])) for name in SCORES}
    found |= {f"{name}_median": float(np.median(metrics[name])) for name in SCORES}
    found["left_percent"] = 100.0 * float(np.mean(~run.finished))
    return {name: round(value, 4) for name, value in found.items()}


def described(variant: Variant) -> dict[str, Any]:
    """A variant as data."""
    return {**asdict(variant), "options": list(variant.options)}
