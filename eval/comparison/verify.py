"""Verification of results: what a results.json claims is run again, and has to come out as it says."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from eval.comparison.custom import TIME_LIMIT
from eval.comparison.methods import PRIVILEGED, classical_methods, learned_methods, shipped_policies
from eval.comparison.run import choose_methods, compare
from eval.comparison.scenarios import choose_set
from eval.comparison.schema import read_results, to_json
from eval.comparison.sets import ScenarioSet, SetLabel, enlarged_set
from eval.comparison.splits import EPISODES

TOLERANCES = {
    "interquartile mean of the cost": 0.003,
    "mean cost": 0.005,
    "worst 5 % of the cost": 0.02,
    "share not settled": 0.005,
    "share out of the workspace": 0.005,
}
"""Differences that are allowed between processors: of costs relative, of shares absolute.

Processors round differently, and where a motor sticks is decided by a hair. First torques that differ by 1e-9 N m, more
than rounding does, changed average costs of `paper`, `mpc`, `adaptive` and a seed of `student` over 500 scenarios of
each split of the development set (`student`: all but `structural`) by less than a tenth of these tolerances."""
_SHARES = ("share not settled", "share out of the workspace")


class Difference(NamedTuple):
    """A number of a method on a split, as it is claimed and as it came out."""

    method: str
    split: str
    quantity: str
    claimed: float
    measured: float

    @property
    def excess(self) -> float:
        """Size over the tolerance."""
        size = abs(self.measured - self.claimed) / (1.0 if self.quantity in _SHARES else abs(self.claimed))
        return size / TOLERANCES[self.quantity]

    def __str__(self) -> str:
        """The numbers, in words."""
        numbers = f"claimed {self.claimed:.6g}, here {self.measured:.6g}"
        return (
            f"{self.method} on {self.split}, {self.quantity} of the cost: {numbers}, {self.excess:.2g} of the tolerance"
        )


def verify(
    folder: Path,
    policies: Sequence[str] = (),
    added: Sequence[str] = (),
    jobs: int | None = None,
    *,
    time_limit: float = TIME_LIMIT,
    done: Callable[[int, int], object] = lambda *_: None,
) -> list[Difference]:
    """Run again what the results.json of a folder claims, in a temporary folder.

    Args:
        folder: Of a comparison.
        policies: See `choose_methods`; by default those of the command that the results name.
        added: Likewise.
        jobs: Number of processes, by default one per core.
        time_limit: Time that a controller of the user's own may take for a batch of episodes [s].
        done: Called with the number of parts that are done, and of all.

    Returns:
        All numbers that have a tolerance, in the order of the results.

    Raises:
        ValueError: If the results are of other scenarios or of files that no commit has, or a method is not there or
            fails.
    """
    path = folder / "results.json"
    claimed = read_results(path)
    require_clean(claimed, path)
    scenarios = scenarios_of(claimed, path)
    names = list(dict.fromkeys(row["method"] for row in claimed["rows"]))
    command = shlex.split(claimed["provenance"]["command"])
    project = {method.name for method in (*classical_methods(), *learned_methods(shipped_policies()))} | {PRIVILEGED}
    known = choose_methods(
        [name for name in project if name in {each.removesuffix("+guard") for each in names}] or ("paper",),
        policies or _given(command, "--policy"),
        added or _given(command, "--add"),
        guard=any(name.endswith("+guard") for name in names),
        time_limit=time_limit,
    )
    methods = {method.name: method for method in known}
    if missing := [name for name in names if name not in methods]:
        raise ValueError(f"{path} has results of {missing[0]}, which is not here: give it with --add or --policy")
    with TemporaryDirectory(prefix="beltarm-") as temporary:
        chosen = [methods[name] for name in names]
        comparison = compare(chosen, scenarios, claimed["rows"][0]["episodes"], Path(temporary), jobs, done=done)
    for failure in comparison.failures:
        raise ValueError(f"{failure.method} failed on {failure.split}: {failure.message}")
    measured = {(row["method"], row["split"]): row for row in to_json(comparison)["rows"]}
    return [
        Difference(row["method"], row["split"], quantity, value, quantities[quantity])
        for row in claimed["rows"]
        for quantities in [dict(_quantities(measured[row["method"], row["split"]]))]
        for quantity, value in _quantities(row)
    ]


def require_clean(content: dict[str, Any], path: Path) -> None:
    """Check that results are of a commit without changes.

    Raises:
        ValueError: If they are not.
    """
    commit = content["provenance"]["commit"]
    if commit == "unknown" or commit.endswith("-dirty"):
        raise ValueError(f"{path} was measured with files that no commit has ({commit}): commit them, and run it again")


def scenarios_of(content: dict[str, Any], path: Path) -> ScenarioSet:
    """Return the scenarios that results are of.

    Raises:
        ValueError: If this checkout has others.
    """
    label, episodes = SetLabel(**content["scenario_set"]), content["rows"][0]["episodes"]
    fresh = re.fullmatch(r"seed (\d+)", label.name)
    known = choose_set(None, int(fresh[1])) if fresh else choose_set(label.name)
    if known.label != label:
        raise ValueError(
            f"{path} is of other scenarios than this checkout's {known.label.title}: they differ in SHA-256"
        )
    splits = list(dict.fromkeys(row["split"] for row in content["rows"]))
    return enlarged_set(int(fresh[1]), splits, episodes) if fresh and episodes > EPISODES else known.only(splits)


def _given(command: Sequence[str], option: str) -> list[str]:
    """Values of an option in a command line."""
    return [word for before, word in pairwise(command) if before == option]


def _quantities(row: dict[str, Any]) -> Iterator[tuple[str, float]]:
    """Numbers of a row that have a tolerance."""
    failures = row["failures"]
    yield "interquartile mean of the cost", row["metrics"]["cost"]["iqm"]
    for quantity, key in (("mean cost", "cost_mean"), ("worst 5 % of the cost", "cost_worst")):
        if key in row:
            yield quantity, row[key]
    for quantity, key in zip(_SHARES, ("not_settled", "left_workspace"), strict=True):
        yield quantity, failures[key] / failures["runs"]
