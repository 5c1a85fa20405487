"""Iterative learning: `python eval/iterative.py` repeats the same moves on the same arms.

Each arm makes its move again and again, and three ways of learning from one repetition to the next are compared: the
arm and the torque (`baselines.iterative.controller`), the arm alone, and what a textbook does with the motor's error
(`baselines.iterative.motor_learning`). Beside them are controllers that learn nothing. Writes summary.md, results.json
and a picture.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import one_line_errors, stop_without

try:
    import numpy as np
    import tyro
    from numpy.typing import NDArray

    from baselines import PaperController, tuned_controller
    from baselines.iterative.controller import IterativeController
    from baselines.iterative.lesson import Notes
    from baselines.iterative.motor_learning import MotorLearningController
    from baselines.tools.files import require_writable, write_text
    from baselines.yardsticks.privileged import privileged_controller
    from beltarm_env import CONTROL_PERIOD, BeltArmVectorEnv
    from beltarm_env.arm import FIELDS
    from beltarm_env.rollout import Controller, Recording, rollout
    from beltarm_env.task.reference import TRAPEZOID, sample_references
    from eval.repetition.report import ARM, KINDS, TORQUE, Outcome, as_json, markdown, save_picture, verdict
except ModuleNotFoundError as error:
    stop_without("eval/iterative.py", error)

Floats = NDArray[np.float64]

LEARNERS: dict[str, Callable[..., Any]] = {
    TORQUE: IterativeController,
    ARM: partial(IterativeController, learn_torque=False),
    "motor": MotorLearningController,
}
"""By name: a controller of one trial, made with what was learnt before (nothing at first)."""
SEED = 4_100_000


@dataclass(frozen=True)
class Config:
    """Repeat moves and learn from them."""

    out: Path = Path("results/iterative")
    """Folder for summary.md, results.json and the picture."""
    arms: int = 100
    """Arms of each kind, 4 to 1000."""
    repetitions: int = 10
    """How often each move is made, 2 to 100."""
    seed: int = SEED
    """Of the first arm and its move; arm i has seed + i."""

    def check(self) -> None:
        """Check the numbers.

        Raises:
            ValueError: If one is out of range.
        """
        if not 4 <= self.arms <= 1000:
            raise ValueError(f"--arms must lie within 4 and 1000, got {self.arms}")
        if not 2 <= self.repetitions <= 100:
            raise ValueError(f"--repetitions must lie within 2 and 100, got {self.repetitions}")
        if self.seed < 0:
            raise ValueError(f"--seed must not be negative, got {self.seed}")


def metrics(run: Recording) -> dict[str, Floats]:
    """What is reported of a trial, each of shape (n,)."""
    count, steps = run.moves.shape[0], len(run.state)
    tasks = np.empty((count, steps + 1, 3))
    sample_references(TRAPEZOID, run.moves, CONTROL_PERIOD, tasks)
    joint = run.state[:, :, 0] / run.params[:, FIELDS.index("gear_ratio")]
    of_tip = run.metrics()
    wanted = {name: of_tip[name] for name in ("cost", "tip_rms_mm", "residual_pp_mm")}
    return {**wanted, "motor_rms_mrad": 1e3 * np.sqrt(np.mean((joint - tasks[:, 1:, 0].T) ** 2, axis=0))}


def repeated(make: Callable[..., Any], arms: int, repetitions: int, **scenarios: Any) -> list[dict[str, Floats]]:
    """Metrics of one repetition after the other.

    Args:
        make: One of `LEARNERS`.
        arms: How many, side by side.
        repetitions: Of each arm's move.
        **scenarios: Seed and settings of `rollout`, the same every time.
    """
    lesson, found = None, []
    for _ in range(repetitions):
        controller = make(lesson)
        notes = Notes(controller)
        found.append(metrics(rollout(notes, arms, **scenarios)))
        lesson = controller.learned(notes)
    return found


def _privileged(arms: int, seed: int, randomization: str) -> Controller:
    """The plan of `adaptive`, with its gains, for arms that are known."""
    env = BeltArmVectorEnv(arms, randomization=randomization)  # pyright: ignore[reportArgumentType]
    env.reset(seed=seed)
    return privileged_controller(env.params, gains="adaptive")


def study(arms: int, repetitions: int, seed: int) -> list[Outcome]:
    """Everything on all kinds of arms."""
    outcomes = []
    for kind, of_kind in KINDS.items():
        scenarios = {"seed": seed, "randomization": of_kind.randomization}
        yardsticks = {
            "paper": (PaperController(), {}),
            "adaptive": (tuned_controller("adaptive"), {}),
            "privileged": (_privileged(arms, **scenarios), {"sensors": "full"}),
        }
        for name, make in LEARNERS.items():
            outcomes.append(Outcome(kind, name, repeated(make, arms, repetitions, **scenarios)))
        for name, (controller, settings) in yardsticks.items():
            outcomes.append(Outcome(kind, name, [metrics(rollout(controller, arms, **scenarios, **settings))]))
    return outcomes


def main() -> None:
    """Command line."""
    began = time.perf_counter()
    config = tyro.cli(Config, description=__doc__)
    with one_line_errors("eval/iterative.py"):
        config.check()
        require_writable(config.out)
        outcomes = study(config.arms, config.repetitions, config.seed)
        save_picture(outcomes, config.out / "cost.png")
        write_text(config.out / "results.json", as_json(outcomes, config.seed))
        write_text(config.out / "summary.md", markdown(outcomes, config.seed, time.perf_counter() - began))
        for kind in KINDS:
            print(f"{kind}: {verdict(outcomes, kind)}")
        print(f"written to {config.out}: summary.md, results.json, cost.png")


if __name__ == "__main__":
    main()
