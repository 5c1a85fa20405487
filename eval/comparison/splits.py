"""Test scenarios: arms and moves that nothing was trained, tuned or selected on, in `eval/comparison/scenarios.json`.

    python eval/scenarios.py --write     draw them and write the file
    python eval/scenarios.py             check the file, and that the physics is still that of the file

A scenario is one arm with one move and its sensors. Arm i of a split is what the environment draws from seed + i with
the split's ranges; the seeds are a range of their own (`beltarm_env.task.seeds`).

Every split but `nominal` has the arms and moves of `randomized`, with what its name says replaced: an episode draws the
same random numbers whatever its ranges, so a shifted constant has the same place in its new range that it had in the
old. What a method loses from `randomized` to such a split is due to the shift alone.

The file holds the numbers themselves, so that anybody runs exactly the same; the motions of a few scenarios, by which a
changed physics is noticed; and a SHA-256 of each split and of all.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltarm_env import ArmParams, BeltArmVectorEnv
from beltarm_env.arm import FIELDS, params_columns
from beltarm_env.rollout import Controller, Recording, rollout
from beltarm_env.task.moves import MOVE_FIELDS
from beltarm_env.task.ranges import TRAIN_RANGES, Ranges
from beltarm_env.task.seeds import TEST_NOMINAL, TEST_RANDOMIZED

Floats = NDArray[np.float64]

FILE = Path(__file__).with_name("scenarios.json")
FORMAT = "beltarm-scenarios"
VERSION = 1
"""Changes whenever the physics or a scenario changes: results of different versions must not be compared."""
COMMAND = "python eval/scenarios.py --write"
EPISODES = TEST_RANDOMIZED.size
"""Scenarios of a split."""
QUICK_EPISODES = 24


@dataclass(frozen=True, slots=True)
class Definition:
    """Definition of a split: ranges, settings and delays from which its scenarios are drawn."""

    description: str
    ranges: Ranges
    seed: int = TEST_RANDOMIZED.first
    settings: dict[str, Any] = field(default_factory=dict)  # of the environment, beyond its defaults
    delays: tuple[int, ...] = (0,)  # of the measurements [samples], in turn


def _shifted(**factors: tuple[float, float]) -> dict[str, tuple[float, float]]:
    """Ranges of some constants as multiples of their nominal values."""
    nominal = ArmParams()
    return {
        name: (low * getattr(nominal, name), high * getattr(nominal, name)) for name, (low, high) in factors.items()
    }


_FRICTION = _shifted(coulomb_friction=(1.3, 1.8), motor_viscous_friction=(1.3, 1.8))
_STIFFNESS = _shifted(belt_stiffness=(0.5, 0.8))
SPLITS = {
    "nominal": Definition("the nominal arm, random moves", {}, seed=TEST_NOMINAL.first),
    "randomized": Definition("arms from the training ranges, random moves", TRAIN_RANGES),
    "payload": Definition("heavier payloads, 0.2 to 0.5 kg", {**TRAIN_RANGES, "payload_mass": (0.2, 0.5)}),
    "stiffness": Definition("softer belts, 0.5 to 0.8 of the nominal stiffness", {**TRAIN_RANGES, **_STIFFNESS}),
    "friction": Definition("more Coulomb and viscous friction, 1.3 to 1.8 times", {**TRAIN_RANGES, **_FRICTION}),
    "sensing": Definition(
        "a coarse encoder, 1000 counts, read one or two samples late",
        TRAIN_RANGES,
        settings={"encoder_counts": 1000},
        delays=(1, 2),
    ),
    "structural": Definition(
        "the full two-link arm, whose equations no controller has", TRAIN_RANGES, settings={"model": "lagrangian"}
    ),
}


@dataclass(frozen=True, slots=True)
class Split:
    """Scenarios of one split."""

    name: str
    seed: int
    settings: dict[str, Any]
    table: Floats  # constants of the arms, columns as `ArmParams`     (n, 12)
    moves: Floats  # start, goal [rad], duration, ramp time [s]     (n, 4)
    delays: NDArray[np.int64]  # of the measurements [samples]     (n,)
    digest: str  # SHA-256 of its content

    def arms(self, chosen: NDArray[np.intp]) -> list[ArmParams]:
        """Return the constants of some of the arms."""
        return [ArmParams.from_row(row) for row in self.table[chosen]]

    def batches(self, episodes: int) -> Iterator[tuple[NDArray[np.intp], dict[str, Any]]]:
        """Yield the first scenarios in groups of one environment each: their numbers, and arguments of `rollout`."""
        for delay in np.unique(self.delays[:episodes]):
            chosen = np.flatnonzero(self.delays[:episodes] == delay)
            move = dict(zip(MOVE_FIELDS, self.moves[chosen].T, strict=True))
            options = {"params": params_columns(self.table[chosen]), "move": move}
            yield chosen, {"seed": self.seed, "options": options, "delay": int(delay), **self.settings}

    def run(self, controller: Controller, scenario: int) -> Recording:
        """Run a controller on one scenario by itself."""
        here = slice(scenario, scenario + 1)
        only = replace(self, table=self.table[here], moves=self.moves[here], delays=self.delays[here])
        ((_, arguments),) = only.batches(1)
        return rollout(controller, 1, **arguments)


def draw(name: str) -> Split:
    """Draw a split from its seeds."""
    definition = SPLITS[name]
    env = BeltArmVectorEnv(EPISODES, randomization=definition.ranges)
    env.reset(seed=definition.seed)
    delays = np.resize(definition.delays, EPISODES)
    return _split(name, definition.seed, definition.settings, env.params_table, env.moves, delays)


def _split(name: str, seed: int, settings: dict[str, Any], table: Floats, moves: Floats, delays: Any) -> Split:
    content = [VERSION, settings, table.tolist(), moves.tolist(), np.asarray(delays).tolist()]
    return Split(name, seed, settings, table, moves, np.asarray(delays), digest_of(content))


def digest_of(content: object) -> str:
    """SHA-256 of content that JSON can hold."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def columns_of(split: Split) -> dict[str, NDArray[Any]]:
    """Columns of a split by name, without the constants that are nominal in all its scenarios."""
    nominal = ArmParams()
    varied = {
        name: values for name, values in params_columns(split.table).items() if np.any(values != getattr(nominal, name))
    }
    return {**varied, **dict(zip(MOVE_FIELDS, split.moves.T, strict=True)), "delay": split.delays}


def load(path: Path = FILE) -> dict[str, Split]:
    """Read all splits from their file.

    Raises:
        ValueError: If the file is missing, damaged, changed by hand, or of another version.
    """
    remedy = f"restore {path.name}, or write it anew with `{COMMAND}`"
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ValueError(f"{path} cannot be read ({error}): {remedy}") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise ValueError(f"{path} is no file of {FORMAT}: {remedy}")
    if content.get("version") != VERSION:
        raise ValueError(f"{path} has version {content.get('version')!r}, this checkout needs {VERSION}: {remedy}")
    if content.get("sha256") != digest_of({key: value for key, value in content.items() if key != "sha256"}):
        raise ValueError(f"{path} was changed after it was written, its SHA-256 does not match: {remedy}")
    try:
        return _read(content["splits"])
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} does not hold what it should ({error!r}): {remedy}") from None


def _read(entries: dict[str, Any]) -> dict[str, Split]:
    splits: dict[str, Split] = {}
    for name, entry in entries.items():
        like = {} if entry["like"] is None else columns_of(splits[entry["like"]])
        columns = like | {key: np.array(values) for key, values in entry["columns"].items()}
        moves = np.column_stack([columns[key] for key in MOVE_FIELDS])
        nominal = ArmParams()
        table = np.column_stack([columns.get(key, np.full(len(moves), getattr(nominal, key))) for key in FIELDS])
        splits[name] = _split(name, entry["seed"], entry["settings"], table, moves, columns["delay"])
        if splits[name].digest != entry["sha256"]:
            raise ValueError(f"the SHA-256 of {name} does not match")
    return splits
