"""Classical controllers: each a module, called as Stable-Baselines3 calls a policy, batched over a leading axis.

Names are imported on first use: commands import this package to say in one line that a package is not installed.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from baselines.registry import CONTROLLERS, DOMINATED, TUNABLE, tuned_controller
    from baselines.servo.paper import PaperController, PaperGains, rigid_controller


__all__ = [
    "CONTROLLERS",
    "DOMINATED",
    "TUNABLE",
    "PaperController",
    "PaperGains",
    "rigid_controller",
    "tuned_controller",
]

_OF_PAPER = ("PaperController", "PaperGains", "rigid_controller")
_HOME = dict.fromkeys(__all__, "baselines.registry") | dict.fromkeys(_OF_PAPER, "baselines.servo.paper")


def __getattr__(name: str) -> Any:
    """Import a public name where it is defined."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)
