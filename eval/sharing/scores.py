"""Scores of one policy from the `results.json` of a comparison.

A comparison scores methods. A method of learning has a policy for each training seed, and its scores are of all of
them. `mean_reward`, by which the Hub ranks agents, is of the one policy that is shared: it is run once more, on the
comparison's scenarios of the main split.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from agents.policy.bundle import load_controller, read_spec
from baselines.tools.files import sha256_of
from beltarm_env.rollout import rollout
from eval.comparison.scenarios import choose_set
from eval.comparison.schema import AGAINST, read_results
from eval.comparison.sets import ScenarioSet, SetLabel, fresh_set
from eval.comparison.splits import Split, main_split

_GUARDED = "+guard"


@dataclass(frozen=True, slots=True)
class Return:
    """Reward of a policy over whole episodes, in the words of Stable-Baselines3's `evaluate_policy`."""

    mean: float
    std: float
    episodes: int

    @property
    def text(self) -> str:
        """As the Hub ranks it."""
        return f"{self.mean:.2f} +/- {self.std:.2f}"


@dataclass(frozen=True, slots=True)
class Scores:
    """Scores of the method that a policy belongs to, and of the policy itself."""

    results: Mapping[str, Any]  # content of results.json
    digest: str  # SHA-256 of that file
    method: str
    reward: Return  # of the policy itself, on the main split

    @property
    def label(self) -> SetLabel:
        """Set of scenarios."""
        return SetLabel(**self.results["scenario_set"])

    def rows(self) -> dict[str, dict[str, Any]]:
        """The method's rows by split, the main one first."""
        found = {row["split"]: row for row in self.results["rows"] if row["method"] == self.method}
        home = main_split(list(found))
        return {home: found[home], **found}

    def against_best(self) -> dict[str, dict[str, Any]]:
        """By split the paired comparison with the best classical controller, where one took part."""
        wanted = (self.method, AGAINST[0])
        return {row["split"]: row for row in self.results["paired"] if (row["method"], row["against"]) == wanted}

    def best(self) -> dict[str, dict[str, Any]]:
        """Rows of the best classical controllers by split, where one took part."""
        wanted = {(row["other"], split) for split, row in self.against_best().items()}
        return {row["split"]: row for row in self.results["rows"] if (row["method"], row["split"]) in wanted}

    def excerpt(self) -> dict[str, Any]:
        """What a card's numbers rest on, after the entries that `huggingface_sb3` writes of its own agents."""
        return {
            "mean_reward": self.reward.mean,
            "std_reward": self.reward.std,
            "is_deterministic": True,
            "n_eval_episodes": self.reward.episodes,
            "method": self.method,
            "results_sha256": self.digest,
            **{name: self.results[name] for name in ("edition", "version", "scenario_set", "provenance", "verdict")},
            "rows": [*self.rows().values(), *self.best().values()],
            "paired": [row for row in self.results["paired"] if row["method"] == self.method],
        }


def scores_of(policy: Path, content_hash: str, path: Path) -> Scores | None:
    """Read the scores of a policy, and run it for its mean reward.

    Args:
        policy: Its folder.
        content_hash: Of its manifest, by which results know it.
        path: `results.json` of a comparison.

    Returns:
        The scores; None where the policy took no part in the comparison.

    Raises:
        ValueError: If the results are damaged, or of other scenarios than this checkout has.
    """
    results = read_results(path)
    method = _method_of(content_hash, results, path)
    if method is None:
        return None
    rows = {row["split"]: row for row in results["rows"] if row["method"] == method}
    home = main_split(list(rows))
    split = _scenarios(SetLabel(**results["scenario_set"]), path).splits[home]
    return Scores(results, sha256_of(path), method, run_alone(policy, split, rows[home]["episodes"]))


def run_alone(policy: Path, split: Split, episodes: int) -> Return:
    """Run one policy on the first scenarios of a split."""
    controller = load_controller(policy)
    spec, _ = read_spec(policy)
    run = rollout(controller, episodes, **with_sensors(split, spec.sensors).arguments(slice(episodes)))
    return Return(-float(np.mean(run.cost)), float(np.std(run.cost)), episodes)


def with_sensors(split: Split, sensors: str) -> Split:
    """Return the same scenarios for a controller with other sensors."""
    return replace(split, settings={**split.settings, "sensors": sensors})


def _method_of(content_hash: str, results: Mapping[str, Any], path: Path) -> str | None:
    """Name of the method that a policy belongs to: results list the policies of all methods in their order."""
    ran = results["provenance"].get("policies", [])
    if content_hash not in ran:
        return None
    seeds = {row["method"]: row["seeds"] for row in results["rows"] if row["kind"] == "learned"}
    owners = [name for name, count in seeds.items() for _ in range(count)]
    if len(owners) != len(ran):
        raise ValueError(f"{path} lists {len(ran)} policies, its rows have {len(owners)}: run the comparison again")
    own = [name for name, hashed in zip(owners, ran, strict=True) if hashed == content_hash]
    return next((name for name in own if not name.endswith(_GUARDED)), None)


def _scenarios(label: SetLabel, path: Path) -> ScenarioSet:
    """The scenarios that results are of."""
    fresh = re.fullmatch(r"seed (\d+)", label.name)
    found = fresh_set(int(fresh[1])) if fresh else choose_set(label.name)
    if found.label != label:
        raise ValueError(f"{path} is of other scenarios than this checkout's {label.title}: run the comparison again")
    return found
