"""What a policy's file says of it: algorithm, base, layers, inputs, provenance; and what this release accepts of that.

`entries` names the policy's inputs, in order: they are picked by name from what the environment shows and the agent is
told, which may be more than when the policy was trained. What they mean goes with `observation.LAYOUT`.

A residual is worth something only on the base, and with the knowledge, that it was trained with. So the gains of the
base are part of the description, and a policy acts on a base with these, whatever gains the checkout has. Where they
are no gains of the base any more, or the identification doubts otherwise, a policy is refused. So it is where arm and
drive are of another `edition`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from agents.policy.weights import ActorShape
from agents.residual.bases import BASES, base_settings, changed_settings, settings_hash
from agents.residual.controller import ResidualSettings
from agents.residual.knowledge import offered
from baselines.tools.schema import FLAG, INTEGER, NUMBER, TEXT, check, in_a_line, list_of, mapping_of, object_of
from beltarm_env.observation import ENTRIES, LAYOUT, Entry
from beltarm_env.task.ranges import EDITION, RANGES
from beltarm_env.task.shift import MOST_MOVES

MADE_FOR = {"format": "beltarm-policy", "version": 4, "layout": LAYOUT, "edition": EDITION}
"""What must be the same here for a policy to be used."""
ALGORITHMS = {"ppo": False, "recurrent_ppo": False, "sac": True, "student": False}
"""Algorithms by name, and whether a tanh bounds their residuals, instead of a cut."""
NO_SETTINGS = ("out", "seeds", "jobs", "engine", "address", "storage", "threads", "device", "resume", "overwrite")
"""Options of a training that say where and how it is computed, not what is learned."""
_COUNT, _TIME = (kind | {"minimum": 0, "maximum": 10**15} for kind in (INTEGER, NUMBER))
_RUN = {"steps": _COUNT, "seconds": _TIME}
_POINT = {"type": "array", "prefixItems": [_COUNT, _TIME, NUMBER], "minItems": 3, "maxItems": 3}
_ENTRY = {"type": "array", "prefixItems": [TEXT, TEXT, NUMBER, NUMBER], "minItems": 4, "maxItems": 4}
_SAID_OTHERWISE = ("inputs", "base_gains")  # by `entries` and by `base_settings`
_NAMED_NUMBERS = {"type": "object", "propertyNames": {"pattern": r"^\w+\Z"}, "additionalProperties": NUMBER}
_PROVENANCE = {
    "command": TEXT,
    "version": TEXT,
    "commit": TEXT,
    "versions": mapping_of(TEXT),
    "config": object_of(
        ("seed", "randomization", "moves", "nominal"),
        seed=INTEGER,
        randomization={"enum": list(RANGES)},
        moves=INTEGER | {"minimum": 1, "maximum": MOST_MOVES},
        nominal=list_of(TEXT),
    ),
    "run": object_of(("steps", "seconds"), **_RUN),
    "curve": list_of(_POINT),
    "reached": object_of(**_RUN, validation=_NAMED_NUMBERS),
    "validation_of_base": _NAMED_NUMBERS,
}
SCHEMA = object_of(
    algorithm={"enum": list(ALGORITHMS)},
    base={"enum": list(BASES)},
    residual=object_of(limit=NUMBER, hold=INTEGER, knowledge=TEXT) | {"additionalProperties": False},
    hidden=list_of(INTEGER),
    activation=TEXT,
    sensors={"enum": list(ENTRIES)},
    lstm=INTEGER,
    gru=INTEGER,
    standardised=FLAG,
    provenance=object_of(tuple(_PROVENANCE), **_PROVENANCE),
    base_settings=mapping_of(_NAMED_NUMBERS),
    base_hash=TEXT,
    entries=list_of(_ENTRY) | {"minItems": 1},
)
"""JSON Schema (2020-12) of a description; what it names in `provenance` may lack."""


class BundleError(ValueError):
    """Error about a policy that is missing, damaged or of another format."""


@dataclass(frozen=True, slots=True)
class BundleSpec:
    """Description of a policy: all that its file holds besides weights."""

    algorithm: str  # see `ALGORITHMS`
    base: str  # name of the base controller, see `agents.residual.bases.BASES`
    residual: ResidualSettings
    hidden: tuple[int, ...]  # width of the hidden layers
    activation: str = "tanh"
    sensors: str = "encoder"
    lstm: int = 0  # width of the LSTM, 0 for none
    gru: int = 0  # width of the GRU, 0 for none
    standardised: bool = False  # whether the network standardises its inputs
    provenance: dict[str, Any] = field(default_factory=dict)  # how it was trained
    inputs: tuple[str, ...] | None = None  # names of the entries that the policy is given, in order; None for all
    base_gains: dict[str, float] | None = None  # of the base in training; None for those of the checkout

    def offered(self) -> tuple[Entry, ...]:
        """All entries that a policy with these sensors and this knowledge can be given."""
        return offered(self.residual.knowledge, self.sensors)

    def columns(self) -> list[int]:
        """Place of each of the policy's inputs in what is offered."""
        names = [entry.name for entry in self.offered()]
        return [names.index(name) for name in self.inputs or names]

    def entries(self) -> list[list[Any]]:
        """Name, unit, scale and bound of the policy's inputs, in order."""
        entries = self.offered()
        return [list(entries[k]) for k in self.columns()]

    def shape(self) -> ActorShape:
        """Layers of the policy's network.

        Raises:
            ValueError: If they are not of a size that is allowed.
        """
        squashed = ALGORITHMS[self.algorithm]
        hidden, inputs = tuple(self.hidden), len(self.entries())
        return ActorShape(inputs, hidden, self.activation, squashed, self.lstm, self.gru, self.standardised)

    def content(self) -> dict[str, Any]:
        """Description as JSON has it, with the settings of the base."""
        settings = base_settings(self.base, self.residual.knowledge, self.base_gains)
        return {
            **MADE_FOR,
            **{name: value for name, value in asdict(self).items() if name not in _SAID_OTHERWISE},
            "hidden": list(self.hidden),
            "base_settings": settings,
            "base_hash": settings_hash(settings),
            "entries": self.entries(),
        }


def spec_of(content: dict[str, Any], path: Path) -> BundleSpec:
    """Read a description as JSON has it, of the file `path`.

    Raises:
        BundleError: If it is foreign, of another release, or was trained on another base.
    """
    for name, now in MADE_FOR.items():
        if content.get(name) != now:
            found = in_a_line(repr(content.get(name)), 80)
            raise BundleError(f"{path} has {name} {found}, this release has {now!r}: train it again")
    try:
        check(content, "its description", SCHEMA)
        known = {name: content[name] for name in BundleSpec.__slots__ if name not in _SAID_OTHERWISE}
        known |= {"residual": ResidualSettings(**content["residual"]), "hidden": tuple(content["hidden"])}
        spec = BundleSpec(**known)
        if content["entries"] != spec.entries():
            spec = replace(spec, inputs=_names_of(content["entries"], spec.offered()))
        spec.shape()
    except ValueError as error:
        raise BundleError(f"{path} does not fit this release: {in_a_line(error, 400)}") from None
    before, now = content["base_settings"], base_settings(spec.base, spec.residual.knowledge)
    try:
        settings = base_settings(spec.base, spec.residual.knowledge, before.get("gains", {}))
    except ValueError:
        settings = now
    if content["base_hash"] != settings_hash(settings):
        changes = changed_settings(before, now)
        raise BundleError(f"{path} was trained on another {spec.base!r} ({in_a_line(changes)}): train it again")
    return spec if settings == now else replace(spec, base_gains=settings["gains"])


def _names_of(entries: list[list[Any]], known: Sequence[Entry]) -> tuple[str, ...]:
    """Names of a policy's inputs; raises ValueError if one is not known with the same unit, scale and bound."""
    by_name = {entry.name: list(entry) for entry in known}
    for entry in entries:
        if entry != (now := by_name.get(entry[0])):
            raise ValueError(f"its observation entry is {entry}, and for its sensors and knowledge here {now}")
    return tuple(entry[0] for entry in entries)
