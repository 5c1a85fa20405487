"""The acting part of a policy: what a trained agent needs to act, and nothing of what it was trained with.

    z = LSTM(o) or o    u = W_n act(... act(W_1 z + b_1) ...) + b_n    residual = tanh(u) or clip(u, -1, 1)

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

from beltarm_env.arrays import Flags, Singles

ACTIVATIONS: dict[str, type[nn.Module]] = {"tanh": nn.Tanh, "relu": nn.ReLU, "elu": nn.ELU}
MAX_WIDTH = 1024
MAX_LAYERS = 8


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

    def __post_init__(self) -> None:
        """Check the sizes before memory is allocated."""
        if len(self.hidden) > MAX_LAYERS:
            raise ValueError(f"an actor has at most {MAX_LAYERS} hidden layers, got {len(self.hidden)}")
        for name, least, widths in (("hidden layers", 1, self.hidden), ("the LSTM", 0, (self.lstm,))):
            for width in widths:
                if isinstance(width, bool) or not isinstance(width, int) or not least <= width <= MAX_WIDTH:
                    raise ValueError(f"{name} must have a whole width from {least} to {MAX_WIDTH}, got {width!r}")
        if self.activation not in ACTIVATIONS:
            raise ValueError(f"activation must be one of {', '.join(ACTIVATIONS)}, got {self.activation!r}")


class Actor(nn.Module):
    """Network from a residual agent's observation to its residual; `predict` is that of a Stable-Baselines3 policy."""

    def __init__(self, shape: ActorShape) -> None:
        super().__init__()
        self.shape = shape
        self.lstm = nn.LSTM(shape.inputs, shape.lstm) if shape.lstm else None
        widths = (shape.lstm or shape.inputs, *shape.hidden)
        layers: list[nn.Module] = []
        for before, after in pairwise(widths):
            layers += [nn.Linear(before, after), ACTIVATIONS[shape.activation]()]
        self.layers = nn.Sequential(*layers, nn.Linear(widths[-1], 1))

    def predict(
        self,
        observation: Singles,
        state: Singles | None = None,
        episode_start: Flags | None = None,
        deterministic: bool = True,
    ) -> tuple[Singles, Singles | None]:
        """Return residuals, shape (n, 1), and the LSTM's hidden and cell state, shape (n, 2, width), None without one.

        Raises:
            ValueError: If the observations are not of shape (n, inputs).
        """
        if observation.ndim != 2 or observation.shape[1] != self.shape.inputs:
            raise ValueError(
                f"the policy observes {self.shape.inputs} entries, got shape {observation.shape}: run it with the "
                "--sensors that it was trained with"
            )
        with torch.no_grad():
            features, following = torch.as_tensor(observation), None
            if self.lstm is not None:
                if state is None:
                    state = np.zeros((len(observation), 2, self.shape.lstm), np.float32)
                elif episode_start is not None:
                    state = np.where(episode_start[:, None, None], np.float32(0), state)
                hidden, cell = torch.as_tensor(state).permute(1, 0, 2).contiguous()
                sequence, (hidden, cell) = self.lstm(features[None], (hidden[None], cell[None]))
                features, following = sequence[0], torch.stack([hidden[0], cell[0]], dim=1).numpy()
            output = self.layers(features)
            residual = torch.tanh(output) if self.shape.squashed else output.clamp(-1.0, 1.0)
        return residual.numpy(), following


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
