"""Scores of a policy from the `results.json` of a comparison: for the Hub's model index, and in Markdown for people."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from agents.policy.bundle import ENVIRONMENT, load_controller, read_spec
from baselines.tools.files import sha256_of
from baselines.tools.provenance import commit
from beltarm_env.arrays import Floats
from beltarm_env.metrics import NOT_ARRIVED, heading
from beltarm_env.rollout import rollout
from eval.comparison.methods import shipped_policies
from eval.comparison.results import PAIRED_METRICS
from eval.comparison.schema import AGAINST, read_results
from eval.comparison.sets import SetLabel, set_of
from eval.comparison.splits import main_split
from eval.exports.source import TEMPLATES
from eval.report.text import cell, markdown_table

if TYPE_CHECKING:
    from huggingface_hub import EvalResult

SHOWN = (*PAIRED_METRICS, "settling_s", "failure_share", NOT_ARRIVED)
"""Metrics of the card."""
_GUARDED = "+guard"


@dataclass(frozen=True)
class Scores:
    """Scores of the method that a policy belongs to, and the reward of the policy itself.

    A method of learning has a policy for each training seed, and a comparison scores all of them together. The Hub
    ranks agents by the reward of one policy: it is run once more, on the comparison's scenarios of the main split.
    """

    results: Mapping[str, Any]  # content of results.json
    digest: str  # SHA-256 of that file
    method: str
    rewards: Floats  # of the policy, a number for each scenario of the main split

    @property
    def mean_reward(self) -> str:
        """Mean and standard deviation, as the Hub ranks them."""
        return f"{np.mean(self.rewards):.2f} +/- {np.std(self.rewards):.2f}"

    @cached_property
    def rows(self) -> dict[str, dict[str, Any]]:
        """Rows of the method by split, the main one first."""
        rows = {row["split"]: row for row in self.results["rows"] if row["method"] == self.method}
        home = main_split(list(rows))
        return {home: rows[home], **rows}

    @cached_property
    def against_best(self) -> dict[str, dict[str, Any]]:
        """Pairwise tests against the best classical controller by split, where one took part."""
        wanted = (self.method, AGAINST[0])
        return {row["split"]: row for row in self.results["paired"] if (row["method"], row["against"]) == wanted}

    @cached_property
    def best(self) -> dict[str, dict[str, Any]]:
        """Rows of the best classical controllers by split, where one took part."""
        wanted = {(row["other"], split) for split, row in self.against_best.items()}
        return {row["split"]: row for row in self.results["rows"] if (row["method"], row["split"]) in wanted}


def scores_of(policy: Path, digest: str, path: Path) -> Scores | None:
    """Read the scores of a policy from a `results.json`, which knows it by its SHA-256, and run it for its mean reward.

    Returns None where the policy took no part in the comparison.

    Raises:
        ValueError: If the results are damaged, or of other scenarios than this checkout has.
    """
    results = read_results(path)
    method = _method_of(digest, results, path)
    if method is None:
        return None
    scenarios = set_of(results, path)
    scores = Scores(results, sha256_of(path), method, np.empty(0))
    home, row = next(iter(scores.rows.items()))
    arguments = scenarios.splits[home].shortened(row["moves"]).arguments(slice(row["episodes"]))
    run = rollout(load_controller(policy), row["episodes"], sensors=read_spec(policy)[0].sensors, **arguments)
    return replace(scores, rewards=-run.over_moves(run.cost))


def _method_of(digest: str, results: Mapping[str, Any], path: Path) -> str | None:
    """Name of the method that a policy belongs to: results list the policies of all methods in their order."""
    ran = results["provenance"].get("policies", [])
    if digest not in ran:
        return None
    seeds = {row["method"]: row["seeds"] for row in results["rows"] if row["kind"] == "learned"}
    owners = [name for name, count in seeds.items() for _ in range(count)]
    if len(owners) != len(ran):
        raise ValueError(f"{path} lists {len(ran)} policies, its rows have {len(owners)}: run the comparison again")
    own = [name for name, hashed in zip(owners, ran, strict=True) if hashed == digest]
    return next((name for name in own if not name.endswith(_GUARDED)), None)


def eval_results(scores: Scores) -> list["EvalResult"]:
    """Entries of the Hub's model index: the cost on every split, and first `mean_reward`, where its rankings look."""
    from huggingface_hub import EvalResult

    results = []
    for split, row in scores.rows.items():
        common: dict[str, Any] = {
            "task_type": "reinforcement-learning",
            "task_name": "reinforcement-learning",
            "dataset_type": ENVIRONMENT,
            "dataset_name": f"{ENVIRONMENT} {split}",
            "dataset_config": split,
            "dataset_split": scores.results["scenario_set"]["name"],
        }
        if not results:
            name = "mean_reward"
            results.append(EvalResult(**common, metric_type=name, metric_name=name, metric_value=scores.mean_reward))
        label = f"cost: interquartile mean over training seeds and {row['episodes']} scenarios"
        value = row["metrics"]["cost"]["iqm"]
        results.append(EvalResult(**common, metric_type="cost", metric_name=label, metric_value=value))
    return results


def markdown(scores: Scores) -> str:
    """Scores of a card for people: splits where a classical controller is better, a table, and how it was made."""
    rows, pairs, best = scores.rows, scores.against_best, scores.best
    home, first = next(iter(rows.items()))
    shown = [name for name in SHOWN if name != NOT_ARRIVED or name in first["metrics"]]
    table = []
    for split, row in rows.items():
        cells = [_cell(name, row) for name in shown]
        if split in pairs:
            other, verdict = best[split], pairs[split]["metrics"]["cost"]["verdict"]
            cells.append(f"`{other['method']}` {other['metrics']['cost']['iqm']:.0f}")
            cells.append(f"{_cell('cost', pairs[split])}: {verdict}")
        table.append([split, *cells, *["–"] * (len(shown) + 2 - len(cells))])
    shipped = {folder.parent.name for folder in shipped_policies()}
    label = SetLabel(**scores.results["scenario_set"])
    return TEMPLATES.get_template("card_scores.md.j2").render(
        scores=scores,
        label=label,
        costs={split: row["metrics"]["cost"]["verdict"] for split, row in pairs.items()},
        table=markdown_table(["split", *map(heading, shown), "best classical", "difference in cost"], table),
        note=label.note_with([] if scores.method in shipped else [scores.method]),
        home=home,
        row=first,
        provenance=scores.results["provenance"],
        commit=commit(),
    )


def _cell(name: str, row: Mapping[str, Any]) -> str:
    """Estimate of a metric with its interval; a dash where no arm arrives."""
    return cell(name, SimpleNamespace(**row["metrics"][name])) if name in row["metrics"] else "–"
