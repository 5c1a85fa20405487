"""Learning curves of training runs and policies, read from their folders and drawn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from agents.policy.bundle import MANIFEST, BundleError, BundleSpec, read_spec
from agents.runs.checkpoint import RunFolder
from agents.runs.monitor import validate
from baselines import CONTROLLERS
from eval.report.style import COLOURS, mark_one_two_five

Floats = NDArray[np.float64]

BEST_CLASSICAL = "adaptive"
_POINTS = 200


@dataclass(frozen=True, slots=True)
class Curve:
    """Validation cost over one training run."""

    method: str
    base: str
    base_cost: float
    arms: int  # of the validation
    steps: Floats  # simulated samples of single arms
    minutes: Floats
    cost: Floats


def find_curves(folders: list[Path]) -> list[Curve]:
    """Read the curves of all runs and policies in folders.

    Raises:
        BundleError: If there are none in one of them, or a bundle is damaged.
    """
    curves = []
    for folder in folders:
        manifests = [folder / MANIFEST, *(folder / kind / MANIFEST for kind in ("last", "best"))]
        own = [manifest.parent for manifest in manifests if manifest.exists()][:1]
        below = [path.parent for path in (*folder.glob(f"*/{MANIFEST}"), *folder.glob(f"*/best/{MANIFEST}"))]
        bundles = own or sorted(below)
        if not bundles:
            raise BundleError(f"no run and no policy in {folder}: give the folder of a run, such as runs/ppo")
        curves += [_read_curve(bundle) for bundle in bundles]
    return curves


def _read_curve(bundle: Path) -> Curve:
    """Read the curve of a bundle; of a run under way, the newer one of its folder."""
    spec, _ = read_spec(bundle)
    known = spec.provenance
    points = known.get("curve", [])
    table = RunFolder(bundle.parent).curve
    if bundle.name == "best" and table.exists():
        rows = np.genfromtxt(table, delimiter=",", names=True, ndmin=1)
        points = np.stack([rows[name] for name in ("steps", "seconds", "cost")], axis=1)
    points = np.asarray(points, np.float64)
    if points.ndim != 2 or points.shape[1:] != (3,) or not np.isfinite(points).all():
        raise BundleError(f"{bundle} holds no learning curve")
    base_cost, arms = known.get("validation_of_base", {}).get("cost"), known.get("config", {}).get("validation_arms")
    if base_cost is None or not isinstance(arms, int):
        raise BundleError(f"{bundle} does not say what it was validated on")
    return Curve(
        method=_method(spec),
        base=spec.base,
        base_cost=float(base_cost),
        arms=arms,
        steps=points[:, 0] * spec.residual.hold,
        minutes=points[:, 1] / 60,
        cost=points[:, 2],
    )


def _method(spec: BundleSpec) -> str:
    return f"{spec.algorithm} on {spec.base}" if spec.base != "none" else f"{spec.algorithm} from scratch"


def levels(curves: list[Curve]) -> dict[str, float]:
    """Validation costs of the bases of some curves, and of the best classical controller, by name.

    Raises:
        ValueError: If the curves are of validations on different numbers of arms.
    """
    numbers = {curve.arms for curve in curves}
    if len(numbers) > 1:
        raise ValueError(
            f"the runs were validated on different numbers of arms, {sorted(numbers)}: draw them separately"
        )
    bases = {curve.base: curve.base_cost for curve in curves}
    return bases | {BEST_CLASSICAL: classical_cost(numbers.pop())}


def classical_cost(arms: int) -> float:
    """Compute the validation cost of the best classical controller."""
    return validate(CONTROLLERS[BEST_CLASSICAL](), arms)["cost"]


def curves_figure(curves: list[Curve], costs: dict[str, float]) -> Figure:
    """Draw curves over samples and over time, with the costs of some controllers as lines."""
    methods = list(dict.fromkeys(curve.method for curve in curves))
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.4), layout="constrained", sharey=True)
    panels: list[tuple[str, Callable[[Curve], Floats]]] = [
        ("simulated steps (millions)", lambda curve: curve.steps / 1e6),
        ("wall-clock (minutes)", lambda curve: curve.minutes),
    ]
    for axis, (label, abscissa) in zip(axes, panels, strict=True):
        for level in costs.values():
            axis.axhline(level, color="0.35", lw=1, ls="--", zorder=1)
        for k, method in enumerate(methods):
            _draw_method(
                axis, [curve for curve in curves if curve.method == method], abscissa, COLOURS[k % len(COLOURS)]
            )
        axis.set(xlabel=label, yscale="log", xlim=(0, None))
        axis.grid(alpha=0.3, which="both")
    for name, level in costs.items():
        right = axes[1].get_yaxis_transform()
        axes[1].text(1.01, level, name, transform=right, color="0.35", va="center", ha="left", fontsize=9)
    axes[0].legend(fontsize=9)
    axes[0].set_ylabel("mean episode cost, validation arms")
    mark_one_two_five(axes[0].yaxis)
    return figure


def _draw_method(axis: Axes, curves: list[Curve], abscissa: Callable[[Curve], Floats], colour: str) -> None:
    """Draw the runs of one method, with their median and interquartile band if there are several."""
    if len(curves) == 1:
        axis.plot(abscissa(curves[0]), curves[0].cost, color=colour, lw=2, label=curves[0].method)
        return
    for curve in curves:
        axis.plot(abscissa(curve), curve.cost, color=colour, lw=0.7, alpha=0.6)
    begin, end = max(abscissa(curve)[0] for curve in curves), min(abscissa(curve)[-1] for curve in curves)
    grid = np.linspace(begin, max(begin, end), _POINTS)
    logs = np.array([np.interp(grid, abscissa(curve), np.log(curve.cost)) for curve in curves])
    low, middle, high = np.exp(np.percentile(logs, [25, 50, 75], axis=0))
    axis.fill_between(grid, low, high, color=colour, alpha=0.25, lw=0)
    axis.plot(grid, middle, color=colour, lw=2, label=f"{curves[0].method} ({len(curves)} seeds)")
