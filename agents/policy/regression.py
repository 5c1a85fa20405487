"""What all that is fitted by regression here has in common: scales of inputs, learning rate, average of the weights."""

from __future__ import annotations

import torch

_WARM_UP = 50  # gradient steps over which the learning rate rises, and the average's memory grows
_KEPT = 0.998  # share of the average that a gradient step leaves
_LEAST_DEVIATION = 1e-3  # of an input, so that one that never varies is not blown up


def scales_of(inputs: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Mean and standard deviation of inputs of shape (T, n, inputs), each of shape (inputs,)."""
    flat = inputs.flatten(0, 1)
    return flat.mean(dim=0), flat.std(dim=0).clamp_min(_LEAST_DEVIATION)


def set_learning_rate(optimiser: torch.optim.Optimizer, rate: float, steps: int) -> None:
    """Set a learning rate after a number of gradient steps: of the first ones a part, for a short rise from zero."""
    for group in optimiser.param_groups:
        group["lr"] = rate * min((steps + 1) / _WARM_UP, 1.0)


def running_average(average: torch.Tensor, now: torch.Tensor, updates: torch.Tensor | int) -> torch.Tensor:
    """Weights after one more gradient step, of which the first count as much as the rest of them.

    By it acts what is fitted; for `torch.optim.swa_utils.AveragedModel`.
    """
    kept = min(_KEPT, float(updates) / (float(updates) + _WARM_UP))
    return average.lerp(now, 1 - kept)
