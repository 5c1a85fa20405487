"""Scores of a policy from the `results.json` of a comparison: for the Hub's model index, and in Markdown for people."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from agents.policy.bundle import ENVIRONMENT, load_controller, read_spec
from baselines.tools.files import sha256_of
from baselines.tools.provenance import commit
from beltarm_env.arrays import Floats
from beltarm_env.metrics import NOT_ARRIVED, heading
from beltarm_env.rollout import rollout
from eval.comparison.methods import learned_names
from eval.comparison.results import PAIRED_METRICS
from eval.comparison.schema import AGAINST, read_results
from eval.comparison.sets import set_of
from eval.comparison.splits import EPISODES, main_split
from eval.exports.source import TEMPLATES
from eval.report.table import Record, Results, estimate
from eval.report.text import cell, markdown_table
from eval.report.verdict import PRACTICALLY_EQUAL, Result, is_tie

if TYPE_CHECKING:
    from huggingface_hub import EvalResult

SHOWN = (*PAIRED_METRICS, "settling_s", "failure_share", NOT_ARRIVED)
"""Metrics of the card."""


@dataclass(frozen=True)
class Scores:
    """Scores of the method that a policy belongs to, and the reward of the policy itself.

    A method of learning has a policy for each training seed, and a comparison scores all of them together. The Hub
    ranks agents by the reward of one policy, summed over an episode: it is run once more, on the comparison's scenarios
    of the main split, the first `EPISODES` of them.
    """

    results: Results
    digest: str  # SHA-256 of results.json
    method: str
    rewards: Floats  # of the policy, summed over all moves of each scenario of the main split

    @property
    def mean_reward(self) -> str:
        """Mean and standard deviation, as the Hub ranks them."""
        return f"{np.mean(self.rewards):.2f} +/- {np.std(self.rewards):.2f}"

    @property
    def rows(self) -> dict[str, Record]:
        """Rows of the method by split, the main one first."""
        rows = {split: row for (method, split), row in self.results.records.items() if method == self.method}
        home = main_split(list(rows))
        return {home: rows[home], **rows}


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
    scores = Scores(Results(results), sha256_of(path), method, np.empty(0))
    home, row = next(iter(scores.rows.items()))
    count = min(row["episodes"], EPISODES)  # a fresh set may have more than fit into memory at once
    arguments = set_of(results, path).splits[home].shortened(row["moves"]).arguments(slice(count))
    run = rollout(load_controller(policy), count, sensors=read_spec(policy)[0].sensors, **arguments)
    return replace(scores, rewards=-run.num_moves * run.over_moves(run.cost))


def _method_of(digest: str, results: Mapping[str, Any], path: Path) -> str | None:
    """Name of the method that a policy belongs to: results list the policies of all methods in their order."""
    ran = results["provenance"].get("policies", [])
    if digest not in ran:
        return None
    rows = [row for row in results["rows"] if row["kind"] == "learned"]
    whole = max((row["split"] for row in rows), key=[row["split"] for row in rows].count, default="")
    seeds = {row["method"]: row["seeds"] for row in rows if row["split"] == whole}  # in the order of the policies
    owners = [name for name, count in seeds.items() for _ in range(count)]
    if len(owners) != len(ran):
        raise ValueError(f"{path} lists {len(ran)} policies, its rows have {len(owners)}: run the comparison again")
    own = [name for name, hashed in zip(owners, ran, strict=True) if hashed == digest]
    return next((name for name in own if not name.endswith("+guard")), None)


def eval_results(scores: Scores) -> list["EvalResult"]:
    """Entries of the Hub's model index: the cost on every split, and first `mean_reward`, where its rankings look."""
    from huggingface_hub import EvalResult

    entries = []
    for split, row in scores.rows.items():
        common: dict[str, Any] = dict.fromkeys(("task_type", "task_name"), "reinforcement-learning")
        common |= {"dataset_type": ENVIRONMENT, "dataset_name": f"{ENVIRONMENT} {split}"}
        common |= {"dataset_config": split, "dataset_split": scores.results.label.name}
        if not entries:
            name = "mean_reward"
            entries.append(EvalResult(**common, metric_type=name, metric_name=name, metric_value=scores.mean_reward))
        label = f"cost: interquartile mean over training seeds and {row['episodes']} scenarios"
        value = row["metrics"]["cost"]["iqm"]
        entries.append(EvalResult(**common, metric_type="cost", metric_name=label, metric_value=value))
    return entries


def _result(results: Results, pair: Mapping[str, Any]) -> Result:
    """Result of a pair in cost: that of the primary comparison, where it is of this pair.

    Otherwise a difference takes a p value after Holm's correction, and a mean difference of the same sign.
    """
    ours = ("cost", pair["split"], pair["method"], pair["other"])
    for row in results.content.get("primary", []):
        if tuple(row[key] for key in ("metric", "split", "challenger", "classical")) == ours:
            return row["result"]
    own, other = (results.records[pair[key], pair["split"]]["cost_mean"] for key in ("method", "other"))
    cost = pair["metrics"]["cost"]
    shown = cost["p_holm"] < 0.05 and cost["iqm"] * (own - other) > 0
    return ("better" if cost["iqm"] < 0 else "worse") if shown else "open"


def markdown(scores: Scores) -> str:
    """Scores of a card for people: splits where a classical controller is better, a table, and how it was made."""
    rows, results = scores.rows, scores.results
    home, first = next(iter(rows.items()))
    shown = [name for name in SHOWN if name != NOT_ARRIVED or name in first["metrics"]]
    table, costs, tied = [], dict[str, str](), list[str]()
    for split, row in rows.items():
        best = ["–", "–"]
        if pair := results.against(AGAINST[0], split).get(scores.method):
            other, result = pair["other"], _result(results, pair)
            level = estimate(results.records[other, split], "cost").iqm
            tied += [split] if is_tie("cost", result, estimate(pair, "cost").iqm / level) else []
            costs[split], words = result, result.replace("open", "no difference shown")
            best = [f"`{other}` {level:.0f}", f"{cell('cost', estimate(pair, 'cost'))}: {words}"]
        table.append([split, *(cell(name, estimate(row, name)) for name in shown), *best])
    return TEMPLATES.get_template("card_scores.md.j2").render(
        scores=scores,
        costs=costs,
        tied=tied,
        tie=100 * PRACTICALLY_EQUAL,
        table=markdown_table(["split", *map(heading, shown), "best classical", "difference in cost"], table),
        note=results.label.note_with([] if scores.method in learned_names() else [scores.method]),
        home=home,
        row=first,
        provenance=results.content["provenance"],
        commit=commit(),
    )
