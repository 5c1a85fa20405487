"""Rapid motor adaptation (RMA): a policy that knows the constants of its arm, and a memory that estimates them.

Two networks are trained one after the other [1]. Of constants e of arm and drive, each between -1 and 1 over its
training range, and of what an agent observes, x:

    1. z = mu(e), u = pi(x, z): a policy that knows the arm, by the few numbers z that matter to a torque;
    2. z = W GRU(x) + b, fitted to mu(e), on moves that pi makes with this guess of z.

The policy is fitted to a teacher's advice, as a student is (`agents.learners.student`); Kumar et al. use PPO. The
result is an actor of a student's shape: pi's first layer is multiplied by the memory's last. One difference to a
student is left: a student learns what is best on average over all arms that look the same; RMA acts as if its guess
were true.

[1] A. Kumar, Z. Fu, D. Pathak, J. Malik: RMA: Rapid Motor Adaptation for Legged Robots, RSS 2021.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch import nn

from agents.learners.student import MAX_GRADIENT, Student, StudentConfig, as_base
from agents.learners.teaching import Advice
from agents.policy.actor import Actor, Standardised
from agents.policy.network import NetworkPolicy
from agents.policy.regression import Regression
from agents.policy.weights import ActorShape
from baselines.tools.command import require_bounds
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
    """Numbers of the arm that the policy is given."""
    moves: int = 1
    """Moves of an episode: one, since a part changes the constants that are guessed."""
    arms: int = 1024
    """Arms of a round. Each makes one episode."""
    rounds: int = 24
    """Rounds of acting, asking the teacher and fitting. A run that is resumed may have more."""
    validation_arms: int = 128
    """Arms in each validation."""
    batch_size: int = 32
    """Episodes in each gradient step."""
    privileged_share: float = 0.5
    """Share of the rounds that train the policy, which knows its arm. The other rounds train the memory."""

    @property
    def privileged_rounds(self) -> int:
        """Rounds in which the policy that knows the arm is fitted."""
        return max(round(self.privileged_share * self.rounds), 1)

    def check(self) -> None:
        """Check the options, see `RunConfig.check`."""
        require_bounds(self, latent=(1, None), gru_width=(1, None), moves=(1, 1))
        self.positive("privileged_share")
        if self.privileged_rounds >= self.rounds:
            found = f"with --rounds {self.rounds} and --privileged-share {self.privileged_share}"
            raise ValueError(f"--rounds must leave one for the memory, {found} there is none")
        super().check()

    def make_learner(self) -> Rma:
        """Make an untrained learner."""
        return Rma(self)


def scaled_constants(table: Floats) -> Singles:
    """Constants e of arms, shape (n, constants): over the training ranges between -1 and 1, angles as sine and cosine.

    Args:
        table: Of arms, columns as `ArmParams`.
    """
    spans = {name: TRAIN_RANGES[name] for name in _CONSTANTS}
    columns = [(2 * table[:, getattr(COLUMN, name)] - low - high) / (high - low) for name, (low, high) in spans.items()]
    angles = [table[:, getattr(COLUMN, name)] for name in _PHASES]
    columns += [of(angle) for angle in angles for of in (np.sin, np.cos)]
    return np.stack(columns, axis=1).astype(np.float32)


class PrivilegedActor(Standardised):
    """Network pi(x, mu(e)), whose inputs are x and e side by side."""

    def __init__(self, shape: ActorShape, constants: int, latent: int) -> None:
        super().__init__(shape.inputs + constants)
        self.observed = shape.inputs
        self.encoder = nn.Sequential(nn.Linear(constants, _ENCODER), nn.Tanh(), nn.Linear(_ENCODER, latent), nn.Tanh())
        self.policy = as_base(Actor(replace(shape, inputs=shape.inputs + latent, gru=0, standardised=False)))

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Outputs u before they are bounded, shape (T, n, 1), for inputs of shape (T, n, observed + constants)."""
        observed, constants = inputs[..., : self.observed], inputs[..., self.observed :]
        features = self.standardised(observed, slice(self.observed))
        return self.policy(torch.cat([features, self.latent(constants)], dim=-1))

    def latent(self, constants: torch.Tensor) -> torch.Tensor:
        """Numbers z = mu(e), shape (..., latent), of constants of shape (..., constants)."""
        return self.encoder(self.standardised(constants, slice(self.observed, None)))


class Memory(Standardised):
    """Memory that guesses z = W GRU(x) + b; of an untrained one z is zero."""

    def __init__(self, shape: ActorShape, latent: int) -> None:
        super().__init__(shape.inputs)
        self.gru = nn.GRU(shape.inputs, shape.gru)
        self.readout = nn.Linear(shape.gru, latent)
        for parameter in self.readout.parameters():
            nn.init.zeros_(parameter)

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Guess z in every hold, shape (T, n, latent), for n whole episodes of shape (T, n, inputs)."""
        return self.readout(self.gru(self.standardised(inputs))[0])


class PrivilegedPolicy:
    """Policy for one batch of arms that knows their constants, shape (n, constants)."""

    def __init__(self, network: PrivilegedActor, constants: Singles) -> None:
        self._network = network
        self._constants = constants

    def predict(
        self, observation: Singles, state: Any = None, episode_start: Flags | None = None, deterministic: bool = True
    ) -> tuple[Singles, None]:
        """Residuals of shape (n, 1)."""
        inputs = torch.from_numpy(np.concatenate([observation, self._constants], axis=1))
        return self._network(inputs).clamp(-1.0, 1.0).numpy(), None


def merged(network: PrivilegedActor, memory: Memory, shape: ActorShape) -> Actor:
    """Actor of a student's shape that does what the policy does with the memory's guess.

    With z = W h + b, the policy's first layer V_x x + V_z z + c is V_x x + V_z W h + (c + V_z b).
    """
    actor = Actor(shape)
    actor.mean, actor.deviation = network.mean[: shape.inputs], network.deviation[: shape.inputs]
    assert actor.gru is not None
    actor.gru.load_state_dict(memory.gru.state_dict())
    layers = network.policy.layers.state_dict()
    of_latent = layers["0.weight"][:, shape.inputs :]
    layers["0.bias"] = layers["0.bias"] + of_latent @ memory.readout.bias
    layers["0.weight"] = torch.cat([layers["0.weight"][:, : shape.inputs], of_latent @ memory.readout.weight], dim=1)
    actor.layers.load_state_dict(layers)
    return actor.requires_grad_(False)


class Rma(Student):
    """Residual policy by rapid motor adaptation, as `agents.runs.training.Learner`."""

    def __init__(self, config: RmaConfig) -> None:
        super().__init__(config)
        self._config, self._shape = config, config.spec().shape()
        privileged = PrivilegedActor(self._shape, len(scaled_constants(params_table([NOMINAL]))[0]), config.latent)
        self._regression = Regression(privileged, MAX_GRADIENT)
        self._memory = Regression(Memory(self._shape, config.latent), MAX_GRADIENT)
        self._moves: list[tuple[torch.Tensor, torch.Tensor]] = []  # inputs and z of the last rounds

    def actor(self) -> Actor:
        """Copy of the current policy, with the memory."""
        return merged(self._regression.averaged(), self._memory.averaged(), self._shape)

    def learn_round(self) -> tuple[Recording, float]:
        """Fit the privileged policy, or the memory. Return the moves, and the error of the fit."""
        return super().learn_round() if self.rounds < self._config.privileged_rounds else self._fit_memory()

    def ask(self) -> tuple[Advice, Recording]:
        """Ask about the moves of the privileged policy; e is among the inputs."""
        arms = BeltArmVectorEnv(self.config.arms, randomization=self.config.randomization)
        arms.reset(seed=self.seed)
        constants = scaled_constants(arms.params_table)
        advice, recording = self.ask_about(PrivilegedPolicy(self._regression.averaged(), constants))
        own = torch.from_numpy(constants[recording.finished]).half().expand(len(advice.inputs), -1, -1)
        return advice._replace(inputs=torch.cat([advice.inputs, own], dim=2)), recording

    def snapshot(self) -> dict[str, Any]:
        """State that determines the next round."""
        return {**super().snapshot(), "memory": self._memory.state(), "moves": self._moves}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore a snapshot into a new learner of the same options."""
        super().restore(state)
        self._memory.restore(state["memory"])
        self._moves = state["moves"]

    def _share_done(self, share: float) -> float:
        return (self.rounds + share) / self._config.privileged_rounds

    def _fit_memory(self) -> tuple[Recording, float]:
        """Fit the memory to the last rounds' z of arms, on moves that are made with its guess."""
        self.advice = []
        recording, recorder = self.move(NetworkPolicy(self.actor().weights()))
        privileged, config, network = self._regression.averaged(), self._config, self._memory.network
        z = privileged.latent(torch.from_numpy(scaled_constants(recording.params)))
        inputs = torch.from_numpy(np.stack(recorder.inputs)).half()
        self._moves = [*self._moves, (inputs, z)][-config.remembered :]
        inputs, z = (torch.cat(parts, dim=-2) for parts in zip(*self._moves, strict=True))
        observed = slice(privileged.observed)
        network.mean, network.deviation = privileged.mean[observed], privileged.deviation[observed]

        def loss_of(chosen: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
            guess = network(inputs[:, chosen].to(config.device).float())
            loss = (guess - z[chosen].to(config.device)).square().mean()
            return loss, loss.detach()

        def share_done(share: float) -> float:
            return (self.rounds - config.privileged_rounds + share) / (config.rounds - config.privileged_rounds)

        return recording, self._descend(self._memory, len(z), loss_of, share_done)
