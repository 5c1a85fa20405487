"""Imitation of trajectory optimisation: after each episode, a teacher labels the torques of a student.

The teacher knows arm and drive, and optimises torques in the student's own states (`agents.learners.teaching`). The
student is a residual on a base. It meets every arm for the first time, observes the encoder and the belief of an
extended Kalman filter (`agents.residual.knowledge`), and has a memory of its own, a GRU through the episode. In every
round

    1. new arms, and a move for each, are drawn, and the student makes the moves;
    2. the teacher gives the best residual y and its weight w for every hold of every arm;
    3. the student u is fitted to the last rounds' advice: min sum w H(u - y), Huber's H. Its memory goes through whole
       episodes, gradients through segments of them (truncated backpropagation through time). What the memory holds has
       to tell, too, by what the filter is wrong (an auxiliary task [2]): the policy does not have this second head.

This is DAgger [1] with a teacher who is asked about the student's states alone, and a policy gradient without
exploration noise: docs/science/learning.md says why it works where reinforcement learning does not.

The untrained student is its base, bit for bit. It acts, in training as after it, by the running average of its weights
(`agents.policy.actor`); the learning rate falls to zero over the run.

[1] S. Ross, G. J. Gordon, J. A. Bagnell: A Reduction of Imitation Learning and Structured Prediction to No-Regret
Online Learning, AISTATS 2011.
[2] M. Jaderberg et al.: Reinforcement Learning with Unsupervised Auxiliary Tasks, ICLR 2017.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch import nn
from torch.nn.functional import huber_loss

from agents.learners.teaching import Advice, Recorder, advise
from agents.observer.quantities import NAMES
from agents.policy.actor import Actor, Regression
from agents.policy.network import NetworkPolicy
from agents.policy.weights import ActorShape
from agents.residual.bases import make_base
from agents.residual.controller import ResidualController
from agents.runs.settings import RunConfig
from agents.runs.training import TrainingMonitor
from baselines.tools.command import require_bounds, require_known
from beltarm_env import EPISODE_STEPS
from beltarm_env.rollout import Recording, rollout
from beltarm_env.task.ranges import RANGES, resolve_ranges
from beltarm_env.task.seeds import SEED_SPACING, training_arms

_SCALE = 100.0  # of the loss: errors are of a tenth of the torque limit
_HUBER = 0.2  # threshold of the loss, as a share of the torque limit
_FAR = 2.0  # errors of a filter that count less, over those of the first round


@dataclass(frozen=True)
class StudentConfig(RunConfig):
    """Options of `train/student.py`."""

    algorithm: ClassVar[str] = "student"

    out: Path = Path("runs/student")
    base: str = "adaptive"
    learning_rate: float = 3e-3
    """Learning rate at the start. It falls to zero over the rounds."""
    hidden: tuple[int, ...] = (96,)
    """Widths of the hidden layers after the GRU."""
    gru_width: int = 96
    """Width of the GRU. With 0 the student has no memory."""
    residual_limit: float = 0.5
    hold: int = 4
    """Samples for which a residual is held. 4 samples are 6 ms."""
    moves: int = 4
    """Moves of an episode, in training and validation. With several it is a working shift: parts are carried, friction
    goes on drifting, and motors give before they slip. In every other round parts are as light as those of a single
    move, and motors do not give: a student has to be good at both."""
    arms: int = 192
    """Arms of a round. Each makes one episode."""
    rounds: int = 12
    """Rounds of acting, asking the teacher and fitting. A run that is resumed may have more."""
    remembered: int = 12
    """Number of the last rounds whose advice is fitted."""
    epochs: int = 1
    """Passes over that advice in each round."""
    residual_price: float = 1.0
    """Price of a squared residual in the teacher's objective. With more the torque reverses less often."""
    validation_arms: int = 32
    batch_size: int = 16
    """Episodes in each gradient step."""
    segment: int = 150
    """Holds in each gradient step, through which gradients go back; the memory goes on from the last segment."""
    nominal: tuple[str, ...] = ()
    """Constants that do not vary in training, such as presliding_deflection or payload_mass, and are nominal."""

    @property
    def samples(self) -> int:
        """Simulated samples per round. The teacher's derivatives simulate each of them twenty times more."""
        return self.arms * self.moves * EPISODE_STEPS

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
        require_bounds(self, rounds=(1, None), remembered=(1, None), epochs=(1, None), batch_size=(1, None))
        require_bounds(self, gru_width=(0, None), segment=(1, None))
        self.positive("residual_price")
        varied = resolve_ranges(self.randomization, self.moves)
        require_known(self.nominal, varied, "--nominal: no constant that varies in training is called {}")
        if self.rounds * self.arms > SEED_SPACING:
            found = f"got {self.rounds} times {self.arms}"
            raise ValueError(f"--rounds times --arms must be at most {SEED_SPACING}, {found}: every round has new arms")
        super().check()

    def make_learner(self) -> Student:
        """Make an untrained student."""
        return Student(self)


class ObservingActor(Actor):
    """Actor that estimates in training, from the same features, what the filter is wrong by."""

    def __init__(self, shape: ActorShape) -> None:
        super().__init__(shape)
        self.estimates = nn.Linear(shape.inputs + shape.gru, len(NAMES))
        self.register_buffer("missed", torch.ones(len(NAMES)))


class Student:
    """Residual policy that learns from a teacher's advice, as `agents.runs.training.Learner`.

    Args:
        config: Options.
        inputs: Number of its network's inputs; None for those that a student with these options observes.
    """

    def __init__(self, config: StudentConfig, inputs: int | None = None) -> None:
        torch.manual_seed(config.seed)
        self.config = config
        self.rounds = 0
        self.advice: list[Advice] = []
        self._monitor: TrainingMonitor | None = None
        self._steps_of_round = 0
        shape = config.spec().shape()
        actor = ObservingActor(shape if inputs is None else replace(shape, inputs=inputs))
        for parameter in actor.layers[-1].parameters():
            nn.init.zeros_(parameter)  # so that it does what its base does
        self._regression = Regression(actor)

    @property
    def steps(self) -> int:
        """Agent steps so far."""
        return self.rounds * self.config.samples // self.config.hold

    def actor(self) -> Actor:
        """Copy of the current policy."""
        return self._regression.averaged()

    def pause(self, steps: int) -> None:
        """Report agent steps just made within a round; raises Interrupted on a request to stop."""
        self._steps_of_round += steps
        if self._monitor is not None:
            self._monitor.stop_if_asked(save=False)
            self._monitor.tell(self._monitor.learner.steps + self._steps_of_round)

    def learn(self, monitor: TrainingMonitor) -> None:
        """Learn to the end of the run, see `agents.runs.training.Learner.learn`.

        Checkpoints are taken at the end of a round; an interrupted round is repeated.
        """
        monitor.begin()
        self._monitor = monitor
        while self.rounds < self.config.rounds:
            self._steps_of_round = 0
            recording, recorder = self.move()
            advice = advise(recording, recorder, self.config.residual, self.config.residual_price)
            self.advice = [*self.advice, advice][-self.config.remembered :]
            error = self.fit()
            monitor.logger.record("student/cost", float(recording.cost.mean()))
            monitor.logger.record("student/left", 1 - float(recording.finished.mean()))
            monitor.logger.record("student/difference", error)
            self.rounds += 1
            monitor.evaluate()
            monitor.log()

    def move(self) -> tuple[Recording, Recorder]:
        """Make this round's moves, on arms that no round has seen."""
        config, recorder = self.config, Recorder(NetworkPolicy(self.actor().weights()), self.pause)
        controller = ResidualController(make_base(config.base, config.sensors), recorder, config.residual)
        ranges = resolve_ranges(RANGES[config.randomization] if self.rounds % 2 else config.randomization, config.moves)
        ranges = {name: pair for name, pair in ranges.items() if name not in config.nominal}
        task: dict[str, Any] = {"randomization": ranges, "moves": config.moves, "sensors": config.sensors}
        first = training_arms(config.seed).first + self.rounds * config.arms
        return rollout(controller, config.arms, seed=first, **task), recorder

    def snapshot(self) -> dict[str, Any]:
        """State that determines the next round."""
        return {"rounds": self.rounds, "advice": self.advice, "regression": self._regression.state()}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore a snapshot into a new student of the same options."""
        self.rounds, self.advice = state["rounds"], state["advice"]
        self._regression.restore(state["regression"], self.config.device)

    def fit(self) -> float:
        """Fit the student to the advice of the last rounds.

        Returns:
            Mean weighted squared error of the last pass; 0 without advice, where all arms have left.

        Raises:
            ValueError: If it is not finite.
        """
        config, network = self.config, self._regression.network
        advice = Advice(*(torch.cat(parts, dim=1) for parts in zip(*self.advice, strict=True)))
        episodes, errors = advice.labels.shape[1], list[float]()
        if not episodes:
            return 0.0
        if not network.mean.any():  # in the first round; the average takes over what is no weight with its next step
            network.set_scales(advice.inputs.float())
            network.missed = advice.missed.flatten(0, 1).square().mean(dim=0).sqrt().clamp(min=1e-9)

        network.to(config.device)
        batches = -(-episodes // config.batch_size)
        for epoch in range(config.epochs):
            errors.clear()
            for batch, chosen in enumerate(torch.randperm(episodes).split(config.batch_size)):
                self.pause(0)
                share_done = (self.rounds + (epoch + batch / batches) / config.epochs) / config.rounds
                rate = config.learning_rate_left(1 - share_done)
                memory = None
                for segment in zip(*(part[:, chosen].split(config.segment) for part in advice), strict=True):
                    seen, best, weight, missed = (part.to(config.device) for part in segment)
                    features, memory = network.features(seen.float(), memory)
                    memory = None if memory is None else memory.detach()
                    error = (network.layers(features)[..., 0] - best) * config.residual_limit
                    losses = huber_loss(error, torch.zeros_like(error), reduction="none", delta=_HUBER)
                    observed = huber_loss(network.estimates(features), missed / network.missed, delta=_FAR)
                    self._regression.step(_SCALE * (weight * losses).mean() + observed, rate)
                    errors.append(float((weight * error.detach().square()).mean()))
        network.to("cpu")
        mean = float(np.mean(errors))
        if not np.isfinite(mean):
            raise ValueError(f"diverged at {self.steps} steps: start again with a smaller --learning-rate")
        return mean
