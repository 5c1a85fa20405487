"""Splits: kinds of arms that the comparison asks about, and how their scenarios are drawn.

A scenario is one arm with its sensors and one move, or a shift of several. Arm i of a split is what the environment
draws from seed + i with the split's ranges. Every split has seeds of its own, so that no two have an arm or a move in
common. The splits after `shift` are shifts with one thing beyond what tuning and training see.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltarm_env import ArmParams
from beltarm_env.arm import NOMINAL, params_columns
from beltarm_env.arrays import Floats, Integers
from beltarm_env.batch import ArmBatch
from beltarm_env.task.draws import DRAWS
from beltarm_env.task.moves import MOVE_FIELDS
from beltarm_env.task.ranges import PRESLIDING, SHIFT_RANGES, TRAIN_RANGES, Ranges
from beltarm_env.task.seeds import SeedRange
from beltarm_env.task.sensors import ENCODER_COUNTS
from beltarm_env.task.streams import drawn, seeded

EDITION = 3
"""Of the comparison: the kinds of arms that it asks about. Results of two editions answer different questions."""
VERSION = 4
"""Changes whenever the physics or a scenario changes: results of different versions must not be compared.

An error of the physics whose mend changes costs by less than 1 % does not raise it: the protocol lists it.
"""
EPISODES = 200
"""Scenarios of a split."""
MOVES = 6
"""Moves of a shift."""
QUICK_EPISODES, QUICK_MOVES, QUICK_SEEDS = 20, 2, 2
"""Scenarios of a split, moves of a shift, and shipped policies of a learned method, that are run for a first look."""
_SPACING = 1000  # seeds between the first arms of two splits
_PER_SCENARIO, _PER_MOVE = ("seeds", "delays"), ("tables", "all_moves")  # arrays of a split, by their axes


@dataclass(frozen=True, slots=True)
class Definition:
    """Definition of a split: ranges and settings from which its scenarios are drawn."""

    description: str
    ranges: Ranges
    settings: dict[str, Any] = field(default_factory=dict)  # of the environment, beyond its defaults
    delay: tuple[float, float] = (0.0, 0.0)  # of the measurements [samples], uniform
    moves: int = 1


def _shifted(**times: tuple[float, float]) -> dict[str, tuple[float, float]]:
    """Ranges of some constants as multiples of their nominal values."""
    return {name: (low * getattr(NOMINAL, name), high * getattr(NOMINAL, name)) for name, (low, high) in times.items()}


def _shifts(description: str, beyond: Ranges | None = None, **more: Any) -> Definition:
    """Define shifts with some ranges beyond those of training."""
    return Definition(description, {**SHIFT_RANGES, **(beyond or {})}, moves=MOVES, **more)


_DRIVE = ("torque_ripple", "static_friction_excess", "kinematic_error", "current_loop_time_constant", "command_latency")
SPLITS = {
    "nominal": Definition("the nominal arm with an ideal drive, one move from rest", {}),
    "randomized": Definition(
        "arms and drives from the training ranges, one move of an arm that nobody has met before",
        {**TRAIN_RANGES, **PRESLIDING},
    ),
    "shift": _shifts("working shifts: arms and drives from the training ranges, a new part in every other move"),
    "payload": _shifts("shifts with heavier parts, 0.5 to 0.8 kg", {"payload_mass": (0.5, 0.8)}),
    "stiffness": _shifts(
        "shifts with softer belts, 0.5 to 0.8 of the nominal stiffness", _shifted(belt_stiffness=(0.5, 0.8))
    ),
    "friction": _shifts(
        "shifts with more Coulomb and viscous friction, 1.3 to 1.8 times the nominal",
        _shifted(coulomb_friction=(1.3, 1.8), motor_viscous_friction=(1.3, 1.8)),
    ),
    "drive": _shifts(
        "shifts with worse drives: ripple, breakaway, kinematic error and lag 1.3 to 1.8 times the most in training",
        {name: (1.3 * TRAIN_RANGES[name][1], 1.8 * TRAIN_RANGES[name][1]) for name in _DRIVE},
    ),
    "presliding": _shifts(
        "shifts with motors that give by 10 to 20 mrad before they slip", {"presliding_deflection": (0.010, 0.020)}
    ),
    "sensing": _shifts(
        "shifts with a coarse encoder, 1000 counts, read one to two samples late",
        settings={"encoder_counts": 1000},
        delay=(1.0, 2.0),
    ),
    "structural": _shifts(
        "shifts with the full two-link arm, whose equations no ranked method has", settings={"model": "lagrangian"}
    ),
}
"""By name. A new one comes last: its place says which seeds it has."""


def main_split(names: Sequence[str]) -> str:
    """Split that is asked about first: of shifts, or else of single moves, or else the first of some splits."""
    return next((name for name in ("shift", "randomized") if name in names), names[0])


@dataclass(frozen=True)
class Split:
    """Scenarios of one split. Of a shift, settings have the number of moves and the ranges that later ones need."""

    name: str
    of: str  # name of the set of scenarios that it belongs to
    seeds: NDArray[np.int64]  # (n,)
    settings: dict[str, Any]  # of the environment
    tables: Floats  # constants of the arms in each move, columns as `ArmParams`     (moves, n, len(FIELDS))
    all_moves: Floats  # start, goal [rad], duration, ramp time [s]     (moves, n, 4)
    delays: Floats  # of the measurements [samples]     (n,)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of its content."""
        if len(self.tables) == 1:
            content = [self.tables[0].tolist(), self.all_moves[0].tolist(), self.delays.tolist()]
        else:
            drawn = hashlib.sha256(b"".join(each.tobytes() for each in (self.seeds, self.tables, self.all_moves)))
            content = [drawn.hexdigest(), self.delays.tolist()]
        return digest_of([VERSION, self.settings, *content])

    @property
    def seed(self) -> int:
        """Seed of the first arm."""
        return int(self.seeds[0])

    @property
    def table(self) -> Floats:
        """Constants of the arms in their first move, shape (n, len(FIELDS))."""
        return self.tables[0]

    @property
    def moves(self) -> Floats:
        """First moves, shape (n, 4)."""
        return self.all_moves[0]

    def arms(self, rows: slice | Integers) -> list[list[ArmParams]]:
        """Return the constants of some arms, in each move."""
        return arms_of(self.tables[:, rows])

    def arguments(self, chosen: slice | Integers) -> dict[str, Any]:
        """Return arguments of `rollout` with which some scenarios run side by side, any of them several times."""
        late = {"delay": self.delays[chosen]} if self.delays.any() else {}
        if len(self.tables) > 1:  # what comes after the first move is drawn on the way
            return {"seed": self.seeds[chosen].tolist(), **late, **self.settings}
        move = dict(zip(MOVE_FIELDS, self.moves[chosen].T, strict=True))
        options = {"params": params_columns(self.table[chosen]), "move": move}
        return {"seed": self.seed, "options": options, **late, **self.settings}

    @property
    def kind_of_batch(self) -> tuple[str, bool]:
        """Key of the splits whose scenarios can run in a batch with those of this one."""
        return json.dumps(self.settings, sort_keys=True), bool(self.delays.any())

    def part(self, rows: slice | Integers) -> Split:
        """Make a split of some of the scenarios."""
        chosen = self.tables[:, rows], self.all_moves[:, rows], self.delays[rows]
        return Split(self.name, self.of, self.seeds[rows], self.settings, *chosen)

    def shortened(self, moves: int) -> Split:
        """Make a split of the same scenarios, of which shifts have only their first moves."""
        if len(self.tables) <= moves:
            return self
        settings, few = {**self.settings, "moves": moves}, slice(moves)
        return replace(self, settings=settings, tables=self.tables[few], all_moves=self.all_moves[few])


def arms_of(tables: Floats) -> list[list[ArmParams]]:
    """Arms in each move, from their constants, shape (moves, n, len(FIELDS))."""
    return [[ArmParams.from_row(row) for row in table] for table in tables]


def beside_one_another(splits: Sequence[Split]) -> list[list[int]]:
    """Group splits, by their places, so that those of a group can run in a batch."""
    groups: dict[tuple[str, bool], list[int]] = {}
    for k, split in enumerate(splits):
        groups.setdefault(split.kind_of_batch, []).append(k)
    return list(groups.values())


def side_by_side(chosen: Sequence[tuple[Split, slice]]) -> Split:
    """Put scenarios of splits of one `kind_of_batch` into one split without a name, one after the other."""
    seeds, delays = (np.concatenate([getattr(split, name)[part] for split, part in chosen]) for name in _PER_SCENARIO)
    tables, moves = (np.concatenate([getattr(split, name)[:, part] for split, part in chosen], 1) for name in _PER_MOVE)
    return replace(chosen[0][0], name="", of="", seeds=seeds, tables=tables, all_moves=moves, delays=delays)


def draw(name: str, of: str, seeds: SeedRange) -> Split:
    """Draw a split of a set of scenarios that has a range of seeds to itself.

    Raises:
        ValueError: If the range has no room for it.
    """
    first = first_seed(name, seeds)
    return draw_arms(name, of, range(first, first + EPISODES))


def draw_arms(name: str, of: str, seeds: Sequence[int]) -> Split:
    """Draw scenarios of a split by their seeds, one each."""
    about = SPLITS[name]
    settings, count = dict(about.settings), len(seeds)
    if about.moves > 1:
        settings |= {"moves": about.moves, "randomization": dict(about.ranges)}
    usual: dict[str, Any] = {"sensors": "encoder", "profile": "trapezoid", "model": "lumped", "delay": 0}
    batch = ArmBatch(count, randomization=about.ranges, encoder_counts=ENCODER_COUNTS, moves=about.moves, **usual)
    streams, chosen = seeded(seeds), np.arange(count)
    tables, moves = list[Floats](), list[Floats]()
    for number in range(about.moves):
        uniforms = drawn(streams, chosen, DRAWS)
        batch.next_moves(chosen, uniforms) if number else batch.reset(chosen, uniforms, None)
        tables.append(batch.table.copy())
        moves.append(batch.moves)
    low, high = about.delay  # its draws come from the pair (seed, 1), those of the arm from the seed alone
    delays = low + (high - low) * np.array([np.random.default_rng((seed, 1)).random() for seed in seeds])
    return Split(name, of, np.array(seeds), settings, np.array(tables), np.array(moves), delays)


def first_seed(name: str, seeds: SeedRange, spacing: int = _SPACING) -> int:
    """Seed of a split's first arm in the range of seeds of a set, where splits begin `spacing` seeds apart.

    Raises:
        ValueError: If the range has no room for it.
    """
    place = spacing * list(SPLITS).index(name)
    if place + spacing > seeds.size:
        raise ValueError(f"split {name} needs {place + spacing} seeds, its range has {seeds.size}: enlarge it")
    return seeds.first + place


def digest_of(content: object) -> str:
    """SHA-256 of content that JSON can hold."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
