"""Scores on a policy's card: as the Hub's model index, and as Markdown, which begins with where the policy loses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

from agents.policy.card import ENVIRONMENT
from baselines.tools.provenance import commit
from beltarm_env.metrics import METRICS, NOT_ARRIVED, heading
from eval.comparison.methods import shipped_policies
from eval.comparison.results import PAIRED_METRICS
from eval.report.text import cell, markdown_table
from eval.sharing.scores import Scores

SHOWN = (*PAIRED_METRICS, "settling_s", "failure_share", NOT_ARRIVED)
_FEW = "too few scenarios"
_TASK = "reinforcement-learning"


def model_index(scores: Scores) -> list[dict[str, Any]]:
    """Entries of the Hub's model index, one per split; `mean_reward` comes first, where the Hub's rankings look."""
    entries = []
    for split, row in scores.rows().items():
        metrics = [
            {
                "type": name,
                "name": f"{_label(name)}: {_average(name)} over {row['seeds']} training seed{'s'[: row['seeds'] > 1]}",
                "value": row["metrics"][name]["iqm"],
                "args": {"low": row["metrics"][name]["low"], "high": row["metrics"][name]["high"]},
            }
            for name in SHOWN
            if name in row["metrics"]
        ]
        if not entries:
            metrics.insert(0, {"type": "mean_reward", "name": "mean_reward", "value": scores.reward.text})
        dataset = {
            "type": ENVIRONMENT,
            "name": f"{ENVIRONMENT} {split}",
            "config": split,
            "split": scores.label.name,
            "args": {"episodes": row["episodes"], "sha256": scores.results["provenance"]["split_sha256"][split]},
        }
        entries.append({"task": {"type": _TASK, "name": _TASK}, "dataset": dataset, "metrics": metrics})
    return entries


def _label(name: str) -> str:
    """A metric with the unit of its value."""
    return f"{METRICS[name].title}, as a share" if METRICS[name].share else heading(name)


def _average(name: str) -> str:
    return "mean" if METRICS[name].share else "interquartile mean"


def markdown(scores: Scores) -> str:
    """Where the policy loses, a table of all splits, and how the numbers were made."""
    rows, pairs, best = scores.rows(), scores.against_best(), scores.best()
    home, row = next(iter(rows.items()))
    of = f"{row['seeds']} policies that differ in their training seed, this one among them"
    shown = [name for name in SHOWN if name in row["metrics"] or name != NOT_ARRIVED]  # older files do not tell it
    titles = ["split", *map(heading, shown), "best classical", "difference in cost"]
    cells = [
        [split, *(_estimate(row, name) for name in shown)]
        + (_beside(best[split], pairs[split]) if split in pairs else ["–", "–"])
        for split, row in rows.items()
    ]
    provenance = scores.results["provenance"]
    shipped = {folder.parent.name for folder in shipped_policies()}
    note = scores.label.note_with([] if scores.method in shipped else [scores.method])
    parts = [
        f"**Where it loses.** {losses(scores.method, pairs)}",
        "## Scores",
        f"Of `{scores.method}`, {of if row['seeds'] > 1 else 'this policy'}: interquartile means (of shares: means) "
        f"with 95 % intervals over {row['episodes']} scenarios of each split. Lower is better. {note}",
        markdown_table(titles, cells),
        "*Best classical* is the classical controller of the lowest cost on that split, with its cost. The difference "
        "is this method's cost minus its, scenario by scenario. *Better* and *worse*: p < 0.05, and the "
        "95 % interval of that difference is clear of zero.",
        f"`mean_reward` is of this policy alone: {scores.reward.text}, mean and standard deviation over "
        f"{scores.reward.episodes} scenarios of `{home}`, run on commit {commit()} as this card was written. All other "
        f"numbers are from `{provenance['command']}`, commit {provenance['commit']}, scenarios "
        f"{scores.label.sha256[:12]}. The SHA-256 of its results.json begins with {scores.digest[:12]}.",
    ]
    return "\n\n".join(parts)


def _estimate(row: Mapping[str, Any], name: str) -> str:
    """Cell of a metric; a dash where no arm arrives."""
    return cell(name, SimpleNamespace(**row["metrics"][name])) if name in row["metrics"] else "–"


def _beside(best: Mapping[str, Any], pair: Mapping[str, Any]) -> list[str]:
    """Cells about the best classical controller of a split."""
    cost = pair["metrics"]["cost"]
    return [
        f"`{best['method']}` {best['metrics']['cost']['iqm']:.0f}",
        f"{cell('cost', SimpleNamespace(**cost))}: {cost['verdict']}",
    ]


def losses(method: str, pairs: Mapping[str, Mapping[str, Any]]) -> str:
    """Sentences on where the best classical controller is shown to be better, or is not shown to differ.

    Args:
        method: Its name.
        pairs: By split its paired comparison with that controller.
    """
    if not pairs:
        return "That is not known: no classical controller took part in its comparison."
    few = {split for split, row in pairs.items() if row["metrics"]["cost"]["verdict"] == _FEW}
    if few:
        return f"That is not known: there were too few scenarios on {_listed(sorted(few), len(pairs))}."
    found = {}
    for verdict in ("worse", "no difference shown"):
        places = {name: [s for s, row in pairs.items() if _verdict(row, name) == verdict] for name in PAIRED_METRICS}
        found[verdict] = "; ".join(
            f"in {METRICS[name].title} on {_listed(on, len(pairs))}" for name, on in places.items() if on
        )
    worse = found["worse"] or f"on none of {len(pairs)} splits"
    sentences = [f"`{method}` is worse than the best classical controller {worse}."]
    if same := found["no difference shown"]:
        sentences.append(f"It is not shown to differ {same}.")
    if away := [split for split, row in pairs.items() if _verdict(row, "residual_pp_mm") in ("", _FEW)]:
        sentences.append(f"On {_listed(away, len(pairs))} the two arrive too seldom to compare their vibration.")
    return " ".join(sentences)


def _verdict(row: Mapping[str, Any], name: str) -> str:
    """Verdict of a paired comparison in a metric; empty where both methods arrive too seldom for one."""
    return row["metrics"].get(name, {}).get("verdict", "")


def _listed(splits: Sequence[str], total: int) -> str:
    return f"all {total} splits" if len(splits) == total else ", ".join(f"`{split}`" for split in splits)
