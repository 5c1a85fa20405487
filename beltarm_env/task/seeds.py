"""Seed ranges: which arms and moves are drawn for what.

An episode is drawn from a seed. Everything that draws episodes has a range of seeds of its own, so that nothing is
tested on what it was trained, tuned or chosen on. Arm i of a range has the seed `first + i`.
"""

from __future__ import annotations

import re
from typing import NamedTuple


class SeedRange(NamedTuple):
    """Seeds `first` to `first + size - 1`."""

    first: int
    size: int


SEED_SPACING = 40_000
"""Seeds between the first arms of two training seeds, and so the most arms that a training run can have."""
MAX_TRAINING_SEED = 4_000_000 // SEED_SPACING - 1


def _part(number: int, most: int, first: int, size: int) -> SeedRange:
    """Part of a range by its number; raises ValueError for one beyond it, where another range begins."""
    if not 0 <= number <= most:
        raise ValueError(f"the number of a range of seeds must be 0 to {most}, got {number}")
    return SeedRange(first + size * number, size)


def training_arms(seed: int) -> SeedRange:
    """Return the seeds of the arms of one training seed, 0 to `MAX_TRAINING_SEED`."""
    return _part(seed, MAX_TRAINING_SEED, 0, SEED_SPACING)


TRAINING = SeedRange(0, SEED_SPACING * (MAX_TRAINING_SEED + 1))
CROSSCHECK = SeedRange(4_000_000, 1_000)
"""The full arm in two engines."""
REPETITION = SeedRange(4_100_000, 1_000)
"""Iterative learning."""
PRESLIDING = SeedRange(4_200_000, 1_000)
"""Friction with bristles beside the located one."""
ABLATIONS = SeedRange(4_300_000, 10_000)
"""Scores of the ablations."""
DRIVE_SIZES = SeedRange(4_400_000, 10_000)
"""Arms whose drives get better and worse, effect by effect."""
OBSERVER = SeedRange(4_500_000, 400_000)
"""Arms that the learned observer is fitted to."""
FAULTS = SeedRange(4_900_000, 10_000)
"""Arms of which something breaks in mid-move."""
GAIN_SEARCH = SeedRange(5_000_000, 500_000)
"""Trials of the gains' tuner."""
GAIN_CHOICE = SeedRange(5_500_000, 500_000)
"""Choice among the tuner's best."""
PAPER_MOVES = SeedRange(6_000_000, 300)
"""Random moves of the paper's reproduction."""
PAPER_DRIVES = SeedRange(6_100_000, 100)
"""Drives of the paper's arm: phases, orders and signs."""
PROTOCOL_CHECK = SeedRange(6_900_000, 5)
"""Arms that a controller of one's own is checked on."""
VALIDATION = SeedRange(7_000_000, 500_000)
"""Validation of training runs: checkpoints and settings are chosen on these."""
LOOPS = SeedRange(7_500_000, 100_000)
"""Costs and times of the classical controllers, and the clairvoyant optimum."""
FIRST_EDITION = SeedRange(8_000_000, 200_000)
"""Test scenarios of the comparison's first edition: known to all since, so that nothing else draws from them."""
DEVELOPMENT = SeedRange(8_600_000, 100_000)
"""Scenarios of the comparison while controllers and agents are worked on; every other set has as many seeds."""
DATASET_SPACING = 50_000
"""Seeds between the first episodes of two datasets, and so the most episodes that one can have."""
DATASETS = SeedRange(9_000_000, 900_000)
"""Episodes of datasets for offline learning."""
MAX_DATASET_SEED = DATASETS.size // DATASET_SPACING - 1
DATASET_SCORES = SeedRange(9_900_000, 10_000)
"""Arms that a dataset's scores are related to."""
FRESH = SeedRange(10_000_000, 1_000_000_000_000)
"""Sets of scenarios that anybody draws afresh, by the test scenarios' rules."""
MAX_FRESH_SEED = FRESH.size // DEVELOPMENT.size - 1
_HASHES = 2**32  # of the first eight digits of a commit's hash
TEST = SeedRange(FRESH.first + FRESH.size, _HASHES * DEVELOPMENT.size)
"""Where the comparison's test scenarios are: a commit's hash chooses the place."""
UNUSED = SeedRange(TEST.first + TEST.size, 10**13 * DEVELOPMENT.size)
"""Drawn by nobody: an earlier set of scenarios was to lie here, and what follows keeps its place."""
FURTHER = SeedRange(UNUSED.first + UNUSED.size, (MAX_FRESH_SEED + 1) * 10**8)
"""Scenarios of the fresh sets beyond those that every set has; beyond all others."""


def dataset_arms(seed: int) -> SeedRange:
    """Return the seeds of the episodes of one dataset, 0 to `MAX_DATASET_SEED`."""
    return _part(seed, MAX_DATASET_SEED, DATASETS.first, DATASET_SPACING)


def fresh_arms(number: int) -> SeedRange:
    """Return the seeds of one fresh set of scenarios, 0 to `MAX_FRESH_SEED`."""
    return _part(number, MAX_FRESH_SEED, FRESH.first, DEVELOPMENT.size)


def further_arms(number: int) -> SeedRange:
    """Return the seeds of the further scenarios of one fresh set, 0 to `MAX_FRESH_SEED`."""
    return _part(number, MAX_FRESH_SEED, FURTHER.first, FURTHER.size // (MAX_FRESH_SEED + 1))


def arms_chosen_by(commit: str) -> SeedRange:
    """Return the seeds of the test scenarios that the hash of a commit chooses, by its first eight digits.

    Raises:
        ValueError: If it is no hash.
    """
    if not re.fullmatch("[0-9a-f]{40}", commit):
        raise ValueError(f"the hash of a commit has 40 hexadecimal digits, got {commit!r}")
    return SeedRange(TEST.first + DEVELOPMENT.size * int(commit[:8], 16), DEVELOPMENT.size)


RANGES = {name: value for name, value in vars().items() if isinstance(value, SeedRange)}
"""All of them, by name; disjoint."""
