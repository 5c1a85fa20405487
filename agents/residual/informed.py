"""Base controller of a residual agent, with the identification whose belief the agent observes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from agents.residual.knowledge import (
    ENTRIES,
    KNOWLEDGE,
    RECENT,
    ExtraEntries,
    Knowledge,
    push_unexplained,
    write_belief,
    write_torque,
)
from baselines.estimation.identification import ArmIdentifier, Belief, IdentifyingController
from baselines.estimation.identify import Notes
from baselines.optimal.adaptive import tuned_identifier
from baselines.reading import Reading, beginning, read, sample_of
from beltarm_env import ArmParams, design_model
from beltarm_env.arrays import Flags, Floats, Singles
from beltarm_env.engine import compiled
from beltarm_env.rollout import DATA_SHEET, Controller, nominal_params


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
        remembers: Whether the base's memory, and so the belief, lasts from move to move.
    """

    def __init__(self, base: Controller, knowledge: Knowledge = "belief") -> None:
        if knowledge not in ENTRIES:
            raise ValueError(f"knowledge must be one of {', '.join(KNOWLEDGE)}, got {knowledge!r}")
        self.base = base
        self.knowledge: Knowledge = knowledge
        self.remembers = bool(getattr(base, "remembers", False))
        self.params = nominal_params(base) or (ArmParams() if knowledge == "belief" else None)
        sheet = {name: getattr(self.params or ArmParams(), name) for name in DATA_SHEET}
        self._identifier = tuned_identifier(replace(design_model(), **sheet)) if knowledge == "belief" else None
        self.entries = ExtraEntries(
            plant=(self.params or ArmParams()).plant(),
            scales=np.array([entry.scale for entry in ENTRIES[knowledge]]),
            bounds=np.array([entry.bound for entry in ENTRIES[knowledge]]),
        )

    @property
    def identifier(self) -> ArmIdentifier | None:
        """Identification that runs beside the base; None if the base shares its belief, or there is no knowledge."""
        return None if isinstance(self.base, IdentifyingController) else self._identifier

    def advance(self, observation: Singles, memory: InformedMemory | None, start: Flags | None) -> InformedMemory:
        """Run base and identification for one sample; observations of shape (n, size)."""
        action, base = self.base.predict(observation, memory.base if memory else None, start)
        if self._identifier is None:
            return InformedMemory(base, action, None, None, None)
        reading, before = read(observation, self._identifier.params), memory.belief if memory else None
        begins = beginning(before, start, observation, self.remembers)
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
        belief = self._identifier.reset(final.belief, reading, ended)
        begins = beginning(memory, ended, observation, self.remembers)
        return final, InformedMemory(base, action, reading, belief, _unexplained(belief, memory, begins))

    def seen(self, observation: Singles, memory: InformedMemory) -> Singles:
        """Observation of the agent, shape (n, size + entries), at the sample that `memory` has advanced to."""
        count, size = observation.shape
        result = np.empty((count, size + len(ENTRIES[self.knowledge])), np.float32)
        result[:, :size] = observation
        notes = None if memory.belief is None else memory.belief.notes
        _write_extra(self.entries, memory.action, memory.reading, notes, memory.unexplained, result[:, size:])
        return result


def _unexplained(belief: Belief, memory: InformedMemory | None, begins: Flags) -> Floats:
    """What the filter could not explain of the measured angles, of the latest sample and of those before."""
    unexplained = np.zeros((len(begins), RECENT))
    if memory is not None and memory.unexplained is not None:
        unexplained[:] = memory.unexplained
    _push_all(belief.notes, begins, unexplained)
    return unexplained


@compiled
def _push_all(notes: Notes, begins: Flags, unexplained: Floats) -> None:
    for i in range(len(begins)):
        push_unexplained(notes, i, begins[i], unexplained[i])


@compiled
def _write_extra(
    entries: ExtraEntries,
    actions: Singles,
    reading: Reading | None,
    notes: Notes | None,
    unexplained: Floats | None,
    extra: Singles,
) -> None:
    for i in range(len(extra)):
        write_torque(entries, actions[i, 0], extra[i])
        if reading is not None and notes is not None and unexplained is not None:
            write_belief(entries, sample_of(reading, i), notes, i, unexplained[i], extra[i])
