"""Classical controllers: each a module, called as Stable-Baselines3 calls a policy, batched over a leading axis."""

from __future__ import annotations

from baselines.paper import PaperController, PaperGains, rigid_controller

CONTROLLERS = {"paper": PaperController, "rigid": rigid_controller}
"""Controllers by the name used on command lines, in results and in policy bundles; call without arguments."""

__all__ = ["CONTROLLERS", "PaperController", "PaperGains", "rigid_controller"]
