"""Observation of a residual agent: that of the environment, the base's torque, and a belief about the arm.

An encoder does not show payload, stiffness and friction, nor, while the motor sticks, the vibration. A network of a few
thousand weights does not infer them from a history of counts, so it gets the estimates of an extended Kalman filter
(`baselines.estimation.identification`): the state of the arm, the tip's errors in that state, the constants of arm and
drive, and how much of all that is in doubt. The filter sees the observation and nothing else, as the agent does.

Torque ripple is left out, which the filter finds and the base compensates. What the filter could not explain of the
last samples, and what was commanded in them, is told beside the belief: where its model of arm or noise is wrong, an
agent with a memory can know better.

Errors are scaled to order 1 at the precision wanted, not at the size that the base leaves: an input of order 0.01 is
learned late or never.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from gymnasium import spaces

from baselines.estimation.believed_arm import DISTURBANCE, IDENTIFIED, LOGS
from baselines.estimation.identification import Belief, IdentifyingController
from baselines.optimal.adaptive import tuned_identifier
from baselines.reading import Reading, beginning, read
from beltarm_env import ArmParams, design_model
from beltarm_env import observation as layout
from beltarm_env.arrays import Flags, Floats, Singles
from beltarm_env.observation import Entry
from beltarm_env.physics.kinematics import tip_errors
from beltarm_env.rollout import DATA_SHEET, Controller, nominal_params

Knowledge = Literal["belief", "none"]

_BASE_TORQUE = Entry("base_torque", "of limit", 1.0, 1.0)
_STATE = (
    Entry("believed_motor_speed", "rad/s", 100.0, 2000.0),
    Entry("believed_torsion", "rad", 0.01, 0.4),
    Entry("believed_torsion_speed", "rad/s", 0.2, 8.0),
)
_TIP = (
    Entry("believed_tip_error_x", "m", 0.003, 0.12),
    Entry("believed_tip_error_y", "m", 0.003, 0.12),
    Entry("believed_tip_speed_error_x", "m/s", 0.06, 2.4),
    Entry("believed_tip_speed_error_y", "m/s", 0.06, 2.4),
)
_SPREADS = {
    **dict(zip(IDENTIFIED, (0.35, 0.12, 0.06, 0.17, 0.17, 0.12), strict=True)),
    **{"delay": 0.5, "current_loop": 0.2, "friction_sine": 0.1, "friction_cosine": 0.1},
    **{"static_friction_excess": 0.15, "belt_stiffening": 0.1},
}  # of what is identified over the training ranges, in the order of z; of the first six, of their logarithms
_UNITS = {"delay": "samples", "current_loop": "samples"}
_CONSTANTS = tuple(
    Entry(f"believed_{name}", "ln" if name in IDENTIFIED else _UNITS.get(name, "-"), spread, 12 * spread)
    for name, spread in _SPREADS.items()
)
_DOUBTS = (
    Entry("doubt_of_torsion", "rad", 0.001, 0.01),
    Entry("doubt_of_torsion_speed", "rad/s", 0.03, 0.3),
    *(entry._replace(name=entry.name.replace("believed", "doubt_of")) for entry in _CONSTANTS),
)
_IDENTIFIED = slice(LOGS.start, DISTURBANCE)  # of z: all constants but those of the ripple
_DOUBTED = slice(2, DISTURBANCE)
_SURPRISE = Entry("surprise", "-", 1.0, 8.0)
_RECENT = 4  # samples
_UNEXPLAINED = tuple(Entry(f"unexplained_angle_{k}", "rad", 0.0002, 0.01) for k in range(_RECENT))
_COMMANDS = tuple(Entry(f"command_{k}_before_last", "of limit", 1.0, 1.0) for k in range(1, _RECENT))
ENTRIES: dict[Knowledge, tuple[Entry, ...]] = {
    "belief": (_BASE_TORQUE, *_STATE, *_TIP, *_CONSTANTS, *_DOUBTS, _SURPRISE, *_UNEXPLAINED, *_COMMANDS),
    "none": (_BASE_TORQUE,),
}
"""Entries appended to the observation, in order; scaled and bounded as the observation's own."""
KNOWLEDGE: tuple[Knowledge, ...] = ("belief", "none")


def residual_observation_space(sensors: str = "encoder", knowledge: Knowledge = "belief") -> spaces.Box:
    """Observation space of a residual agent."""
    told = [entry.bound / entry.scale for entry in ENTRIES[knowledge]]
    bounds = np.concatenate([layout.bounds(sensors), told]).astype(np.float32)
    return spaces.Box(-bounds, bounds, dtype=np.float32)


@dataclass(frozen=True, slots=True)
class InformedMemory:
    """Memory of an `InformedBase`, up to date with one sample."""

    base: Any  # the base controller's own
    action: Singles  # of the base, shape (n, 1)
    reading: Reading | None  # the decoded observation; None without knowledge
    belief: Belief | None  # about the arms; None without knowledge
    unexplained: Floats | None  # measured less believed angles of the last samples, latest first [rad], (n, _RECENT)


class InformedBase:
    """Base controller with the identification whose belief the agent observes.

    Args:
        base: The base controller. One that identifies its arm shares its belief.
        knowledge: "belief" for the identified arm, "none" for the base's torque alone.

    Attributes:
        params: Arm that base and identification are made for, see `Controller`; None if they take any.
    """

    def __init__(self, base: Controller, knowledge: Knowledge = "belief") -> None:
        if knowledge not in ENTRIES:
            raise ValueError(f"knowledge must be one of {', '.join(KNOWLEDGE)}, got {knowledge!r}")
        self.base = base
        self.knowledge: Knowledge = knowledge
        self.params = nominal_params(base) or (ArmParams() if knowledge == "belief" else None)
        self._plant = (self.params or ArmParams()).plant()
        sheet = {name: getattr(self.params or ArmParams(), name) for name in DATA_SHEET}
        self._identifier = tuned_identifier(replace(design_model(), **sheet)) if knowledge == "belief" else None
        entries = ENTRIES[knowledge]
        self._scales = np.array([entry.scale for entry in entries])
        self._bounds = np.array([entry.bound for entry in entries])

    def advance(self, observation: Singles, memory: InformedMemory | None, start: Flags | None) -> InformedMemory:
        """Run base and identification for one sample; observations of shape (n, size)."""
        action, base = self.base.predict(observation, memory.base if memory else None, start)
        if self._identifier is None:
            return InformedMemory(base, action, None, None, None)
        reading, before = read(observation, self._identifier.params), memory.belief if memory else None
        begins = beginning(before, start, len(observation))
        if isinstance(self.base, IdentifyingController):
            belief = self.base.belief(base)
        else:
            belief = self._identifier.update(before, reading, begins)
        return InformedMemory(base, action, reading, belief, _unexplained(belief, memory, begins))

    def ended(
        self, last: Singles, observation: Singles, memory: InformedMemory, ended: Flags
    ) -> tuple[InformedMemory, InformedMemory]:
        """Advance a batch in which some episodes end: to their last sample, and to the first of the next episode.

        Args:
            last: Observations, of arms that ended those of their last sample.
            observation: Observations, of arms that ended those of their next episode's first sample.
            memory: Of the sample before.
            ended: Which arms, shape (n,).
        """
        final = self.advance(last, memory, None)
        if self._identifier is None or final.belief is None or isinstance(self.base, IdentifyingController):
            return final, self.advance(observation, memory, ended)
        action, base = self.base.predict(observation, memory.base, ended)
        reading = read(observation, self._identifier.params)
        belief = self._identifier.reset(final.belief, reading.motor_angle, ended)
        return final, InformedMemory(base, action, reading, belief, _unexplained(belief, memory, ended))

    def seen(self, observation: Singles, memory: InformedMemory) -> Singles:
        """Observation of the agent, shape (n, size + told), at the sample that `memory` has advanced to."""
        told = memory.action.astype(np.float64)
        if memory.belief is not None and memory.reading is not None and memory.unexplained is not None:
            believed = self._believed(memory.belief, memory.reading)
            commands = memory.belief.commands[:, 1:_RECENT] / self._plant.torque_limit
            told = np.concatenate([told, believed, memory.unexplained, commands], axis=1)
        scaled = np.clip(told, -self._bounds, self._bounds) / self._scales
        return np.concatenate([observation, scaled.astype(np.float32)], axis=1)

    def _believed(self, belief: Belief, reading: Reading) -> Floats:
        """Entries of the belief: estimated state, tip errors, constants and standard deviations."""
        doubts = np.sqrt(np.maximum(belief.variance[:, _DOUBTED], 0.0))
        reference = np.stack([reading.reference_angle, reading.reference_speed], axis=1)
        errors = tip_errors(belief.state, reference, self._plant)
        constants = belief.tracks.mean[_IDENTIFIED].T
        return np.concatenate([belief.state[:, 1:], errors, constants, doubts, belief.tracks.surprise[:, None]], axis=1)


def _unexplained(belief: Belief, memory: InformedMemory | None, begins: Flags) -> Floats:
    """What the filter could not explain of the measured angles, of the latest sample and of those before."""
    now = (belief.angle - belief.tracks.mean[0])[:, None]
    if memory is None or memory.unexplained is None:
        return np.concatenate([now, np.zeros((len(now), _RECENT - 1))], axis=1)
    return np.concatenate([now, np.where(begins[:, None], 0.0, memory.unexplained[:, :-1])], axis=1)
