"""Learning curves of training runs and policies, read from their folders and drawn."""

from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agents.policy.bundle import POLICY_FILE, BundleError, read_spec
from agents.runs.checkpoint import RunFolder
from agents.runs.training import validate
from baselines import CONTROLLERS
from beltarm_env.arrays import Floats
from eval.report.style import COLOURS, mark_one_two_five

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
    moves: int  # of each arm in the validation


def find_curves(folders: list[Path]) -> list[Curve]:
    """Read the curves of all runs and policies in folders.

    Raises:
        BundleError: If there are none in one of them, or a bundle is damaged.
    """
    curves = []
    for folder in folders:
        own = [path for path in (folder, folder / "last", folder / "best") if (path / POLICY_FILE).exists()][:1]
        below = [path.parent for path in (*folder.glob(f"*/{POLICY_FILE}"), *folder.glob(f"*/best/{POLICY_FILE}"))]
        bundles = own or sorted(below)
        if not bundles:
            raise BundleError(f"no run and no policy in {folder}: give the folder of a run, such as runs/ppo")
        curves += [_read_curve(bundle) for bundle in bundles]
    return curves


def _read_curve(bundle: Path) -> Curve:
    """Read the curve of a bundle; of a run under way, the newer one of its folder."""
    spec, _ = read_spec(bundle)
    known = spec.provenance
    points, table = np.asarray(known.get("curve", []), np.float64), RunFolder(bundle.parent).curve
    if bundle.name == "best" and table.exists():
        rows = np.genfromtxt(table, delimiter=",", names=True, ndmin=1)
        points = np.stack([rows[name] for name in ("steps", "seconds", "cost")], axis=1)
    if points.ndim != 2 or points.shape[1:] != (3,) or not np.isfinite(points).all():
        raise BundleError(f"{bundle} holds no learning curve")
    base_cost, options = known.get("validation_of_base", {}).get("cost"), known.get("config", {})
    arms, moves = options.get("validation_arms"), options.get("moves", 1)
    if base_cost is None or not isinstance(arms, int):
        raise BundleError(f"{bundle} does not say what it was validated on")
    method = f"{spec.algorithm} on {spec.base}" if spec.base != "none" else f"{spec.algorithm} from scratch"
    steps, seconds, cost = points.T
    return Curve(method, spec.base, float(base_cost), arms, steps * spec.residual.hold, seconds / 60, cost, moves)


def levels(curves: list[Curve]) -> dict[str, float]:
    """Validation costs of the bases of some curves, and of the best classical controller, by name.

    Raises:
        ValueError: If the curves are of validations on different numbers of arms.
    """
    numbers = {(curve.arms, curve.moves) for curve in curves}
    if len(numbers) > 1:
        found = ", ".join(f"{arms} with {moves} moves" for arms, moves in sorted(numbers))
        raise ValueError(f"the runs were validated on different numbers of arms, {found}: draw them separately")
    bases = {curve.base: curve.base_cost for curve in curves}
    return bases | {BEST_CLASSICAL: classical_cost(*numbers.pop())}


def classical_cost(arms: int, moves: int) -> float:
    """Compute the validation cost of the best classical controller on some arms, of some moves each."""
    return validate(CONTROLLERS[BEST_CLASSICAL](), arms, moves)["cost"]


def curves_figure(curves: list[Curve], costs: dict[str, float]) -> Figure:
    """Draw curves over samples and over time, with the costs of some controllers as lines."""
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.4), layout="constrained", sharey=True)
    panels = (("steps", 1e6, "simulated steps (millions)"), ("minutes", 1.0, "wall-clock (minutes)"))
    for axis, (abscissa, unit, label) in zip(axes, panels, strict=True):
        for level in costs.values():
            axis.axhline(level, color="0.35", lw=1, ls="--", zorder=1)
        for k, method in enumerate(dict.fromkeys(curve.method for curve in curves)):
            runs = [(getattr(curve, abscissa) / unit, curve.cost) for curve in curves if curve.method == method]
            _draw_method(axis, method, runs, COLOURS[k % len(COLOURS)])
        axis.set(xlabel=label, yscale="log", xlim=(0, None))
        axis.grid(alpha=0.3, which="both")
    for name, level in costs.items():
        right = axes[1].get_yaxis_transform()
        axes[1].text(1.01, level, name, transform=right, color="0.35", va="center", ha="left", fontsize=9)
    axes[0].legend(fontsize=9)
    axes[0].set_ylabel("mean episode cost, validation arms")
    mark_one_two_five(axes[0].yaxis)
    return figure


def _draw_method(axis: Axes, method: str, runs: list[tuple[Floats, Floats]], colour: str) -> None:
    """Draw the runs of one method, with their median and interquartile band if there are several."""
    if len(runs) == 1:
        axis.plot(*runs[0], color=colour, lw=2, label=method)
        return
    for at, cost in runs:
        axis.plot(at, cost, color=colour, lw=0.7, alpha=0.6)
    begin, end = max(at[0] for at, _ in runs), min(at[-1] for at, _ in runs)
    grid = np.linspace(begin, max(begin, end), _POINTS)
    logs = [np.interp(grid, at, np.log(cost)) for at, cost in runs]
    low, middle, high = np.exp(np.percentile(logs, [25, 50, 75], axis=0))
    axis.fill_between(grid, low, high, color=colour, alpha=0.25, lw=0)
    axis.plot(grid, middle, color=colour, lw=2, label=f"{method} ({len(runs)} seeds)")
