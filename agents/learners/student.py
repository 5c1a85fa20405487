"""Imitation learning by DAgger: a student learns a practised teacher's torques in the states that it visits itself.

The teacher is `baselines.iterative.controller`: norm-optimal iterative learning [2] on the very move and arm, again and
again. What practice leaves behind is a law about the practised path, not a list of torques, so the teacher can be asked
anywhere near it:

    tau_T[k] = tau[k] - K[k] (z[k] - path[k])        where the practised motor yields to torque        (m[k] = 1)
    tau_T[k] = that of the base                      where it sticks                                   (m[k] = 0)

No controller can practise an arm that it meets for the first time. The student, a residual on a base, is to do as well
as can be without. In every round of DAgger [1]

    1. arms that no round has seen, and a move for each, are drawn, and the teacher practises them;
    2. the student, as it is by now, makes those moves. Whenever its residual is due it observes o, and of the samples
       that the residual is held for, the teacher's torque a_T and the base's a_B, both over the torque limit, give

           y = mean of m (a_T - a_B) / limit, cut to -1 ... 1

    3. the student u(o) is fitted to all rounds' pairs: min sum H(u(o) - y), with Huber's H.

Why it works:

- Nothing is explored. The residuals that are worth anything on a good base are small, and the noise with which
  reinforcement learning looks for them costs more than they gain.
- The states are the student's own. A student that is shown the teacher's motions alone never learns to come back from
  its own mistakes, and what they cost grows with the square of an episode's length; with its own states, linearly [1].
- What the teacher knows of an arm before the move begins, the student cannot know. Fitted to many arms, it learns what
  is best on average over those that fit what it is told, and so the part of the practice that is the same on all
  arms: exact kinematics, the motor's stops and the norms of the cost, which the plans of the base leave out. The more
  arms, the less of any single one is learnt by heart: so every round has new ones.
- While a motor sticks, torque changes nothing, and the teacher's choice among all that change nothing is arbitrary.
  With labels for it a network learns that noise instead; m leaves it out, and the base stands by.

The untrained student is its base, bit for bit. Every fit begins from the weights of the last, with a new optimiser
whose learning rate falls to zero: each round ends with a student that is done.

[1] S. Ross, G. J. Gordon, J. A. Bagnell: A Reduction of Imitation Learning and Structured Prediction to No-Regret
Online Learning, AISTATS 2011. [2] See `baselines.planning.norm_optimal`.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch.nn.functional import huber_loss

from agents.learners.teaching import Pairs, ask, practise
from agents.policy.actor import Actor
from agents.residual.bases import make_base
from agents.residual.controller import ResidualController
from agents.runs.monitor import TrainingMonitor
from agents.runs.settings import RunConfig
from beltarm_env import EPISODE_STEPS
from beltarm_env.arrays import Flags, Singles
from beltarm_env.rollout import Controller, Recording, rollout
from beltarm_env.task.seeds import SEED_SPACING, training_arms


@dataclass(frozen=True)
class StudentConfig(RunConfig):
    """Options of `train/student.py`."""

    algorithm: ClassVar[str] = "student"

    out: Path = Path("runs/student")
    """Folder of the run; of several seeds' runs, the folder of their folders seed0, seed1, ..."""
    base: str = "adaptive"
    """Controller that the residual corrects, any classical one; "none" to learn torques from scratch."""
    learning_rate: float = 1e-3
    """Learning rate of the optimiser, from which it falls to zero in each fit."""
    residual_limit: float = 0.3
    """Largest residual, as a share of the torque limit."""
    hold: int = 4
    """Samples for which a residual is held: 6 ms."""
    rounds: int = 6
    """Rounds of practice, of asking the teacher, and of fitting; a run that is resumed may have more."""
    repetitions: int = 3
    """Repetitions of each move that the teacher practises."""
    epochs: int = 12
    """Passes over the pairs of all rounds in each fit."""
    batch_size: int = 2048
    """Pairs per gradient step."""
    huber: float = 0.02
    """Threshold of the Huber loss, as a share of the residual's limit."""

    @property
    def samples(self) -> int:
        """Simulated samples per round: the repetitions, and the student's own trial."""
        return self.arms * (self.repetitions + 1) * EPISODE_STEPS

    @property
    def length(self) -> int:
        """Agent steps of the whole run, the teacher's practice included."""
        return self.rounds * self.samples // self.hold

    def check(self) -> None:
        """Check the options, see `RunConfig.check`."""
        self.at_least(1, "rounds", "repetitions", "epochs", "batch_size")
        self.positive("huber")
        if self.rounds * self.arms > SEED_SPACING:
            found = f"got {self.rounds} times {self.arms}"
            raise ValueError(f"--rounds times --arms must be at most {SEED_SPACING}, {found}: every round has new arms")
        super().check()


class Student:
    """Residual policy that learns by imitation, as `agents.runs.monitor.Learner`."""

    def __init__(self, config: StudentConfig) -> None:
        torch.manual_seed(config.seed)
        self.config = config
        self.rounds = 0
        self.pairs: list[Pairs] = []
        self._actor = Actor(config.spec().shape())
        with torch.no_grad():
            for parameter in self._actor.layers[-1].parameters():
                parameter.zero_()

    @property
    def steps(self) -> int:
        """Agent steps so far, practice included."""
        return self.rounds * self.config.samples // self.config.hold

    def actor(self) -> Actor:
        """Copy of the current policy."""
        return copy.deepcopy(self._actor).requires_grad_(False)

    def learn(self, monitor: TrainingMonitor) -> None:
        """Learn to the end of the run, see `agents.runs.monitor.Learner.learn`.

        Checkpoints are taken at the end of a round; an interrupted round is repeated.
        """
        monitor.begin()
        while self.rounds < self.config.rounds:
            self._learn_round(monitor)
            monitor.evaluate()
            monitor.logger.record("time/total_timesteps", self.steps)
            monitor.logger.dump(self.steps)

    def snapshot(self) -> dict[str, Any]:
        """State that determines the next round."""
        return {"rounds": self.rounds, "actor": self._actor.state_dict(), "pairs": self.pairs}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore a snapshot into a new student of the same options."""
        self.rounds, self.pairs = state["rounds"], state["pairs"]
        self._actor.load_state_dict(state["actor"])

    def close(self) -> None:
        """Do nothing: no arms are held."""

    def _learn_round(self, monitor: TrainingMonitor) -> None:
        config, pause = self.config, _Pause(monitor)
        seed = training_arms(config.seed).first + self.rounds * config.arms

        def trial(controller: Controller) -> Recording:
            paused = _Paused(controller, pause)
            return rollout(paused, config.arms, seed=seed, randomization="train", sensors=config.sensors)

        lesson, practised = practise(trial, config.repetitions)
        student = ResidualController(make_base(config.base), self.actor(), config.residual)
        pairs, own = ask(trial, student, lesson)
        self.pairs.append(pairs)
        difference = self._fit(pause)
        self.rounds += 1
        monitor.logger.record("imitation/teacher_cost", float(practised.cost.mean()))
        monitor.logger.record("imitation/student_cost", float(own.cost.mean()))
        monitor.logger.record("imitation/label", float(pairs.labels.abs().mean()))
        monitor.logger.record("imitation/difference", difference)

    def _fit(self, pause: Callable[[int], None]) -> float:
        """Fit the student to all pairs, and return the mean absolute error of the last pass."""
        config, network = self.config, self._actor.layers.to(self.config.device)
        inputs, labels = (torch.cat(parts).to(config.device) for parts in zip(*self.pairs, strict=True))
        optimiser = torch.optim.Adam(network.parameters(), config.learning_rate)
        batches = -(-len(inputs) // config.batch_size)
        schedule = torch.optim.lr_scheduler.LinearLR(optimiser, 1.0, 0.0, config.epochs * batches)
        difference = 0.0
        for _ in range(config.epochs):
            pause(0)
            difference = 0.0
            for chosen in torch.randperm(len(inputs)).to(config.device).split(config.batch_size):
                error = network(inputs[chosen]) - labels[chosen]
                loss = huber_loss(error, torch.zeros_like(error), delta=config.huber) / config.huber
                optimiser.zero_grad()
                loss.backward()
                optimiser.step()
                schedule.step()
                difference += float(error.detach().abs().sum()) / len(inputs)
        self._actor.to("cpu")
        if not np.isfinite(difference):
            raise ValueError(f"diverged at {self.steps} steps: begin anew with a smaller --learning-rate")
        return difference


def make_learner(config: StudentConfig) -> Student:
    """Make an untrained learner."""
    return Student(config)


class _Pause:
    """Reports progress within a round, and interrupts it on request."""

    def __init__(self, monitor: TrainingMonitor) -> None:
        self._monitor = monitor
        self._samples = 0

    def __call__(self, samples: int) -> None:
        """Count samples.

        Raises:
            Interrupted: If the run is to stop.
        """
        self._samples += samples
        self._monitor.stop_if_asked(save=False)
        self._monitor.tell(self._monitor.learner.steps + self._samples // self._monitor.config.hold)


class _Paused:
    """Controller with a pause before each sample."""

    def __init__(self, controller: Controller, pause: Callable[[int], None]) -> None:
        self._controller = controller
        self._pause = pause

    def predict(
        self, observation: Singles, state: Any = None, episode_start: Flags | None = None, deterministic: bool = True
    ) -> tuple[Singles, Any]:
        """Pause, then call the controller's `predict`."""
        self._pause(len(observation))
        return self._controller.predict(observation, state, episode_start, deterministic)
