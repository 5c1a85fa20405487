"""Fitting of a learned observer: least negative log-likelihood of the truth, by Adam, acting by its running average."""

from __future__ import annotations

import copy
from collections.abc import Iterator

import numpy as np
import torch

from agents.observer.episodes import Episodes
from agents.observer.network import Observer
from agents.policy.regression import Regression, scales_of

_MAX_GRADIENT = 1.0
_FARTHEST = 20.0  # errors e that count: those of an arm that is about to leave would drown the others'


def negative_log_likelihood(observer: Observer, episodes: Episodes) -> torch.Tensor:
    """Mean of (d - g)^2 / 2 exp(2 s) + s over samples and quantities, with d = (truth - b) / e, cut at `_FARTHEST`."""
    inputs = episodes.inputs.float()
    g, s = observer(inputs)
    d = ((episodes.truth - observer.believed(inputs)) / observer.error).clamp(-_FARTHEST, _FARTHEST)
    return (0.5 * ((d - g) / s.exp()).square() + s).mean()


def standardise(observer: Observer, episodes: Episodes) -> None:
    """Set the scales of an observer's inputs and corrections by what there is in some episodes."""
    inputs = episodes.inputs.float()
    observer.mean, observer.deviation = scales_of(inputs)
    observer.error = (episodes.truth - observer.believed(inputs)).flatten(0, 1).square().mean(dim=0).sqrt()


def fit(
    observer: Observer, episodes: Episodes, epochs: int, learning_rate: float, batch_size: int
) -> Iterator[tuple[float, float]]:
    """Fit an observer in place, by the running average of the weights.

    Args:
        observer: Untrained, with its scales set.
        episodes: What to fit it to.
        epochs: Passes over them.
        learning_rate: At first; it falls to zero.
        batch_size: Episodes per gradient step.

    Yields:
        Share that is done, and the loss, after every gradient step.

    Raises:
        ValueError: If the loss is not finite.
    """
    network = copy.deepcopy(observer)
    regression = Regression(network, _MAX_GRADIENT)
    count = episodes.truth.shape[1]
    batches = [rows for _ in range(epochs) for rows in torch.randperm(count).split(batch_size)]
    for k, rows in enumerate(batches):
        loss = negative_log_likelihood(network, Episodes(*(part[:, rows] for part in episodes)))
        if not np.isfinite(loss.item()):
            raise ValueError("the observer diverged: fit it with a smaller --learning-rate")
        regression.step(loss, learning_rate * (1 - k / len(batches)))
        yield (k + 1) / len(batches), loss.item()
    observer.load_state_dict(regression.averaged().state_dict())
