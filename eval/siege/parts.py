"""The parts of a siege."""

from __future__ import annotations

import time
from collections.abc import Callable

from baselines.engines.parallel import Channel
from eval.siege import chains, controllers, determinism, environment, guard, kills, properties, translation
from eval.siege.files import inputs
from eval.siege.report import Siege

PARTS: dict[str, Callable[[float, int], Siege]] = {
    "properties": properties.besiege,
    "inputs": inputs.besiege,
    "kills": kills.besiege,
    "environment": environment.besiege,
    "translation": translation.besiege,
    "controllers": controllers.besiege,
    "chains": chains.besiege,
    "guard": guard.besiege,
    "determinism": determinism.besiege,
}
"""By name, the longest first."""


def timed(name: str, share: float, seed: int, _: Channel) -> tuple[Siege, float]:
    """Run a part: what it tried and found, and the time that it took [s]."""
    began = time.perf_counter()
    return PARTS[name](share, seed), time.perf_counter() - began
