"""Sets of scenarios: for development, for the test, and fresh ones for anybody.

    development   drawn on the fly; controllers and agents may be chosen on it: its numbers are no test results
    test          drawn once, from seeds of the protocol's commit, into `scenarios.json`; nothing is chosen on it
    seed N        drawn on the fly by the rules of the test set, from seeds that nothing else uses; the only one with
                  further scenarios, as many as anybody wants

All are made alike, each from a range of seeds of its own (`beltarm_env.task.seeds`). The file of the test set has seeds
and hashes, by which scenarios that are drawn otherwise are noticed, and a few motions, by which a changed physics is.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from baselines.tools.files import read_text, write_text
from baselines.tools.provenance import last_commit_of
from baselines.tools.schema import in_a_line, loads
from beltarm_env.observation import index
from beltarm_env.rollout import rollout
from beltarm_env.task.seeds import DEVELOPMENT, MAX_FRESH_SEED, SeedRange, arms_chosen_by, fresh_arms, further_arms
from eval.comparison.splits import (
    EDITION,
    EPISODES,
    MOVES,
    SPLITS,
    VERSION,
    Split,
    beside_one_another,
    digest_of,
    draw,
    draw_arms,
    first_seed,
    side_by_side,
)

DEVELOPMENT_NAME, TEST_NAME = "development", "test"
MOST = 3_000_000
"""Scenarios of a split of a fresh set, with all further ones."""


class SetLabel(NamedTuple):
    """Name of a set of scenarios, and the SHA-256 of all its splits."""

    name: str  # "development", "test" or "seed N"
    sha256: str

    @property
    def title(self) -> str:
        """Name as it stands in a sentence."""
        return f"{self.name} set" if self.name in (DEVELOPMENT_NAME, TEST_NAME) else f"fresh set of {self.name}"

    @property
    def note(self) -> str:
        """Sentence about the worth of its numbers."""
        if self.name == DEVELOPMENT_NAME:
            return "Scenarios of the development set, on which controllers and agents may be chosen: no test results."
        if self.name == TEST_NAME:
            return "Scenarios of the test set, drawn once. Nothing was chosen on it (docs/benchmark/protocol.md)."
        return f"Scenarios drawn afresh from {self.name}, by the rules of the test set, but not the test set."

    def note_with(self, own: Sequence[str]) -> str:
        """Sentences about the worth of its numbers where methods take part that the protocol does not know."""
        if self.name != TEST_NAME or not own:
            return self.note
        unknown = f"This does not hold for {', '.join(own)}, which the protocol does not know"
        return f"{self.note} {unknown}: choose on --scenarios development, and come here once."


@dataclass(frozen=True, slots=True)
class ScenarioSet:
    """All splits of one set of scenarios, by name."""

    label: SetLabel
    splits: dict[str, Split]

    def only(self, names: Sequence[str], episodes: int = EPISODES, moves: int = MOVES) -> ScenarioSet:
        """Some of its splits, under the same label; those of a fresh set with more scenarios, if so many are wanted.

        Shifts have only their first `moves`.
        """
        if episodes <= EPISODES:
            chosen = {name: self.splits[name] for name in names}
        else:
            number = int(self.label.name.removeprefix("seed "))
            chosen = {name: fresh_scenarios(number, name, range(episodes)) for name in names}
        return ScenarioSet(self.label, {name: split.shortened(moves) for name, split in chosen.items()})


def make_set(name: str, splits: dict[str, Split]) -> ScenarioSet:
    """Make a set of scenarios with its SHA-256."""
    content = [EDITION, VERSION, {split.name: split.digest for split in splits.values()}]
    return ScenarioSet(SetLabel(name, digest_of(content)), splits)


def draw_set(name: str, seeds: SeedRange) -> ScenarioSet:
    """Draw all splits of a set from its range of seeds."""
    return make_set(name, {split: draw(split, name, seeds) for split in SPLITS})


@cache
def development_set() -> ScenarioSet:
    """Draw the development set."""
    return draw_set(DEVELOPMENT_NAME, DEVELOPMENT)


@cache
def fresh_set(number: int) -> ScenarioSet:
    """Draw a set that nobody has seen, by a number of the user's.

    Raises:
        ValueError: If there are no seeds for this number.
    """
    _require_seeds(number)
    return draw_set(f"seed {number}", fresh_arms(number))


def fresh_scenarios(number: int, split: str, chosen: Sequence[int]) -> Split:
    """Draw some scenarios of a split of a fresh set: the first `EPISODES` are those of `fresh_set`, others go on.

    Raises:
        ValueError: If there are no seeds for this set or scenario.
    """
    _require_seeds(number)
    if wrong := [scenario for scenario in chosen if not 0 <= scenario < MOST]:
        raise ValueError(f"scenarios of a fresh set have the numbers 0 to {MOST - 1}, got {wrong[0]}")
    near, far = first_seed(split, fresh_arms(number)), first_seed(split, further_arms(number), MOST)
    seeds = [(near if scenario < EPISODES else far) + scenario for scenario in chosen]
    return draw_arms(split, f"seed {number}", seeds)


def _require_seeds(number: int) -> None:
    if not 0 <= number <= MAX_FRESH_SEED:
        raise ValueError(f"--scenario-seed must lie within 0 and {MAX_FRESH_SEED}, got {number}")


# File of the test set

FILE = Path(__file__).with_name("scenarios.json")
PROTOCOL = Path(__file__).resolve().parents[2] / "docs" / "benchmark" / "protocol.md"
_FORMAT, _REMEDY = "beltarm-scenarios", "restore scenarios.json from the repository"
_CHECKED = 3  # scenarios of a split whose motion is kept, to notice a changed physics
_AGREEMENT = 1e-6  # relative, of kept and fresh numbers: far above rounding, far below any change that matters


def choose_set(name: str | None = None, seed: int | None = None) -> ScenarioSet:
    """Choose a set of scenarios: by its name, by a seed of the user's, or the test set as soon as it is there.

    Raises:
        ValueError: If both are given, the name is unknown, or the file of the test set is missing or damaged.
    """
    if seed is not None:
        if name is not None:
            raise ValueError(f"--scenario-seed {seed} draws a set of its own: leave out --scenarios {name}")
        return fresh_set(seed)
    name = name or (TEST_NAME if FILE.exists() else DEVELOPMENT_NAME)
    if name not in (DEVELOPMENT_NAME, TEST_NAME):
        raise ValueError(f"--scenarios must be {DEVELOPMENT_NAME} or {TEST_NAME}, got {name!r}")
    return development_set() if name == DEVELOPMENT_NAME else load(FILE)


def set_of(results: dict[str, Any], path: Path) -> ScenarioSet:
    """Choose the set that a results.json is of, which this checkout must have.

    Raises:
        ValueError: If the set has other scenarios here.
    """
    label = SetLabel(**results["scenario_set"])
    fresh = re.fullmatch(r"seed (\d+)", label.name)
    known = choose_set(None, int(fresh[1])) if fresh else choose_set(label.name)
    if known.label != label:
        raise ValueError(f"{path} is of other scenarios than this checkout's {known.label.title}: run it again")
    return known


class _Probe:
    """Weak servo with a slow wave on top: moves arms by what their sensors say."""

    _ANGLE, _SPEED, _TIME = index("motor_angle_error"), index("motor_speed_error"), index("elapsed_time")

    def predict(self, observation: Any, *_: Any, **__: Any) -> Any:
        """Torque over its limit; see `Controller`."""
        wave = 0.2 * np.sin(20 * observation[:, self._TIME])
        action = 0.1 * observation[:, self._ANGLE] + 0.05 * observation[:, self._SPEED] + wave
        return action[:, None].astype(np.float32), None


def motions(splits: Sequence[Split]) -> list[list[list[float]]]:
    """Last state, cost and RMS tip error of each split's first scenarios under a fixed simple controller.

    Of shifts those of the last move.
    """
    by_place: dict[int, list[list[float]]] = {}
    for group in beside_one_another(splits):
        together = side_by_side([(splits[k], slice(_CHECKED)) for k in group])
        run = rollout(_Probe(), len(together.table), **together.arguments(slice(None)))
        last = run.of_move(run.num_moves - 1)
        rows = np.column_stack([last.state[-1], last.cost, last.metrics()["tip_rms_mm"]])
        by_place |= zip(group, rows.reshape(len(group), _CHECKED, -1).tolist(), strict=True)
    return [by_place[k] for k in range(len(splits))]


def content_of(scenarios: ScenarioSet, protocol: str) -> dict[str, Any]:
    """Content of the file of the test set, with the protocol's commit."""
    splits, entries = list(scenarios.splits.values()), dict[str, Any]()
    for split, moved in zip(splits, motions(splits), strict=True):
        about = {"description": SPLITS[split.name].description, "seed": split.seed, "count": len(split.seeds)}
        entries[split.name] = {**about, "motions": moved, "sha256": split.digest}
    origin = {"command": "python eval/scenarios.py --freeze-test", "protocol": protocol}
    content = {"format": _FORMAT, "edition": EDITION, "version": VERSION, **origin, "splits": entries}
    return {**content, "sha256": digest_of(content)}


def text_of(content: dict[str, Any]) -> str:
    """JSON with a line for each list of numbers."""
    lists = re.compile(r"\[[^][{}]*\]")
    return lists.sub(lambda numbers: " ".join(numbers[0].split()), json.dumps(content, indent=1)) + "\n"


def freeze_test_set(path: Path) -> None:
    """Draw the test set from the hash of the last commit of the protocol, and write its file.

    Raises:
        ValueError: If the file is there already, or the protocol is not committed.
    """
    if path.exists():
        raise ValueError(f"{path} is there already: the test set is drawn once, and not again")
    protocol = last_commit_of(PROTOCOL)
    write_text(path, text_of(content_of(draw_set(TEST_NAME, arms_chosen_by(protocol)), protocol)))


def load(path: Path) -> ScenarioSet:
    """Read the test set from its file.

    Raises:
        ValueError: If the file is missing, damaged, changed by hand, of another version, or not of the seeds that its
            protocol's commit chooses.
    """
    content = _read(path)
    try:
        seeds = arms_chosen_by(content["protocol"])
        splits = {name: _split_of(name, entry) for name, entry in content["splits"].items()}
        if wrong := [name for name, split in splits.items() if split.seed != first_seed(name, seeds)]:
            raise ValueError(f"the seed of {wrong[0]} is not the one that the protocol's commit chooses")
        return make_set(TEST_NAME, splits)
    except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
        raise ValueError(f"{path} does not hold what it should ({in_a_line(repr(error), 120)}): {_REMEDY}") from None


def _read(path: Path) -> dict[str, Any]:
    """Content of the file of the test set, of this version and as it was written."""
    try:
        content = loads(read_text(path))
    except (OSError, ValueError) as error:
        raise ValueError(f"{path} cannot be read ({in_a_line(error)}): {_REMEDY}") from None
    if not isinstance(content, dict) or content.get("format") != _FORMAT:
        raise ValueError(f"{path} is no file of {_FORMAT}: {_REMEDY}")
    if content.get("version") != VERSION:
        version = in_a_line(repr(content.get("version")), 80)
        raise ValueError(f"{path} has version {version}, this checkout needs {VERSION}: {_REMEDY}")
    if content.get("sha256") != digest_of({key: value for key, value in content.items() if key != "sha256"}):
        raise ValueError(f"{path} was changed after it was written, its SHA-256 does not match: {_REMEDY}")
    return content


def _split_of(name: str, entry: dict[str, Any]) -> Split:
    """Split whose scenarios are drawn again from their seeds."""
    count = entry["count"]
    if type(count) is not int or not 0 < count <= EPISODES:
        raise ValueError(f"the number of scenarios of {name} is {count!r}")
    split = draw_arms(name, TEST_NAME, range(entry["seed"], entry["seed"] + count))
    if split.digest != entry["sha256"]:
        raise ValueError(f"the SHA-256 of {name} does not match: it is drawn otherwise than it was")
    return split


def require_same_physics(scenarios: ScenarioSet) -> None:
    """Check that the arms still move as they did when the test set was written, on the splits of some scenarios.

    Raises:
        ValueError: Naming the first split in which they do not.
    """
    if not FILE.exists():
        return
    entries = _read(FILE)["splits"]
    whole = all(len(split.tables) == SPLITS[name].moves for name, split in scenarios.splits.items())
    known = scenarios if scenarios.label.name == TEST_NAME and whole else load(FILE)
    splits = [known.splits[name] for name in scenarios.splits if name in entries]
    for split, moved in zip(splits, motions(splits), strict=True):
        fresh, kept = np.array(moved), np.array(entries[split.name]["motions"])
        if not np.allclose(fresh, kept, rtol=_AGREEMENT, atol=_AGREEMENT):
            raise ValueError(
                f"on split {split.name} the arms move otherwise than when {FILE.name} was written, by up to "
                f"{np.abs(fresh - kept).max():.2g}: the physics, the sensors or the cost has changed; raise VERSION in "
                "eval/comparison/splits.py"
            )
