"""Episodes that a learned observer is fitted to: arms of the training ranges under the torques of many controllers.

An observer that has seen one controller's torques alone would take that controller's habits for the arm's. Some of
the torques are disturbed besides, by noise of first order of a size that differs from arm to arm.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from agents.observer.network import Observer
from agents.observer.quantities import truth
from agents.policy.bundle import POLICIES, load_controller
from agents.residual.bases import make_base
from agents.residual.knowledge import InformedBase
from beltarm_env.arrays import Flags, Singles
from beltarm_env.rollout import Controller, rollout
from beltarm_env.task.seeds import OBSERVER

STUDENT = POLICIES / "student" / "seed0"
"""Policy that acts where a source is the student."""
_MEMORY = 0.97  # of the noise from sample to sample: 50 ms


class Source(NamedTuple):
    """Controller whose torques an observer is fitted to."""

    name: str  # of a classical controller, or "student"
    noise: float = 0.0  # largest standard deviation of what is added to its torque, over the torque limit

    def controller(self) -> Controller:
        """Make the controller."""
        return load_controller(STUDENT) if self.name == "student" else make_base(self.name)


SOURCES = (
    Source("adaptive"),
    Source("adaptive", 0.05),
    Source("student"),
    Source("student", 0.05),
    Source("preview", 0.05),
    Source("paper"),
)


class Episodes(NamedTuple):
    """What an observer sees in n episodes, and what there was to be seen."""

    inputs: torch.Tensor  # (T, n, inputs), half precision
    truth: torch.Tensor  # (T, n, quantities)

    @staticmethod
    def joined(parts: list[Episodes]) -> Episodes:
        """Join parts, episode after episode."""
        return Episodes(*(torch.cat(tensors, dim=1) for tensors in zip(*parts, strict=True)))


class Disturbed:
    """Controller whose torque is disturbed, and that notes what an observer sees; for one rollout."""

    def __init__(self, source: Source, observer: Observer, seed: int, count: int) -> None:
        self.informed = InformedBase(source.controller(), observer.knowledge)
        self.params = self.informed.params
        self.inputs: list[NDArray[np.float16]] = []
        self._observer = observer
        self._random = np.random.default_rng(seed)
        self._step = 0
        self._size = source.noise * self._random.random((count, 1))
        self._disturbance = np.zeros((count, 1))

    def predict(
        self, observation: Singles, state: Any = None, episode_start: Flags | None = None, deterministic: bool = True
    ) -> tuple[Singles, Any]:
        """Call the controller's `predict`, and disturb what it returns."""
        informed = self.informed.advance(observation, state, episode_start)
        if self._step % self._observer.hold == 0:
            seen = self.informed.seen(observation, informed)
            self.inputs.append(seen[:, self._observer.columns].astype(np.float16))
        self._step += 1
        fresh = self._random.standard_normal((len(observation), 1))
        self._disturbance = _MEMORY * self._disturbance + np.sqrt(1 - _MEMORY**2) * self._size * fresh
        return (informed.action + self._disturbance.astype(np.float32)).clip(-1, 1), informed


def simulate(source: Source, observer: Observer, first: int, count: int) -> Episodes:
    """Run a source on arms seeded from `first` on, and leave out those that leave their workspace."""
    disturbed = Disturbed(source, observer, first, count)
    recording = rollout(disturbed, count, seed=first, randomization="train")
    stayed = np.flatnonzero(recording.finished)
    inputs, true = np.stack(disturbed.inputs)[:, stayed], truth(recording, observer.hold)[:, stayed]
    return Episodes(torch.from_numpy(inputs), torch.from_numpy(true.astype(np.float32)))


def simulate_block(observer: Observer, offset: int, count: int) -> Episodes:
    """Run all sources in turn on `count` of the observer's arms, from the one at `offset` on."""
    ends = np.linspace(0, count, len(SOURCES) + 1).round().astype(int)
    first = OBSERVER.first + offset
    spans = zip(SOURCES, ends[:-1], ends[1:], strict=True)
    parts = [(source, int(low), int(high - low)) for source, low, high in spans if high > low]
    return Episodes.joined([simulate(source, observer, first + low, size) for source, low, size in parts])
