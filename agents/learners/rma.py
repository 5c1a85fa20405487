"""Rapid motor adaptation (RMA): a policy that is told the arm's constants, and a memory that guesses what they say.

Two networks are trained one after the other [1]. Of constants e of arm and drive, each between -1 and 1 over its
training range, and of what an agent observes, x:

    1. z = mu(e), u = pi(x, z): a policy that knows the arm, and the few numbers z of it that matter to a torque;
    2. z = W GRU(x) + b, fitted to mu(e), on moves that pi makes with this guess of z.

The policy is fitted to the same advice as a student is (`agents.learners.student`), where Kumar et al. use PPO. What
comes out is an actor of a student's shape, pi's first layer over the memory's last, and the difference to a student is
one: that is fitted to what is best on average over all arms that look the same, this acts as if its guess were true.

[1] A. Kumar, Z. Fu, D. Pathak, J. Malik: RMA: Rapid Motor Adaptation for Legged Robots, RSS 2021.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch import nn

from agents.learners.student import MAX_GRADIENT, Pause, Student, StudentConfig, as_base, note_round
from agents.learners.teaching import Advice, Noted
from agents.policy.actor import Actor, standardised
from agents.policy.network import NetworkPolicy
from agents.policy.regression import Regression
from agents.policy.weights import ActorShape
from agents.runs.monitor import TrainingMonitor
from beltarm_env import BeltArmVectorEnv
from beltarm_env.arm import COLUMN, NOMINAL, params_table
from beltarm_env.arrays import Flags, Floats, Singles
from beltarm_env.rollout import Recording
from beltarm_env.task.ranges import TRAIN_RANGES

_ENCODER = 64  # width of mu's hidden layer
_CONSTANTS = tuple(name for name in TRAIN_RANGES if not name.endswith("_phase"))
_PHASES = tuple(name for name in TRAIN_RANGES if name.endswith("_phase"))


@dataclass(frozen=True)
class RmaConfig(StudentConfig):
    """Options of `train/rma.py`."""

    algorithm: ClassVar[str] = "rma"

    out: Path = Path("runs/rma")
    """Folder of the run. With --seeds, each run has its own folder there: seed0, seed1, ..."""
    latent: int = 8
    """Numbers that tell the policy about its arm."""
    told: float = 0.5
    """Share of the rounds that train the policy, which is told about its arm. The other rounds train the memory."""

    @property
    def told_rounds(self) -> int:
        """Rounds in which the policy is fitted, told the arm."""
        return max(round(self.told * self.rounds), 1)

    def check(self) -> None:
        """Check the options, see `RunConfig.check`."""
        self.at_least(1, "latent", "gru_width")
        if not 0 < self.told < 1:
            raise ValueError(f"--told must lie between 0 and 1, got {self.told}")
        if self.told_rounds >= self.rounds:
            found = f"with --rounds {self.rounds} and --told {self.told}"
            raise ValueError(f"--rounds must leave one for the memory, {found} there is none")
        super().check()


def told_constants(table: Floats) -> Singles:
    """Constants e of arms, shape (n, constants): over the training ranges between -1 and 1, angles as sine and cosine.

    Args:
        table: Of arms, columns as `ArmParams`.
    """
    spans = {name: TRAIN_RANGES[name] for name in _CONSTANTS}
    columns = [(2 * table[:, getattr(COLUMN, name)] - low - high) / (high - low) for name, (low, high) in spans.items()]
    angles = [table[:, getattr(COLUMN, name)] for name in _PHASES]
    columns += [of(angle) for angle in angles for of in (np.sin, np.cos)]
    return np.stack(columns, axis=1).astype(np.float32)


class InformedActor(nn.Module):
    """Network pi(x, mu(e)), whose inputs are x and e side by side."""

    mean: torch.Tensor
    deviation: torch.Tensor

    def __init__(self, shape: ActorShape, constants: int, latent: int) -> None:
        super().__init__()
        self.observed = shape.inputs
        self.register_buffer("mean", torch.zeros(shape.inputs + constants))
        self.register_buffer("deviation", torch.ones(shape.inputs + constants))
        self.encoder = nn.Sequential(nn.Linear(constants, _ENCODER), nn.Tanh(), nn.Linear(_ENCODER, latent), nn.Tanh())
        self.policy = as_base(Actor(replace(shape, inputs=shape.inputs + latent, gru=0, standardised=False)))

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Outputs u before they are bounded, shape (T, n, 1), for inputs of shape (T, n, observed + constants)."""
        own = slice(self.observed)
        observed = standardised(inputs[..., own], self.mean[own], self.deviation[own])
        return self.policy(torch.cat([observed, self.latent(inputs[..., self.observed :])], dim=-1))

    def latent(self, constants: torch.Tensor) -> torch.Tensor:
        """Numbers z = mu(e), shape (..., latent), of constants of shape (..., constants)."""
        mean, deviation = self.mean[self.observed :], self.deviation[self.observed :]
        return self.encoder(standardised(constants, mean, deviation))


class Memory(nn.Module):
    """Memory that guesses z = W GRU(x) + b; of an untrained one z is zero."""

    mean: torch.Tensor
    deviation: torch.Tensor

    def __init__(self, shape: ActorShape, latent: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(shape.inputs))
        self.register_buffer("deviation", torch.ones(shape.inputs))
        self.gru = nn.GRU(shape.inputs, shape.gru)
        self.readout = nn.Linear(shape.gru, latent)
        for parameter in self.readout.parameters():
            nn.init.zeros_(parameter)

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Guess z in every hold, shape (T, n, latent), for n whole episodes of shape (T, n, inputs)."""
        return self.readout(self.gru(standardised(inputs, self.mean, self.deviation))[0])


class Told:
    """Policy of one batch of arms that is told their constants, shape (n, constants)."""

    def __init__(self, network: InformedActor, constants: Singles) -> None:
        self._network = network
        self._constants = constants

    def predict(
        self, observation: Singles, state: Any = None, episode_start: Flags | None = None, deterministic: bool = True
    ) -> tuple[Singles, None]:
        """Residuals of shape (n, 1)."""
        inputs = torch.from_numpy(np.concatenate([observation, self._constants], axis=1))
        return self._network(inputs).clamp(-1.0, 1.0).numpy(), None


def merged(network: InformedActor, memory: Memory, shape: ActorShape) -> Actor:
    """Actor of a student's shape that does what the policy does with the memory's guess.

    With z = W h + b, the policy's first layer V_x x + V_z z + c is V_x x + V_z W h + (c + V_z b).
    """
    actor = Actor(shape)
    actor.mean, actor.deviation = network.mean[: shape.inputs], network.deviation[: shape.inputs]
    assert actor.gru is not None
    actor.gru.load_state_dict(memory.gru.state_dict())
    layers = network.policy.layers.state_dict()
    told = layers["0.weight"][:, shape.inputs :]
    layers["0.bias"] = layers["0.bias"] + told @ memory.readout.bias
    layers["0.weight"] = torch.cat([layers["0.weight"][:, : shape.inputs], told @ memory.readout.weight], dim=1)
    actor.layers.load_state_dict(layers)
    return actor.requires_grad_(False)


class Rma(Student):
    """Residual policy by rapid motor adaptation, as `agents.runs.monitor.Learner`."""

    def __init__(self, config: RmaConfig) -> None:
        super().__init__(config)
        self._told, self._shape = config, config.spec().shape()
        informed = InformedActor(self._shape, len(told_constants(params_table([NOMINAL]))[0]), config.latent)
        self._regression = Regression(informed, MAX_GRADIENT)
        self._memory = Regression(Memory(self._shape, config.latent), MAX_GRADIENT)
        self._moves: list[tuple[torch.Tensor, torch.Tensor]] = []  # inputs and z of the last rounds

    def actor(self) -> Actor:
        """Copy of the current policy, with the memory."""
        return merged(self._regression.averaged(), self._memory.averaged(), self._shape)

    def learn_round(self, monitor: TrainingMonitor) -> None:
        """Fit the policy that is told the arm, or the memory."""
        if self.rounds < self._told.told_rounds:
            super().learn_round(monitor)
        else:
            self._remember(monitor)

    def snapshot(self) -> dict[str, Any]:
        """State that determines the next round."""
        return {**super().snapshot(), "memory": self._memory.state(), "moves": self._moves}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore a snapshot into a new learner of the same options."""
        super().restore(state)
        self._memory.restore(state["memory"])
        self._moves = state["moves"]

    def _share_done(self, share: float) -> float:
        return (self.rounds + share) / self._told.told_rounds

    def _asked(self, pause: Pause) -> tuple[Advice, Recording]:
        """Ask about the moves of the policy that is told the arm; e is among the inputs."""
        arms = BeltArmVectorEnv(self.config.arms, randomization=self.config.randomization)
        arms.reset(seed=self.seed)
        constants = told_constants(arms.params_table)
        advice, own = self._ask(Told(self._regression.averaged(), constants), pause)
        told = torch.from_numpy(constants[own.finished]).half().expand(len(advice.inputs), -1, -1)
        return advice._replace(inputs=torch.cat([advice.inputs, told], dim=2)), own

    def _remember(self, monitor: TrainingMonitor) -> None:
        """Fit the memory to the z of arms, on moves that are made with its guess."""
        pause, noted = Pause(monitor), Noted(self._acting(NetworkPolicy(self.actor().weights())))
        self.advice = []
        own = self._trial(pause)(noted)
        informed = self._regression.averaged()
        z = informed.latent(torch.from_numpy(told_constants(own.params)))
        self._moves = [*self._moves, (torch.from_numpy(np.stack(noted.inputs)).half(), z)][-self.config.remembered :]
        error = self._fit_memory(informed, pause)
        note_round(monitor, own, error)

    def _fit_memory(self, informed: InformedActor, pause: Callable[[int], None]) -> float:
        """Fit the memory to the last rounds' z, and return the squared error of the last pass."""
        config, network = self._told, self._memory.network
        inputs, z = (torch.cat(parts, dim=-2) for parts in zip(*self._moves, strict=True))
        network.mean, network.deviation = informed.mean[: informed.observed], informed.deviation[: informed.observed]
        network.to(config.device)
        errors: list[float] = []
        for share, chosen in self._batches(len(z)):
            pause(0)
            guess = network(inputs[:, chosen].to(config.device).float())
            loss = (guess - z[chosen].to(config.device)).square().mean()
            left = 1 - (self.rounds - config.told_rounds + share) / (config.rounds - config.told_rounds)
            self._memory.step(loss, config.learning_rate_left(left))
            errors.append(loss.item())
        network.to("cpu")
        return self._last_pass(errors)


def make_learner(config: RmaConfig) -> Rma:
    """Make an untrained learner."""
    return Rma(config)
