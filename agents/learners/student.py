"""A student of trajectory optimisation: it is told after each episode how its torques should have been.

The teacher knows arm and drive, and optimises torques in the student's own states (`agents.learners.teaching`). The
student, a residual on a base, meets every arm for the first time, sees the encoder and what an extended Kalman filter
believes (`agents.residual.knowledge`), and has a memory of its own, a GRU through the episode. In every round

    1. arms that no round has seen, and a move for each, are drawn, and the student makes the moves as it is by now;
    2. the teacher gives the best residual y and its weight w for every hold of every arm;
    3. the student u is fitted to the last rounds' advice, through whole episodes: min sum w H(u - y), Huber's H.

This is DAgger [1] with a teacher who is asked about the student's states alone. It is also a policy gradient, as
`agents.learners.teaching` shows: it ends where no small change of the student's torques lowers its expected cost. Why
it works where reinforcement learning does not:

- Nothing is explored. Residuals that are worth anything on a good base are small, and the noise with which PPO looks
  for them costs more than they gain. Here the simulation itself says what each torque did.
- What the teacher knows of an arm, the student cannot know. On average over the arms that fit what it has seen, advice
  that rests on it cancels, and what is left is what one should do not knowing: also to hold back.
- A memory can find what the filter's model leaves out: how the belt is damped, at which speed friction falls.

The untrained student is its base, bit for bit. It acts, in training as after it, by the running average of its weights
[2]; the learning rate falls to zero over the run.

[1] S. Ross, G. J. Gordon, J. A. Bagnell: A Reduction of Imitation Learning and Structured Prediction to No-Regret
Online Learning, AISTATS 2011. [2] B. T. Polyak, A. B. Juditsky: Acceleration of Stochastic Approximation by Averaging,
SIAM J. Control Optim. 30, 1992.
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
from torch.nn.utils import clip_grad_norm_
from torch.optim.swa_utils import AveragedModel

from agents.learners.teaching import Advice, ask
from agents.policy.actor import Actor
from agents.policy.regression import running_average, scales_of, set_learning_rate
from agents.residual.bases import make_base
from agents.residual.controller import ResidualController
from agents.runs.monitor import TrainingMonitor
from agents.runs.settings import RunConfig
from beltarm_env import EPISODE_STEPS
from beltarm_env.arrays import Flags, Singles
from beltarm_env.rollout import Controller, Recording, rollout
from beltarm_env.task.seeds import SEED_SPACING, training_arms

_MAX_GRADIENT = 0.2
_SCALE = 100.0  # of the loss: errors are of a tenth of the torque limit
_PARTS = ("_actor", "_average", "_optimiser")  # of a snapshot


@dataclass(frozen=True)
class StudentConfig(RunConfig):
    """Options of `train/student.py`."""

    algorithm: ClassVar[str] = "student"

    out: Path = Path("runs/student")
    """Folder of the run; of several seeds' runs, the folder of their folders seed0, seed1, ..."""
    base: str = "adaptive"
    """Controller that the residual corrects, any classical one; "none" to learn torques from scratch."""
    learning_rate: float = 3e-3
    """Learning rate of the optimiser at first; it falls to zero over the rounds."""
    hidden: tuple[int, ...] = (96,)
    """Hidden layers after the GRU."""
    gru_width: int = 96
    """Width of the GRU; 0 for a student without a memory."""
    residual_limit: float = 0.5
    """Largest residual, as a share of the torque limit."""
    hold: int = 4
    """Samples for which a residual is held: 6 ms."""
    arms: int = 1024
    """Arms of a round, and so episodes."""
    rounds: int = 24
    """Rounds of acting, asking and fitting; a run that is resumed may have more."""
    remembered: int = 6
    """Rounds whose advice is fitted: the last ones."""
    epochs: int = 1
    """Passes over that advice in each round."""
    torque_price: float = 5.0
    """Price of the torque's changes in the teacher's objective, over that in the task's cost."""
    batch_size: int = 32
    """Episodes per gradient step."""
    huber: float = 0.2
    """Threshold of the Huber loss, as a share of the torque limit."""

    @property
    def samples(self) -> int:
        """Simulated samples per round. The teacher's derivatives simulate each of them twenty times more."""
        return self.arms * EPISODE_STEPS

    @property
    def length(self) -> int:
        """Agent steps of the whole run."""
        return self.rounds * self.samples // self.hold

    @property
    def gru(self) -> int:
        """Width of the actor's GRU."""
        return self.gru_width

    @property
    def standardised(self) -> bool:
        """The actor standardises its inputs, by those of the first round."""
        return True

    def check(self) -> None:
        """Check the options, see `RunConfig.check`."""
        self.at_least(1, "rounds", "remembered", "epochs", "batch_size")
        self.at_least(0, "gru_width")
        self.positive("huber", "torque_price")
        if self.rounds * self.arms > SEED_SPACING:
            found = f"got {self.rounds} times {self.arms}"
            raise ValueError(f"--rounds times --arms must be at most {SEED_SPACING}, {found}: every round has new arms")
        super().check()


class Student:
    """Residual policy that learns from a teacher's advice, as `agents.runs.monitor.Learner`."""

    def __init__(self, config: StudentConfig) -> None:
        torch.manual_seed(config.seed)
        self.config = config
        self.rounds = 0
        self.advice: list[Advice] = []
        self._actor = Actor(config.spec().shape())
        with torch.no_grad():
            for parameter in self._actor.layers[-1].parameters():
                parameter.zero_()
        self._average = AveragedModel(self._actor, avg_fn=running_average)
        self._optimiser = torch.optim.Adam(self._actor.parameters(), config.learning_rate)

    @property
    def steps(self) -> int:
        """Agent steps so far."""
        return self.rounds * self.config.samples // self.config.hold

    def actor(self) -> Actor:
        """Copy of the current policy."""
        averaged: Any = self._average.module
        return copy.deepcopy(averaged).requires_grad_(False)

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
        parts = {name: getattr(self, name).state_dict() for name in _PARTS}
        return {"rounds": self.rounds, "advice": self.advice, **parts}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore a snapshot into a new student of the same options."""
        self.rounds, self.advice = state["rounds"], state["advice"]
        for name in _PARTS:
            getattr(self, name).load_state_dict(state[name])

    def close(self) -> None:
        """Do nothing: no arms are held."""

    def _learn_round(self, monitor: TrainingMonitor) -> None:
        config, pause = self.config, _Pause(monitor)
        seed = training_arms(config.seed).first + self.rounds * config.arms

        def trial(controller: Controller) -> Recording:
            paused = _Paused(controller, pause)
            return rollout(paused, config.arms, seed=seed, randomization=config.randomization, sensors=config.sensors)

        student = ResidualController(make_base(config.base, config.sensors), self.actor(), config.residual)
        advice, own = ask(trial, student, config.torque_price, lambda: pause(0))
        self.advice = [*self.advice, advice][-config.remembered :]
        difference = self._fit(pause)
        self.rounds += 1
        monitor.logger.record("student/cost", float(own.cost.mean()))
        monitor.logger.record("student/left", 1 - float(own.finished.mean()))
        monitor.logger.record("student/difference", difference)

    def _fit(self, pause: Callable[[int], None]) -> float:
        """Fit the student to the remembered advice, and return the weighted squared error of the last pass."""
        config, limit = self.config, self.config.residual_limit
        inputs, labels, weights = (torch.cat(parts, dim=1) for parts in zip(*self.advice, strict=True))
        if self.rounds == 0:  # the average takes over what is no weight with its next step
            self._actor.mean, self._actor.deviation = scales_of(inputs.float())
        network = self._actor.to(config.device)
        episodes, difference = labels.shape[1], 0.0
        batches = -(-episodes // config.batch_size)
        for epoch in range(config.epochs):
            difference = 0.0
            for batch, chosen in enumerate(torch.randperm(episodes).split(config.batch_size)):
                pause(0)
                done = (self.rounds + (epoch + batch / batches) / config.epochs) / config.rounds
                rate = config.learning_rate_left(1 - done)
                set_learning_rate(self._optimiser, rate, int(self._average.n_averaged))
                answers = network(inputs[:, chosen].to(config.device).float())[..., 0]
                error = (answers - labels[:, chosen].to(config.device)) * limit
                weight = weights[:, chosen].to(config.device)
                losses = huber_loss(error, torch.zeros_like(error), reduction="none", delta=config.huber)
                self._optimiser.zero_grad()
                (weight * losses).mean().mul(_SCALE).backward()
                clip_grad_norm_(network.parameters(), _MAX_GRADIENT)
                self._optimiser.step()
                self._average.update_parameters(network)
                difference += float((weight * error.detach().square()).mean()) / batches
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
