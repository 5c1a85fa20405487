"""The classical controllers by name, made with their tuned gains."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from baselines.gains import Tunable, tuned
from baselines.optimal.adaptive import AccelerometerAdaptiveController, AdaptiveController, AdaptiveGains
from baselines.optimal.lqg import LqgController, LqgGains
from baselines.optimal.mpc import MpcController, MpcGains
from baselines.optimal.preview import AccelerometerPreviewController, PreviewController, PreviewGains
from baselines.optimal.robust import RobustController, RobustGains
from baselines.servo.adrc import AdrcController, AdrcGains
from baselines.servo.disturbance import DisturbanceController, DisturbanceGains
from baselines.servo.flat import FlatController, FlatGains
from baselines.servo.paper import PaperController, rigid_controller
from baselines.servo.retuned import RetunedController, RetunedGains
from baselines.servo.shaping import EiController, ExtraInsensitiveGains, ShapingGains, ZvController, ZvdController
from baselines.servo.smooth import SmoothController, SmoothGains
from baselines.tools.command import require_known
from beltarm_env import ArmParams

TUNABLE = {
    "retuned": Tunable(RetunedController, RetunedGains),
    "zv": Tunable(ZvController, ShapingGains),
    "zvd": Tunable(ZvdController, ShapingGains),
    "ei": Tunable(EiController, ExtraInsensitiveGains),
    "smooth": Tunable(SmoothController, SmoothGains),
    "flat": Tunable(FlatController, FlatGains),
    "disturbance": Tunable(DisturbanceController, DisturbanceGains),
    "adrc": Tunable(AdrcController, AdrcGains),
    "lqg": Tunable(LqgController, LqgGains),
    "robust": Tunable(RobustController, RobustGains),
    "preview": Tunable(PreviewController, PreviewGains),
    "mpc": Tunable(MpcController, MpcGains),
    "adaptive": Tunable(AdaptiveController, AdaptiveGains),
}
"""Controllers that `baselines/tune.py` tunes, by name."""


def tuned_controller(name: str, params: ArmParams | None = None) -> Any:
    """Make one of `TUNABLE` with its gains of `gains.json`.

    Args:
        name: Of the controller.
        params: The design model, see `baselines.controller`.

    Raises:
        ValueError: If there is none with gains of this name, or the file of gains is damaged or out of date.
    """
    require_known((name,), TUNABLE, "no controller with gains is called {}")
    return TUNABLE[name].controller(tuned(name, TUNABLE[name].gains), params=params)


CONTROLLERS: dict[str, Callable[..., Any]] = {
    "paper": PaperController,
    "rigid": rigid_controller,
    **{name: partial(tuned_controller, name) for name in TUNABLE},
}
"""Controllers by the name used on command lines, in results and in policy bundles.

Call without arguments, or with `params` for arms with another gear ratio or torque limit than the nominal one's.
"""

DOMINATED = {"retuned": "flat", "zv": "flat", "ei": "flat", "disturbance": "flat"}
"""Controllers that another one, no more complex, beat on every split of single moves, by cost, tip error and residual.

They stay available by name; comparisons leave them out unless they are named.
"""


def _with_accelerometer(kind: Callable[..., Any], name: str, params: ArmParams | None = None) -> Any:
    return kind(tuned(name, TUNABLE[name].gains), params=params)


WITH_ACCELEROMETER: dict[str, Callable[..., Any]] = {
    "adaptive": partial(_with_accelerometer, AccelerometerAdaptiveController, "adaptive"),
    "preview": partial(_with_accelerometer, AccelerometerPreviewController, "preview"),
}
"""The same with an accelerometer in their filters and the gains found without, for `sensors="accelerometer"`: never
ranked among those that have the encoder alone.
"""
