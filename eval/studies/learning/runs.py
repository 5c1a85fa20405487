"""Variants that the ablations train, their training runs, and the scores of their policies.

A run has the options that its command gives it, so the command in the results is one that makes them again. The last
policy is scored, not the best one: choosing the best of a curve would flatter the variants whose curves are noisy.
"""

import json
import shlex
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agents.learners.ppo import PpoConfig
from agents.learners.registry import ALGORITHMS
from agents.learners.student import StudentConfig
from agents.policy.bundle import load_controller, read_spec
from agents.runs.checkpoint import RunFolder
from agents.runs.command_line import begun_options
from agents.runs.settings import RunConfig
from agents.runs.training import SCORES, train
from baselines.tools.files import write_text
from baselines.tools.options import parse
from beltarm_env import EPISODE_STEPS
from beltarm_env.rollout import Controller, rollout
from beltarm_env.task.seeds import ABLATIONS
from eval.comparison.provenance import inputs_digest
from eval.report.curves import find_curves

_VALIDATIONS = 8  # per run, and rounds of a student
_RECORD = "ablation.json"


class Factor(NamedTuple):
    """Something that is varied."""

    question: str
    default: str  # its setting in the run that its variants are compared with
    against: str = "default"  # name of that run


@dataclass(frozen=True)
class Variant:
    """Training run that changes one option of the default run, or learns in another way."""

    name: str  # its folder's
    factor: str  # key of `FACTORS`
    label: str
    options: tuple[str, ...] = ()
    script: str = "student"
    once: bool = False  # whether one seed is enough: what it shows is larger than what seeds differ by


FACTORS = {
    "learner": Factor("Which way of learning?", "student, on adaptive"),
    "arms": Factor("Which arms should it be trained on?", "shifts"),
    "told": Factor("What must it be told of the arm?", "belief of the filter"),
    "memory": Factor("What is its memory worth?", "GRU of 96"),
    "base": Factor("Which controller should it correct?", "adaptive"),
    "residual": Factor("What should a residual cost?", f"price of {StudentConfig.residual_price:g}"),
}
"""Everything that is varied, by name."""
DEFAULT = Variant("default", "default", "default")
_SHIFTS, _ALL = ("--moves", str(StudentConfig.moves)), ("--residual-limit", "1.0")
_QUIET = (*_SHIFTS, "--initial-log-std", "-3", "--entropy", "0", "--residual-limit", str(StudentConfig.residual_limit))
_RECURRENT = ("--base", "adaptive", "--knowledge", "belief", "--hold", str(StudentConfig.hold), "--arms", "128")
VARIANTS = (
    DEFAULT,
    Variant("ppo-taught", "learner", "PPO after a teacher", ("--teacher-rounds", "6"), "ppo"),
    Variant("ppo-adaptive", "learner", "PPO, on adaptive", ("--teacher-rounds", "0", *_SHIFTS), "ppo", once=True),
    Variant("ppo-quiet", "learner", "PPO, on adaptive, little noise", ("--teacher-rounds", "0", *_QUIET), "ppo"),
    Variant("recurrent", "learner", "recurrent PPO, little noise", (*_RECURRENT, *_QUIET), "recurrent_ppo"),
    Variant("ppo", "learner", "PPO, on paper", ("--base", "paper", *_SHIFTS), "ppo", once=True),
    Variant("sac", "learner", "SAC, on paper", _SHIFTS, "sac", once=True),
    Variant("single", "arms", "single moves", ("--moves", "1")),
    Variant("no-parts", "arms", "shifts without parts", ("--nominal", "payload_mass")),
    Variant("rigid", "arms", "shifts with motors that do not give", ("--nominal", "presliding_deflection")),
    Variant("ideal", "arms", "shifts with an ideal drive", ("--randomization", "ideal"), once=True),
    Variant("nothing", "told", "nothing", ("--knowledge", "none")),
    Variant("torsion", "told", "true torsion, and belief", ("--sensors", "full"), once=True),
    Variant("gru-0", "memory", "none", ("--gru-width", "0")),
    Variant("price-3", "residual", "price of 3", ("--residual-price", "3")),
    Variant("price-10", "residual", "price of 10", ("--residual-price", "10")),
    Variant("base-paper", "base", "paper", ("--base", "paper", *_ALL), once=True),
)


@cache
def training_digest() -> str:
    """Digest of the code that trains and scores, and of the gains that it uses."""
    return inputs_digest(__name__, ("train_run", "score"))


@dataclass(frozen=True)
class Run:
    """Training of a variant with one seed."""

    variant: Variant
    seed: int
    samples: int  # simulated in training
    runs: Path
    quick: bool = False

    @property
    def folder(self) -> Path:
        """Folder of the run."""
        return self.runs / self.variant.name / f"seed{self.seed}"

    @property
    def label(self) -> str:
        """Name of the run, in one word."""
        return f"{self.variant.name}-seed{self.seed}"

    @property
    def words(self) -> list[str]:
        """Script and options, as on a command line."""
        config = parse(ALGORITHMS[self.variant.script], arguments=self.variant.options, begun=begun_options)
        script, arms = f"train/{self.variant.script}.py", 4 if self.quick else 32
        shared = ("--validation-arms", arms, "--seed", self.seed)
        return [str(word) for word in (script, *self._budget(config), *self.variant.options, *shared)]

    def _budget(self, config: RunConfig) -> list[object]:
        """Command-line options that make the script simulate `self.samples` samples."""
        if isinstance(config, StudentConfig):
            rounds = 2 if self.quick else _VALIDATIONS
            return ["--arms", _arms(self.samples, rounds, config.moves), "--rounds", rounds]
        steps = max(self.samples // config.hold, 1)
        if isinstance(config, PpoConfig) and config.teacher_rounds:  # who has most samples, as in shipped runs
            arms, steps = _arms(self.samples * 3 // 4, config.teacher_rounds, config.moves), steps // 4
            words = ["--teacher-arms", arms, "--critic-steps", steps // 3]
            return ["--total-steps", steps, "--validation-every", max(steps // 2, 1), *words]
        return ["--total-steps", steps, "--validation-every", max(steps // _VALIDATIONS, 1)]

    @property
    def command(self) -> str:
        """Command that trains the same."""
        return shlex.join(["python", *self.words])

    @property
    def _code(self) -> Path:
        return self.folder.with_suffix(".code")

    def _is_of_this_code(self) -> bool:
        return self._code.exists() and self._code.read_text(encoding="utf-8") == training_digest()

    def finished(self, arms: int) -> dict[str, Any] | None:
        """Result of an earlier call, if it finished.

        Raises:
            ValueError: If the folder holds another run, or one of other code or gains.
        """
        record = self.folder / _RECORD
        if not record.exists():
            return None
        try:
            kept = json.loads(record.read_text(encoding="utf-8"))
            if (kept["command"], kept["arms"]) == (self.command, arms) and self._is_of_this_code():
                return kept
        except (ValueError, KeyError, TypeError):
            pass
        wrong = f"damaged, of other code or gains, or not of `{self.command}` on {arms} arms"
        raise ValueError(f"{record} is {wrong}; delete {self.folder}, or choose another --runs")

    def finish(self, arms: int) -> dict[str, Any]:
        """Train, going on where an interrupted run stopped, and score the last policy on some arms.

        Raises:
            ValueError: If the training fails, with its own message, or the folder holds another run or other code's.
        """
        if RunFolder(self.folder).checkpoint.exists() and not self._is_of_this_code():
            raise ValueError(f"{self.folder} was begun by other code or gains; delete it, or choose another --runs")
        write_text(self._code, training_digest())
        try:
            train_run(self.words, self.folder)
        except ValueError as error:
            raise ValueError(f"{self.variant.name}, seed {self.seed}: {error}") from error
        spec, _ = read_spec(self.folder / "last")
        (curve,) = find_curves([self.folder / "last"])
        points = np.stack([curve.steps, curve.minutes, curve.cost], axis=1)
        result = {
            "seed": self.seed,
            "command": self.command,
            "base": spec.base,
            "commit": spec.provenance["commit"],
            "minutes": round(float(curve.minutes[-1]), 2),
            "arms": arms,
            "scores": score(load_controller(self.folder / "last"), arms, spec.sensors),
            "curve": [[round(float(value), 4) for value in point] for point in points],
            "validation_arms": curve.arms,
            "moves": curve.moves,
        }
        write_text(self.folder / _RECORD, json.dumps(result, indent=2) + "\n")
        return result


def _arms(samples: int, rounds: int, moves: int) -> int:
    """Arms of a round, so that all rounds together simulate so many samples."""
    return max(samples // (rounds * moves * EPISODE_STEPS), 1)


def train_run(words: list[str], out: Path) -> None:
    """Run a training by the words of its command, from its checkpoint if there is one; errors as of `train`."""
    script, *options = words
    resume = ["--resume"] if RunFolder(out).checkpoint.exists() else []
    arguments = [*options, "--out", str(out), *resume]
    config = parse(ALGORITHMS[Path(script).stem], arguments=arguments, begun=begun_options)
    train(config, command=shlex.join(["python", script, *arguments]))


def score(controller: Controller, arms: int, sensors: str = "encoder") -> dict[str, float]:
    """Means and medians of a controller's metrics on shifts of `ABLATIONS`, and the share of arms that left [%]."""
    task: dict[str, Any] = {"randomization": "train", "moves": StudentConfig.moves, "sensors": sensors}
    run = rollout(controller, arms, seed=ABLATIONS.first, **task)
    metrics = run.metrics()
    shown = (*SCORES, "still_s", "torque_reversals_hz")
    scores = {f"{name}_mean": float(np.mean(metrics[name])) for name in shown}
    scores |= {f"{name}_median": float(np.median(metrics[name])) for name in shown}
    scores["left_percent"] = 100.0 * float(np.mean(~run.stayed))
    return {name: round(value, 4) for name, value in scores.items()}
