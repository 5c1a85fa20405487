"""Running average of weights, by which what is fitted here acts; for `torch.optim.swa_utils.AveragedModel`."""

from __future__ import annotations

import torch

KEPT = 0.998
"""Share of the average that a gradient step leaves."""
WARM_UP = 50
"""Gradient steps over which the average's memory grows."""


def running_average(average: torch.Tensor, now: torch.Tensor, updates: torch.Tensor | int) -> torch.Tensor:
    """Weights after one more gradient step, of which the first count as much as the rest of them."""
    kept = min(KEPT, float(updates) / (float(updates) + WARM_UP))
    return average.lerp(now, 1 - kept)
