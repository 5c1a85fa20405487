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
(`agents.policy.regression`); the learning rate falls to zero over the run.

[1] S. Ross, G. J. Gordon, J. A. Bagnell: A Reduction of Imitation Learning and Structured Prediction to No-Regret
Online Learning, AISTATS 2011.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch.nn.functional import huber_loss

from agents.learners.teaching import Advice, Trial, ask
from agents.policy.actor import Actor
from agents.policy.network import NetworkPolicy
from agents.policy.regression import Regression, scales_of
from agents.residual.bases import make_base
from agents.residual.controller import Policy, ResidualController
from agents.runs.monitor import TrainingMonitor
from agents.runs.settings import RunConfig
from beltarm_env import EPISODE_STEPS
from beltarm_env.arrays import Flags, Singles
from beltarm_env.rollout import Controller, Recording, rollout
from beltarm_env.task.seeds import SEED_SPACING, training_arms

MAX_GRADIENT = 0.2
"""Norm to which a gradient is cut."""
_SCALE = 100.0  # of the loss: errors are of a tenth of the torque limit


@dataclass(frozen=True)
class StudentConfig(RunConfig):
    """Options of `train/student.py`."""

    algorithm: ClassVar[str] = "student"

    out: Path = Path("runs/student")
    """Folder of the run. With --seeds, each run has its own folder there: seed0, seed1, ..."""
    base: str = "adaptive"
    """Controller that the agent corrects: any classical one, or "none" to learn torques from scratch."""
    learning_rate: float = 3e-3
    """Learning rate at the start. It falls to zero over the rounds."""
    hidden: tuple[int, ...] = (96,)
    """Widths of the hidden layers after the GRU."""
    gru_width: int = 96
    """Width of the GRU. With 0 the student has no memory."""
    residual_limit: float = 0.5
    """Largest residual, as a share of the torque limit."""
    hold: int = 4
    """Samples for which a residual is held. 4 samples are 6 ms."""
    arms: int = 1024
    """Arms of a round. Each makes one episode."""
    rounds: int = 24
    """Rounds of acting, asking the teacher and fitting. A run that is resumed may have more."""
    remembered: int = 6
    """Number of the last rounds whose advice is fitted."""
    epochs: int = 1
    """Passes over that advice in each round."""
    torque_price: float = 5.0
    """Price of a torque change in the teacher's objective, as a multiple of the task's price."""
    batch_size: int = 32
    """Episodes in each gradient step."""
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
    def layers(self) -> dict[str, Any]:
        """The actor's GRU; it standardises its inputs, by those of the first round."""
        return {"gru": self.gru_width, "standardised": True}

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
        self._regression = Regression(as_base(Actor(config.spec().shape())), MAX_GRADIENT)

    @property
    def steps(self) -> int:
        """Agent steps so far."""
        return self.rounds * self.config.samples // self.config.hold

    @property
    def seed(self) -> int:
        """First seed of this round's arms."""
        return training_arms(self.config.seed).first + self.rounds * self.config.arms

    def actor(self) -> Actor:
        """Copy of the current policy."""
        return self._regression.averaged()

    def learn(self, monitor: TrainingMonitor) -> None:
        """Learn to the end of the run, see `agents.runs.monitor.Learner.learn`.

        Checkpoints are taken at the end of a round; an interrupted round is repeated.
        """
        monitor.begin()
        while self.rounds < self.config.rounds:
            self.learn_round(monitor)
            self.rounds += 1
            monitor.evaluate()
            monitor.log()

    def learn_round(self, monitor: TrainingMonitor) -> None:
        """Act, ask and fit."""
        config, pause = self.config, Pause(monitor)
        advice, own = self._asked(pause)
        self.advice = [*self.advice, advice][-config.remembered :]
        difference = self._fit(pause)
        note_round(monitor, own, difference)

    def snapshot(self) -> dict[str, Any]:
        """State that determines the next round."""
        return {"rounds": self.rounds, "advice": self.advice, "regression": self._regression.state()}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore a snapshot into a new student of the same options."""
        self.rounds, self.advice = state["rounds"], state["advice"]
        self._regression.restore(state["regression"])

    def close(self) -> None:
        """Do nothing: no arms are held."""

    def _asked(self, pause: Pause) -> tuple[Advice, Recording]:
        """Advice about this round's moves, and the moves."""
        return self._ask(NetworkPolicy(self.actor().weights()), pause)

    def _ask(self, policy: Policy, pause: Pause) -> tuple[Advice, Recording]:
        """Ask the teacher about this round's moves, made by a policy."""
        return ask(self._trial(pause), self._acting(policy), self.config.torque_price, lambda: pause(0))

    def _acting(self, policy: Policy) -> ResidualController:
        """Controller that acts by a policy."""
        return ResidualController(make_base(self.config.base, self.config.sensors), policy, self.config.residual)

    def _trial(self, pause: Pause) -> Trial:
        """Moves of this round, on arms that no round has seen."""
        config = self.config

        def trial(controller: Controller) -> Recording:
            settings: dict[str, Any] = {"randomization": config.randomization, "sensors": config.sensors}
            return rollout(Paused(controller, pause), config.arms, seed=self.seed, **settings)

        return trial

    def _share_done(self, share: float) -> float:
        """Share of the fitting that is done, of the share of this round that is."""
        return (self.rounds + share) / self.config.rounds

    def _fit(self, pause: Callable[[int], None]) -> float:
        """Fit the student to the remembered advice, and return the weighted squared error of the last pass."""
        config, limit, network = self.config, self.config.residual_limit, self._regression.network
        inputs, labels, weights = (torch.cat(parts, dim=1) for parts in zip(*self.advice, strict=True))
        if self.rounds == 0:  # the average takes over what is no weight with its next step
            network.mean, network.deviation = scales_of(inputs.float())
        network.to(config.device)
        errors: list[float] = []
        for share, chosen in self._batches(labels.shape[1]):
            pause(0)
            answers = network(inputs[:, chosen].to(config.device).float())[..., 0]
            error = (answers - labels[:, chosen].to(config.device)) * limit
            weight = weights[:, chosen].to(config.device)
            losses = huber_loss(error, torch.zeros_like(error), reduction="none", delta=config.huber)
            rate = config.learning_rate_left(1 - self._share_done(share))
            self._regression.step((weight * losses).mean().mul(_SCALE), rate)
            errors.append(float((weight * error.detach().square()).mean()))
        network.to("cpu")
        return self._last_pass(errors)

    def _batches(self, episodes: int) -> Iterator[tuple[float, torch.Tensor]]:
        """Yield the share of this round's fit that is done, and the next batch of its episodes, at random."""
        config = self.config
        batches = -(-episodes // config.batch_size)
        for epoch in range(config.epochs):
            for batch, chosen in enumerate(torch.randperm(episodes).split(config.batch_size)):
                yield (epoch + batch / batches) / config.epochs, chosen

    def _last_pass(self, errors: Sequence[float]) -> float:
        """Mean error over the batches of the last pass.

        Raises:
            ValueError: If it is not finite.
        """
        error = float(np.mean(errors[-(len(errors) // self.config.epochs) :])) if errors else 0.0
        if not np.isfinite(error):
            raise ValueError(f"diverged at {self.steps} steps: start again with a smaller --learning-rate")
        return error


def note_round(monitor: TrainingMonitor, own: Recording, difference: float) -> None:
    """Log a round: its moves' mean cost, the share of arms that left, and the error of the fit."""
    monitor.logger.record("student/cost", float(own.cost.mean()))
    monitor.logger.record("student/left", 1 - float(own.finished.mean()))
    monitor.logger.record("student/difference", difference)


def as_base(actor: Actor) -> Actor:
    """Set an actor's last layer to zero, so that it does what its base does."""
    with torch.no_grad():
        for parameter in actor.layers[-1].parameters():
            parameter.zero_()
    return actor


def make_learner(config: StudentConfig) -> Student:
    """Make an untrained learner."""
    return Student(config)


class Pause:
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


class Paused:
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
