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
from agents.policy.bundle import POLICIES, load_controller
from agents.residual.bases import make_base
from agents.residual.knowledge import InformedBase
from baselines.estimation.believed_arm import IDENTIFIED, nominal_row
from beltarm_env import design_model
from beltarm_env.arm import COLUMN, FIELDS, plant_of
from beltarm_env.arrays import Flags, Floats, Singles
from beltarm_env.physics.drive import belt_motions, built_drive
from beltarm_env.rollout import Controller, Recording, rollout
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


def truth(recording: Recording, hold: int) -> Floats:
    """True quantities at samples 0, hold, 2 hold, ..., shape (samples, n, quantities).

    Constants are per commanded torque: a torque constant that is too high by k looks like an arm whose inertias,
    stiffness and friction are lower by 1 + k, and nothing that is measured tells the two apart. Friction is that of the
    episode's start, from which it drifts. Nothing is recorded at sample 0, where the arm rests: it has the next one's.
    """
    rows = np.maximum(np.arange(0, len(recording.state), hold) - 1, 0)
    count = len(recording.params)
    belts = np.empty((len(rows), count, 2))  # of the belts themselves, which the error of the gear moves too
    for i, row in enumerate(recording.params):
        belts[:, i] = belt_motions(np.ascontiguousarray(recording.state[rows, i]), plant_of(row), built_drive(row))
    constants = np.broadcast_to(_logs(recording.params), (len(rows), count, len(IDENTIFIED)))
    return np.concatenate([belts, recording.tip_error[rows], recording.tip_velocity_error[rows], constants], axis=2)


def _logs(table: Floats) -> Floats:
    """Logarithms of the identified constants over those of the model that controllers are made for, (n, constants)."""
    nominal = nominal_row(design_model())
    columns = [FIELDS.index(name) for name in IDENTIFIED]
    constants = table[:, columns]
    swing = IDENTIFIED.index("arm_inertia_swing")
    constants[:, swing] = [plant_of(row).inertia_swing for row in table]  # with the payload
    return np.log(constants / nominal[columns]) - np.log1p(table[:, [COLUMN.torque_constant_error]])


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
