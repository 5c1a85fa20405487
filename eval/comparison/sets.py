"""Sets of scenarios: for development, for the test, and fresh ones for anybody.

    development   drawn on the fly; controllers and agents may be chosen on it: its numbers are no test results
    test          drawn once, after controllers, agents and protocol are frozen, from seeds that the hash of the
                  protocol's commit chooses, and kept in a file (`eval.comparison.scenarios`)
    seed N        drawn on the fly by the rules of the test set, from seeds that nothing else uses; the only one with
                  further scenarios, as many as anybody wants

All are made alike, each from a range of seeds of its own (`beltarm_env.task.seeds`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

from beltarm_env.task.seeds import (
    DEVELOPMENT,
    MAX_FRESH_SEED,
    SeedRange,
    fresh_arms,
    further_arms,
)
from eval.comparison.splits import (
    EDITION,
    EPISODES,
    SPLITS,
    VERSION,
    Split,
    digest_of,
    draw,
    draw_arms,
    first_seed,
)

DEVELOPMENT_NAME, TEST_NAME = "development", "test"
MOST = 10_000_000
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
            return "Scenarios of the test set, drawn once, after controllers, agents and protocol were frozen."
        return f"Scenarios drawn afresh from {self.name}, by the rules of the test set, but not the test set."

    def note_with(self, own: Sequence[str]) -> str:
        """Sentences about the worth of its numbers where methods take part that the protocol does not know."""
        if self.name != TEST_NAME or not own:
            return self.note
        return (
            f"{self.note} This does not hold for {', '.join(own)}, which the protocol does not know: choose on "
            "--scenarios development, and come here once."
        )


@dataclass(frozen=True, slots=True)
class ScenarioSet:
    """All splits of one set of scenarios, by name."""

    label: SetLabel
    splits: dict[str, Split]

    def only(self, names: Sequence[str], episodes: int = EPISODES) -> ScenarioSet:
        """Some of its splits, under the same label; those of a fresh set with more scenarios, if so many are wanted."""
        if episodes <= EPISODES:
            return ScenarioSet(self.label, {name: self.splits[name] for name in names})
        number = int(self.label.name.removeprefix("seed "))
        return ScenarioSet(self.label, {name: fresh_scenarios(number, name, range(episodes)) for name in names})


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
