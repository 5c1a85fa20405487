"""The acting part of a policy: what a trained agent needs to act, and nothing of what it was trained with.

    o <- clip((o - mean) / deviation, -5, 5)  if it is standardised
    z = o, LSTM(o) or [o, GRU(o)]
    u = W_n act(... act(W_1 z + b_1) ...) + b_n    residual = tanh(u) or clip(u, -1, 1)

A plain PyTorch network, independent of the libraries that train it, so that a shipped policy holds no critics and no
classes of theirs. The residual is the deterministic one: the mean of the distribution that training explores with.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import nn

from baselines.reading import chosen
from beltarm_env.arrays import Flags, Singles

ACTIVATIONS: dict[str, type[nn.Module]] = {"tanh": nn.Tanh, "relu": nn.ReLU, "elu": nn.ELU}
MAX_WIDTH = 1024
MAX_LAYERS = 8
FARTHEST = 5.0
"""Bound of a standardised input, in deviations."""


@dataclass(frozen=True, slots=True)
class ActorShape:
    """Layers of an actor.

    Raises:
        ValueError: If a layer is not of a size that is allowed.
    """

    inputs: int
    hidden: tuple[int, ...]  # width of the hidden layers
    activation: str = "tanh"
    squashed: bool = False  # tanh at the end instead of a cut
    lstm: int = 0  # width of an LSTM before the first layer, 0 for none
    gru: int = 0  # width of a GRU beside the inputs of the first layer, 0 for none
    standardised: bool = False  # whether inputs are, by the mean and deviation that they had in training

    def __post_init__(self) -> None:
        """Check the sizes before memory is allocated."""
        if len(self.hidden) > MAX_LAYERS:
            raise ValueError(f"an actor has at most {MAX_LAYERS} hidden layers, got {len(self.hidden)}")
        memories = (("the LSTM", 0, (self.lstm,)), ("the GRU", 0, (self.gru,)))
        for name, least, widths in (("hidden layers", 1, self.hidden), *memories):
            for width in widths:
                if isinstance(width, bool) or not isinstance(width, int) or not least <= width <= MAX_WIDTH:
                    raise ValueError(f"{name} must have a whole width from {least} to {MAX_WIDTH}, got {width!r}")
        if self.lstm and self.gru:
            raise ValueError(f"an actor has an LSTM or a GRU, got both, of {self.lstm} and {self.gru}")
        if self.activation not in ACTIVATIONS:
            raise ValueError(f"activation must be one of {', '.join(ACTIVATIONS)}, got {self.activation!r}")


class Actor(nn.Module):
    """Network from what a residual agent observes to its residual, for training; `NetworkPolicy` acts by it."""

    def __init__(self, shape: ActorShape) -> None:
        super().__init__()
        self.shape = shape
        if shape.standardised:
            self.mean: torch.Tensor
            self.deviation: torch.Tensor
            self.register_buffer("mean", torch.zeros(shape.inputs))
            self.register_buffer("deviation", torch.ones(shape.inputs))
        self.lstm = nn.LSTM(shape.inputs, shape.lstm) if shape.lstm else None
        self.gru = nn.GRU(shape.inputs, shape.gru) if shape.gru else None
        widths = (shape.lstm or shape.inputs + shape.gru, *shape.hidden)
        layers: list[nn.Module] = []
        for before, after in pairwise(widths):
            layers += [nn.Linear(before, after), ACTIVATIONS[shape.activation]()]
        self.layers = nn.Sequential(*layers, nn.Linear(widths[-1], 1))

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Outputs u before they are bounded, shape (T, n, 1), for n whole episodes of shape (T, n, inputs).

        Not for an actor with an LSTM, which is trained elsewhere.
        """
        assert self.lstm is None, "trained by its own library"
        features = self._standardised(observations)
        if self.gru is not None:
            features = torch.cat([features, self.gru(features)[0]], dim=-1)
        return self.layers(features)

    def _standardised(self, observations: torch.Tensor) -> torch.Tensor:
        return standardised(observations, self.mean, self.deviation) if self.shape.standardised else observations


def standardised(inputs: torch.Tensor, mean: torch.Tensor, deviation: torch.Tensor) -> torch.Tensor:
    """Inputs by the mean and deviation that they had in training, cut at `FARTHEST`."""
    return ((inputs - mean) / deviation).clamp(-FARTHEST, FARTHEST)


def begun(state: Singles | None, start: Flags | None, shape: tuple[int, ...]) -> Singles:
    """Memory of a shape, rows first, which is zero where an episode begins: everywhere if there is none yet."""
    memory = np.zeros(shape, np.float32)
    if state is not None:
        memory = state if start is None else chosen(start, memory, state)
    return memory


def actor_of(policy: Any, shape: ActorShape) -> Actor:
    """Extract the actor of a Stable-Baselines3 policy, with a copy of its weights.

    Raises:
        ValueError: If the policy does not have the layers that the shape describes.
    """
    actor = Actor(shape)
    if hasattr(policy, "mlp_extractor"):  # PPO's
        parts = [policy.mlp_extractor.policy_net, policy.action_net]
    else:  # SAC's, whose mean is a layer of its own
        parts = [policy.actor.latent_pi, policy.actor.mu]
    theirs = [module for part in parts for module in part.modules() if isinstance(module, nn.Linear)]
    ours = [module for module in actor.layers if isinstance(module, nn.Linear)]
    if len(theirs) != len(ours) or (actor.lstm is None) != (not hasattr(policy, "lstm_actor")):
        raise ValueError(f"the policy does not have the layers of {shape}")
    pairs: list[tuple[nn.Module, nn.Module]] = list(zip(ours, theirs, strict=True))
    if actor.lstm is not None:
        pairs.append((actor.lstm, policy.lstm_actor))
    for own, other in pairs:
        try:
            own.load_state_dict(other.state_dict())
        except RuntimeError:
            raise ValueError(f"the policy does not have the layers of {shape}") from None
    return actor.requires_grad_(False)
