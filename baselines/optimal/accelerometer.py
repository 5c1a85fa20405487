"""The best controllers with an accelerometer on the arm's end in their filters: same laws, same gains, one sensor more.

A track of its own: what is compared with others has the encoder alone.
"""

from __future__ import annotations

from baselines.controller import LawKernel
from baselines.estimation.accelerometer import AccelerometerObserver
from baselines.optimal.adaptive import AdaptiveController
from baselines.optimal.preview import PreviewController


class AccelerometerAdaptiveController(AdaptiveController):
    """Adaptive preview LQG on encoder and accelerometer."""

    sensors = "accelerometer"


class AccelerometerPreviewController(PreviewController):
    """Preview LQG on encoder and accelerometer."""

    sensors = "accelerometer"
    observer = AccelerometerObserver

    def kernel(self) -> LawKernel:
        """Refuse: a `Sample` has no accelerometer."""
        raise TypeError("the law for one arm reads the encoder alone: take the kernel of PreviewController")
