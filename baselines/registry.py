"""The classical controllers by name, made with their tuned gains."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from baselines.gains import Gains, tuned
from baselines.optimal.adaptive import AccelerometerAdaptiveController, AdaptiveController
from baselines.optimal.lqg import LqgController
from baselines.optimal.mpc import MpcController
from baselines.optimal.preview import AccelerometerPreviewController, PreviewController
from baselines.optimal.robust import RobustController
from baselines.servo.adrc import AdrcController
from baselines.servo.disturbance import DisturbanceController
from baselines.servo.flat import FlatController
from baselines.servo.paper import PaperController, RetunedController, rigid_controller
from baselines.servo.shaping import EiController, ZvController, ZvdController
from baselines.servo.smooth import SmoothController
from baselines.tools.command import require_known
from beltarm_env import ArmParams

TUNABLE: dict[str, type[Any]] = {
    "retuned": RetunedController,
    "zv": ZvController,
    "zvd": ZvdController,
    "ei": EiController,
    "smooth": SmoothController,
    "flat": FlatController,
    "disturbance": DisturbanceController,
    "adrc": AdrcController,
    "lqg": LqgController,
    "robust": RobustController,
    "preview": PreviewController,
    "mpc": MpcController,
    "adaptive": AdaptiveController,
}
"""Controllers that `baselines/tune.py` tunes, by name: made from gains of their `gains_type`, and `params`."""


def tuned_controller(name: str, params: ArmParams | None = None, gains: Gains | None = None) -> Any:
    """Make one of `TUNABLE` with its gains of `gains.json`, or with others.

    Args:
        name: Of the controller.
        gains: Of its `gains_type`; the tuned ones if not given.
        params: The design model, see `baselines.controller`.

    Raises:
        TypeError: If the gains are those of another controller.
        ValueError: If there is none with gains of this name, or the file of gains is damaged or out of date.
    """
    require_known((name,), TUNABLE, "no controller with gains is called {}")
    return TUNABLE[name](gains or tuned(name, TUNABLE[name].gains_type), params=params)


CONTROLLERS: dict[str, Callable[..., Any]] = {
    "paper": PaperController,
    "rigid": rigid_controller,
    **{name: partial(tuned_controller, name) for name in TUNABLE},
}
"""Controllers by the name used on command lines, in results and in policy bundles.

Call without arguments, with `params` for arms with another gear ratio or torque limit than the nominal one's, or with
`gains`, all but `rigid`: `CONTROLLERS["flat"](gains=replace(tuned("flat", FlatGains), angle=300.0))`.
"""

DOMINATED = {"retuned": "flat", "zv": "flat", "ei": "flat", "disturbance": "flat"}
"""Controllers that another one, no more complex, beat on every split of single moves, by cost, tip error and residual.

They stay available by name; comparisons leave them out unless they are named.
"""


def _with_accelerometer(kind: type[Any], name: str, params: ArmParams | None = None) -> Any:
    return kind(tuned(name, kind.gains_type), params=params)


WITH_ACCELEROMETER: dict[str, Callable[..., Any]] = {
    "adaptive": partial(_with_accelerometer, AccelerometerAdaptiveController, "adaptive"),
    "preview": partial(_with_accelerometer, AccelerometerPreviewController, "preview"),
}
"""The same with an accelerometer in their filters and the gains found without, for `sensors="accelerometer"`: never
ranked among those that have the encoder alone.
"""
