"""Made-up outcomes of a comparison."""

from typing import Any

import numpy as np

from beltarm_env.metrics import SHOWN
from eval.comparison.cache import LEFT, Metrics
from eval.comparison.methods import Kind, Method
from eval.comparison.results import Comparison, MethodOutcome, estimated, make_comparison
from eval.comparison.rollouts import Failure
from eval.comparison.schema import to_json
from eval.comparison.sets import SetLabel
from eval.comparison.statistics import Paired
from eval.report.verdict import verdict

ORIGIN = {
    **{"command": "python eval/compare.py --out /tmp/me/out", "beltarm": "1", "version": "1", "inputs": "0"},
    **{"splits_version": 2, "split_seeds": {"nominal": 1}, "split_sha256": {"nominal": "0" * 64}, "commit": "abc"},
    **{"python": "3", "packages": {"numpy": "2"}, "machine": "riscv64", "seconds": 1.0, "pairs_kept_before": 0},
}


def outcome_of(method: Method, split: str, metrics: Metrics, action_times: tuple[float, float]) -> MethodOutcome:
    return MethodOutcome(method, split, metrics, estimated([metrics])[0], action_times)


def outcome(
    name: str, kind: Kind, costs: float | np.ndarray, split: str = "nominal", seeds: int = 1, spread: float = 0.0
) -> MethodOutcome:
    count = np.size(costs) if np.size(costs) > 1 else 24
    noise = spread * np.random.default_rng(len(name)).standard_normal((seeds, count))
    values = np.broadcast_to(np.asarray(costs) * np.linspace(0.9, 1.1, count), (seeds, count)) + noise
    metrics = {metric: values.copy() for metric in SHOWN} | {LEFT: np.zeros((seeds, count))}
    metrics["still_s"] = values / 1000
    metrics |= {name: np.zeros((seeds, count)) for name in ("failure_share", "not_arrived_share", "saturated_share")}
    return outcome_of(Method(name, kind, (name,) * seeds, ""), split, metrics, (40.0, 2000.0))


def pair_of(comparison: Comparison, method: str) -> dict[str, Paired]:
    """Comparison of a method with the best classical controller of the first split, by metric."""
    return next(pair.metrics for pair in comparison.pairs if pair.outcome.name == method)


def content_of(comparison: Comparison) -> dict[str, Any]:
    return to_json(comparison, *verdict(comparison))


def made(*outcomes: MethodOutcome, failures: list[Failure] | None = None) -> Comparison:
    return make_comparison(list(outcomes), failures or [], SetLabel("seed 7", "0" * 64), ORIGIN)
