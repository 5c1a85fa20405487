"""Price of the margins: gains found by the same search with and without the condition, on the same arms.

Those without lie in `baselines/gains_without_margins.json`, which only this study reads. They are made by

    python baselines/tune.py --all --no-margins --budget 8000000 --out baselines/gains_without_margins.json
        --journals results/tune-without-margins

with the seed and budget of those with.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from baselines import TUNABLE
from baselines.gains import FILE, read_file, tuned
from baselines.loops.condition import LeastMargins, least_margins
from beltarm_env.arrays import Floats
from eval.loops.costs import blind, built_arms, run_arms

WITHOUT = FILE.with_name("gains_without_margins.json")
"""Gains found without margins."""


@dataclass(frozen=True)
class Price:
    """One controller with and without margins."""

    kept: Floats  # cost with margins, shape (n,)
    free: Floats  # without
    margins: LeastMargins  # of the gains without


def price(name: str, kept: Floats) -> Price | None:
    """Run a controller with the gains found without margins on arms as they are built.

    Args:
        name: Of the controller.
        kept: What it costs with its own gains, shape (n,).

    Returns:
        None if there are no gains without margins, or they are not comparable: of another law, seed or budget.

    Raises:
        ValueError: If the file of gains is damaged.
    """
    found = _search(name, WITHOUT)
    if found is None or found != _search(name, FILE):
        return None
    free = TUNABLE[name].controller(tuned(name, TUNABLE[name].gains, WITHOUT))
    return Price(kept, run_arms(blind(free), built_arms(len(kept))).cost, least_margins(free))


def _search(name: str, path: Path) -> tuple[object, ...] | None:
    """What makes two searches comparable: names of the gains, seed and budget; None if there was none."""
    entry = read_file(path).get(name)
    return entry and (sorted(entry["gains"]), *(entry["provenance"].get(key) for key in ("seed", "budget")))
