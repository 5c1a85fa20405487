"""What a residual is added to: a classical controller, or nothing."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from agents.residual.knowledge import Knowledge
from baselines import CONTROLLERS
from baselines.controller import LawKernel
from baselines.gains import tuned
from baselines.optimal.adaptive import AdaptiveController, AdaptiveGains
from baselines.reading import Sample, one_or_many
from baselines.registry import WITH_ACCELEROMETER
from baselines.tools.command import require_known
from baselines.tools.schema import in_a_line
from beltarm_env.arrays import Flags, Floats, Singles
from beltarm_env.engine import compiled
from beltarm_env.rollout import Controller


@compiled
def no_torque(design: Floats, now: Sample, begins: bool, memory: Floats) -> float:
    """No torque, whatever is measured; see `LawKernel`."""
    return 0.0


class NoController:
    """Controller whose torque is zero: base of an agent that learns from scratch."""

    @one_or_many
    def predict(
        self, observation: Singles, state: Any = None, episode_start: Flags | None = None, deterministic: bool = True
    ) -> tuple[Singles, None]:
        """Zeros of shape (n, 1)."""
        return np.zeros((len(observation), 1), np.float32), None

    def kernel(self) -> LawKernel:
        """The law for one arm."""
        return LawKernel(no_torque, np.zeros(1), np.zeros(1))


BASES: dict[str, Callable[[], Any]] = {**CONTROLLERS, "none": NoController}
"""Base controllers by name: all of `baselines.CONTROLLERS`, and none."""


def make_base(name: str, sensors: str = "encoder", gains: Mapping[str, float] | None = None) -> Controller:
    """Make the base controller called `name`.

    Args:
        name: Of `BASES`.
        sensors: Of the arm; with "accelerometer", a base whose filter can use it does.
        gains: By name; those of the checkout if not given.

    Raises:
        ValueError: If there is none, naming the nearest one, or it does not take such gains.
    """
    require_known((name,), BASES, "no base controller {}")
    feels = sensors == "accelerometer" and name in WITH_ACCELEROMETER
    base: Any = (WITH_ACCELEROMETER if feels else BASES)[name]()
    own = getattr(base, "gains", None)
    if gains is None or gains == (asdict(own) if own else {}):
        return base
    if own is None or gains.keys() != asdict(own).keys():
        raise ValueError(f"{name!r} has no gains {in_a_line(', '.join(gains), 80)}")
    return type(base)(gains=type(own)(**gains))


def base_settings(
    name: str, knowledge: Knowledge, gains: Mapping[str, float] | None = None
) -> dict[str, dict[str, float]]:
    """Gains that a residual relies on: the base's and, if the agent observes a belief, the identification's.

    Raises:
        ValueError: As `make_base`, or if the file of gains is damaged.
    """
    base, doubts = make_base(name, gains=gains), {}
    if knowledge == "belief":
        own = isinstance(base, AdaptiveController)  # whose belief is the one that the agent observes
        doubts = asdict(base.uncertainty if own else tuned("adaptive", AdaptiveGains).uncertainty())
    own_gains: Any = getattr(base, "gains", None)
    return {"gains": asdict(own_gains) if own_gains else {}, "doubts": doubts}


def settings_hash(settings: dict[str, dict[str, float]]) -> str:
    """Compute the SHA-256 of settings, independent of their order."""
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()


def changed_settings(before: dict[str, dict[str, float]], now: dict[str, dict[str, float]]) -> str:
    """List settings that have changed, with both values."""
    changes = []
    for kind in now:
        old, new = before.get(kind, {}), now[kind]
        names = [name for name in {**old, **new} if old.get(name) != new.get(name)]
        changes += [f"{kind}.{name} was {old.get(name)}, is {new.get(name)}" for name in names]
    return "; ".join(changes)
