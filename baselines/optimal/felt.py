"""The best controllers with an accelerometer on the arm's end in their filters: same laws, same gains, one sensor more.

A track of its own: what is compared with others has the encoder alone.
"""

from __future__ import annotations

from baselines.optimal.adaptive import AdaptiveController


class FeltAdaptiveController(AdaptiveController):
    """Adaptive preview LQG on encoder and accelerometer."""

    sensors = "accelerometer"
