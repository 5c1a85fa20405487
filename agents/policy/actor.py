"""Actors for training: a policy's network in PyTorch, independent of the libraries that train it, and its fit.

The equations are those of `agents.policy.weights`. The residual is the deterministic one: the mean of the distribution
that training explores with.
"""

from __future__ import annotations

import copy
from itertools import pairwise
from typing import Any

import torch
from torch import nn
from torch.nn.utils import clip_grad_norm_
from torch.optim.swa_utils import AveragedModel

from agents.policy.weights import FARTHEST, ActorShape, Weights

MODULES: dict[str, type[nn.Module]] = {"tanh": nn.Tanh, "relu": nn.ReLU, "elu": nn.ELU}
"""Of `weights.ACTIVATIONS`."""
_LEAST_DEVIATION = 1e-3  # of an input that is used: of one that never varies in training nothing is learnt
_UNUSED = 1e6  # deviation by which an input is standardised that is not used
_MAX_GRADIENT = 5.0  # norm to which a gradient is cut
_WARM_UP = 50  # gradient steps over which the learning rate rises, and the average's memory grows
_DECAY = 0.998  # share of the average that a gradient step leaves


class Standardised(nn.Module):
    """Network whose inputs are standardised by the mean and deviation that they had in training."""

    mean: torch.Tensor
    deviation: torch.Tensor

    def __init__(self, inputs: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(inputs))
        self.register_buffer("deviation", torch.ones(inputs))

    def set_scales(self, inputs: torch.Tensor) -> None:
        """Take mean and deviation of inputs of shape (T, n, inputs); those that do not vary count as 0 from then on."""
        flat = inputs.flatten(0, 1)
        self.mean, deviation = flat.mean(dim=0), flat.std(dim=0)
        self.deviation = torch.where(deviation < _LEAST_DEVIATION, _UNUSED, deviation)

    def standardised(self, inputs: torch.Tensor) -> torch.Tensor:
        """Standardise inputs, cut at `FARTHEST` deviations."""
        return ((inputs - self.mean) / self.deviation).clamp(-FARTHEST, FARTHEST)


class Actor(Standardised):
    """Network from what a residual agent observes to its residual, for training; `NetworkPolicy` acts by it."""

    def __init__(self, shape: ActorShape) -> None:
        super().__init__(shape.inputs)
        self.shape = shape
        self.lstm = nn.LSTM(shape.inputs, shape.lstm) if shape.lstm else None
        self.gru = nn.GRU(shape.inputs, shape.gru) if shape.gru else None
        layers: list[nn.Module] = []
        for before, after in pairwise(shape.widths):
            layers += [nn.Linear(before, after), MODULES[shape.activation]()]
        self.layers = nn.Sequential(*layers[:-1])

    def weights(self) -> Weights:
        """Copy of its weights as they are now."""
        state = self.state_dict()
        return Weights(self.shape, {name: state[name].cpu().numpy().copy() for name in self.shape.arrays()})

    def features(
        self, observations: torch.Tensor, memory: torch.Tensor | None = None
    ) -> tuple[torch.Tensor, torch.Tensor | None]:
        """Inputs of the first layer, for T steps of n episodes, and the memory after them.

        Not of an actor with an LSTM, which is trained elsewhere.

        Args:
            observations: Of these steps, shape (T, n, inputs).
            memory: That of the GRU after the step before; None at the beginning of the episodes.
        """
        assert self.lstm is None, "trained by its own library"
        features = self.standardised(observations) if self.shape.standardised else observations
        if self.gru is not None:
            remembered, memory = self.gru(features, memory)
            features = torch.cat([features, remembered], dim=-1)
        return features, memory

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Outputs u before they are bounded, shape (T, n, 1), for n whole episodes of shape (T, n, inputs)."""
        return self.layers(self.features(observations)[0])


def actor_of(policy: Any, shape: ActorShape) -> Actor:
    """Extract the actor of a Stable-Baselines3 policy of this shape, with a copy of its weights."""
    actor = Actor(shape)
    for own, theirs in pairs_of(actor, policy):
        own.load_state_dict(theirs.state_dict())
    if shape.standardised:
        scales = policy.features_extractor.scales
        actor.mean, actor.deviation = scales.mean.clone(), scales.deviation.clone()
    return actor.requires_grad_(False)


def pairs_of(actor: Actor, policy: Any) -> list[tuple[nn.Module, nn.Module]]:
    """Layers of an actor, each with that of a Stable-Baselines3 policy which does the same."""
    if hasattr(policy, "mlp_extractor"):  # PPO's
        parts = [policy.mlp_extractor.policy_net, policy.action_net]
    else:  # SAC's, whose mean is a layer of its own
        parts = [policy.actor.latent_pi, policy.actor.mu]
    theirs = [module for part in parts for module in part.modules() if isinstance(module, nn.Linear)]
    ours = [module for module in actor.layers if isinstance(module, nn.Linear)]
    pairs: list[tuple[nn.Module, nn.Module]] = list(zip(ours, theirs, strict=True))
    if actor.lstm is not None:
        pairs.append((actor.lstm, policy.lstm_actor))
    return pairs


class Regression:
    """Fit of a network by gradient steps (Adam) of a bounded norm; it acts by the running average of its weights."""

    def __init__(self, network: nn.Module) -> None:
        self.network: Any = network
        self._average = AveragedModel(network, avg_fn=_running_average)
        self._optimiser = torch.optim.Adam(network.parameters())

    def step(self, loss: torch.Tensor, learning_rate: float) -> None:
        """Make a gradient step; the first ones with a part of the learning rate, for a short rise from zero."""
        rate = learning_rate * min((int(self._average.n_averaged) + 1) / _WARM_UP, 1.0)
        for group in self._optimiser.param_groups:
            group["lr"] = rate
        self._optimiser.zero_grad()
        loss.backward()
        clip_grad_norm_(self.network.parameters(), _MAX_GRADIENT)
        self._optimiser.step()
        self._average.update_parameters(self.network)

    def averaged(self) -> Any:
        """Copy of the network with the average of its weights; what is no weight is that of the last step."""
        network: Any = self._average.module
        return copy.deepcopy(network).requires_grad_(False)

    def state(self) -> dict[str, Any]:
        """State that determines the next step."""
        return {name: getattr(self, name).state_dict() for name in _PARTS}

    def restore(self, state: dict[str, Any], device: str) -> None:
        """Restore a state into a new regression of the same network, which goes on on this device."""
        self.network.to(device)  # before Adam's moments, which are put where the weights are
        for name in _PARTS:
            getattr(self, name).load_state_dict(state[name])


_PARTS = ("network", "_average", "_optimiser")


def _running_average(average: torch.Tensor, now: torch.Tensor, updates: torch.Tensor | int) -> torch.Tensor:
    """Weights after one more gradient step, of which the first count as much as the rest of them [1].

    [1] B. T. Polyak, A. B. Juditsky: Acceleration of Stochastic Approximation by Averaging, SIAM J. Control Optim. 30,
    1992.
    """
    decay = min(_DECAY, float(updates) / (float(updates) + _WARM_UP))
    return average.lerp(now, 1 - decay)
