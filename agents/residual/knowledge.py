"""Observation of a residual agent: that of the environment, the base's torque, and a belief about the arm.

An encoder does not show payload, stiffness and friction, nor, while the motor sticks, the vibration. A network of a few
thousand weights does not infer them from a history of counts, so it gets the estimates of an extended Kalman filter
(`baselines.estimation.identification`): the state of the arm, the tip's errors in that state, the constants of arm and
drive, and how much of all that is in doubt. Ripple, which `adaptive` compensates, and g are left out. What the filter
could not explain of the last samples, and what was commanded in them, stands beside the belief: where its model is
wrong, an agent with a memory can know better.

Errors are scaled to order 1 at the precision wanted, not at the size that the base leaves: an input of order 0.01 is
learned late or never.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Any, Literal, NamedTuple

import numpy as np
from gymnasium import spaces

from baselines.estimation.believed_arm import IDENTIFIED, LOGS
from baselines.estimation.identification import Belief
from baselines.optimal.adaptive import AdaptiveController, tuned_identifier
from baselines.reading import Reading, Sample, beginning, read, sample_of
from beltarm_env import ArmParams, design_model
from beltarm_env import observation as layout
from beltarm_env.arm import Plant
from beltarm_env.arrays import Flags, Floats, Singles
from beltarm_env.engine import compiled, inlined
from beltarm_env.observation import Entry
from beltarm_env.physics.kinematics import tip_error, tip_motion
from beltarm_env.physics.state import ArmState
from beltarm_env.rollout import DATA_SHEET, Controller, nominal_params, nominal_profile, require_controller

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
_IDENTIFIED = LOGS.start  # of z: from here on the constants of `_CONSTANTS`, in order
_DOUBTED = 2  # of z: from here up to the belt's stiffening
_SURPRISE = Entry("surprise", "-", 1.0, 8.0)
RECENT = 4
"""Samples whose unexplained angles, and commands, the agent observes."""
_UNEXPLAINED = tuple(Entry(f"unexplained_angle_{k}", "rad", 0.0002, 0.01) for k in range(RECENT))
_COMMANDS = tuple(Entry(f"command_{k}_before_last", "of limit", 1.0, 1.0) for k in range(1, RECENT))
_PARTS = ((_BASE_TORQUE,), _STATE, _TIP, _CONSTANTS, _DOUBTS, (_SURPRISE,), _UNEXPLAINED, _COMMANDS)
ENTRIES: dict[Knowledge, tuple[Entry, ...]] = {
    "belief": tuple(entry for part in _PARTS for entry in part),
    "none": (_BASE_TORQUE,),
}
"""Entries appended to the observation, in order; scaled and bounded as the observation's own."""
_BASE_AT, _STATE_AT, _TIP_AT, _CONSTANTS_AT, _DOUBTS_AT, _SURPRISE_AT, _UNEXPLAINED_AT, _COMMANDS_AT = accumulate(
    map(len, _PARTS[:-1]), initial=0
)


def offered(knowledge: Knowledge, sensors: str = "encoder") -> tuple[Entry, ...]:
    """All entries that an agent observes, in order: those of the environment, then those of `ENTRIES`."""
    return (*layout.ENTRIES[sensors], *ENTRIES[knowledge])


def residual_observation_space(sensors: str = "encoder", knowledge: Knowledge = "belief") -> spaces.Box:
    """Observation space of a residual agent."""
    bounds = np.array([entry.bound / entry.scale for entry in offered(knowledge, sensors)], np.float32)
    return spaces.Box(-bounds, bounds, dtype=np.float32)


class ExtraEntries(NamedTuple):
    """Constants of `write_torque` and `write_belief`."""

    plant: Plant  # whose lengths the tip's errors follow from, and whose limit commands are scaled by
    scales: Floats  # of the entries
    bounds: Floats  # likewise


@inlined
def cut(x: float, most: float) -> float:
    """Number between -most and most that is nearest to x; what is no number stays none, so that it is noticed."""
    above = -most if x < -most else x
    return most if above > most else above


@inlined
def _write(extra: Singles, k: int, value: float, entries: ExtraEntries) -> None:
    """Write an entry, bounded and scaled."""
    extra[k] = cut(value, entries.bounds[k]) / entries.scales[k]


@inlined
def write_torque(entries: ExtraEntries, action: float, extra: Singles) -> None:
    """Write the first of the entries: the base's torque over the limit."""
    _write(extra, _BASE_AT, np.float64(action), entries)


@compiled
def write_belief(
    entries: ExtraEntries, now: Sample, belief: Belief, i: int, unexplained: Floats, extra: Singles
) -> None:
    """Write the entries of the belief about arm i, see `ENTRIES`; `unexplained` is that of `push_unexplained`."""
    tracks, plant = belief.tracks, entries.plant
    z = tracks.mean[i]
    x = ArmState(z[0], z[1], z[2], z[3])
    error = tip_error(tip_motion(x, plant), now.reference_angle, now.reference_speed, plant)
    for k in range(_TIP_AT - _STATE_AT):
        _write(extra, _STATE_AT + k, z[1 + k], entries)
    _write(extra, _TIP_AT, error.x, entries)
    _write(extra, _TIP_AT + 1, error.y, entries)
    _write(extra, _TIP_AT + 2, error.x_speed, entries)
    _write(extra, _TIP_AT + 3, error.y_speed, entries)
    for k in range(_DOUBTS_AT - _CONSTANTS_AT):
        _write(extra, _CONSTANTS_AT + k, z[_IDENTIFIED + k], entries)
    for k in range(_SURPRISE_AT - _DOUBTS_AT):
        variance = tracks.covariance[i, _DOUBTED + k, _DOUBTED + k]
        _write(extra, _DOUBTS_AT + k, math.sqrt(0.0 if variance < 0.0 else variance), entries)
    _write(extra, _SURPRISE_AT, tracks.surprise[i], entries)
    for k in range(RECENT):
        _write(extra, _UNEXPLAINED_AT + k, unexplained[k], entries)
    for k in range(RECENT - 1):
        _write(extra, _COMMANDS_AT + k, belief.commands[i, 1 + k] / plant.torque_limit, entries)


@inlined
def push_unexplained(belief: Belief, i: int, begins: bool, unexplained: Floats) -> None:
    """Put what a filter could not explain of the latest angle before that of earlier samples, shape (RECENT,)."""
    for k in range(RECENT - 1, 0, -1):
        unexplained[k] = 0.0 if begins else unexplained[k - 1]
    unexplained[0] = belief.angle[i] - belief.tracks.mean[i, 0]


@dataclass(frozen=True, slots=True)
class InformedMemory:
    """Memory of an `InformedBase`, up to date with one sample."""

    base: Any  # the base controller's own
    action: Singles  # of the base, shape (n, 1)
    reading: Reading | None  # the decoded observation; None without knowledge
    belief: Belief | None  # about the arms; None without knowledge
    unexplained: Floats | None  # measured less believed angles of the last samples, latest first [rad], (n, RECENT)


class InformedBase:
    """Base controller with the identification whose belief the agent observes.

    Args:
        base: The base controller. One that identifies its arm shares its belief.
        knowledge: "belief" for the identified arm, "none" for the base's torque alone.

    Attributes:
        params: Arm that base and identification are made for, see `Controller`; None if they take any.
        profile: Shape of the reference that the base rebuilds, see `Controller`; None if it takes any.
        remembers: Whether the base's memory, and so the belief, lasts from move to move.
        identifier: Identification beside the base; None if the base shares its belief, or there is no knowledge.
    """

    def __init__(self, base: Controller, knowledge: Knowledge = "belief") -> None:
        require_controller(base)
        self.base: Any = base
        self.knowledge: Knowledge = knowledge
        self.remembers = bool(getattr(base, "remembers", False))
        self.params = nominal_params(base) or (ArmParams() if knowledge == "belief" else None)
        self.profile = nominal_profile(base)
        arm = self.params or ArmParams()
        self._design = replace(design_model(), **{name: getattr(arm, name) for name in DATA_SHEET})
        alone = knowledge == "belief" and not isinstance(base, AdaptiveController)
        self.identifier = tuned_identifier(self._design) if alone else None
        self.entries = ExtraEntries(
            plant=arm.plant(),
            scales=np.array([entry.scale for entry in ENTRIES[knowledge]]),
            bounds=np.array([entry.bound for entry in ENTRIES[knowledge]]),
        )

    def advance(
        self, observation: Singles, memory: InformedMemory | None, start: Flags | None, known: Belief | None = None
    ) -> InformedMemory:
        """Run base and identification for one sample.

        Args:
            observation: Shape (n, size).
            memory: Of the sample before; None at the beginning.
            start: Which arms begin an episode, shape (n,); None for none.
            known: Belief about all other arms at this sample, where it has been computed already.
        """
        action, base = self.base.predict(observation, memory.base if memory else None, start)
        if self.knowledge == "none":
            return InformedMemory(base, action, None, None, None)
        reading, begins = read(observation, self._design), beginning(memory, start, observation, self.remembers)
        if self.identifier is None:
            belief = self.base.belief(base)
        elif known is not None and start is not None:
            belief = self.identifier.reset(known, reading, start)
        else:
            belief = self.identifier.update(memory.belief if memory else None, reading, begins)
        before = memory.unexplained if memory else None
        unexplained = np.zeros((len(begins), RECENT)) if before is None else before.copy()
        _push_all(belief, begins, unexplained)
        return InformedMemory(base, action, reading, belief, unexplained)

    def seen(self, observation: Singles, memory: InformedMemory) -> Singles:
        """Observation of the agent, shape (n, size + entries), at the sample that `memory` has advanced to."""
        count, size = observation.shape
        result = np.empty((count, size + len(ENTRIES[self.knowledge])), np.float32)
        result[:, :size] = observation
        _write_extra(self.entries, memory.action, memory.reading, memory.belief, memory.unexplained, result[:, size:])
        return result


@compiled
def _push_all(belief: Belief, begins: Flags, unexplained: Floats) -> None:
    for i in range(len(begins)):
        push_unexplained(belief, i, begins[i], unexplained[i])


@compiled
def _write_extra(
    entries: ExtraEntries,
    actions: Singles,
    reading: Reading | None,
    belief: Belief | None,
    unexplained: Floats | None,
    extra: Singles,
) -> None:
    for i in range(len(extra)):
        write_torque(entries, actions[i, 0], extra[i])
        if reading is not None and belief is not None and unexplained is not None:
            write_belief(entries, sample_of(reading, i), belief, i, unexplained[i], extra[i])
