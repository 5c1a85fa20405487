"""Fit of a network by gradient steps, and the running average of its weights, by which it acts."""

from __future__ import annotations

import copy
from typing import Any

import torch
from torch import nn
from torch.nn.utils import clip_grad_norm_
from torch.optim.swa_utils import AveragedModel

_WARM_UP = 50  # gradient steps over which the learning rate rises, and the average's memory grows
_DECAY = 0.998  # share of the average that a gradient step leaves


class Regression:
    """A network that is fitted by gradient steps (Adam), and the running average of its weights, by which it acts.

    Args:
        network: Untrained.
        max_gradient: Norm to which a gradient is cut.
    """

    def __init__(self, network: nn.Module, max_gradient: float) -> None:
        self.network: Any = network
        self._max_gradient = max_gradient
        self._average = AveragedModel(network, avg_fn=_running_average)
        self._optimiser = torch.optim.Adam(network.parameters())

    def step(self, loss: torch.Tensor, learning_rate: float) -> None:
        """Make a gradient step; the first ones with a part of the learning rate, for a short rise from zero."""
        rate = learning_rate * min((int(self._average.n_averaged) + 1) / _WARM_UP, 1.0)
        for group in self._optimiser.param_groups:
            group["lr"] = rate
        self._optimiser.zero_grad()
        loss.backward()
        clip_grad_norm_(self.network.parameters(), self._max_gradient)
        self._optimiser.step()
        self._average.update_parameters(self.network)

    def averaged(self) -> Any:
        """Copy of the network with the average of its weights; what is no weight is that of the last step."""
        network: Any = self._average.module
        return copy.deepcopy(network).requires_grad_(False)

    def state(self) -> dict[str, Any]:
        """State that determines the next step."""
        return {name: getattr(self, name).state_dict() for name in _PARTS}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore a state into a new regression of the same network."""
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
