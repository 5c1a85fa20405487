"""Shipped policies over the best classical controller, bin by bin of what arms may have, in training and beyond it.

In each bin one constant of the arms lies between two bounds. All others are drawn as in training. Beside the shipped
policies are students with rest logic, which is to keep a motor that hardly turns from hunting (`RestLogic`).
"""

import math
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from agents.policy.bundle import load_controller
from agents.residual.bases import make_base
from agents.residual.controller import combine
from beltarm_env.arm import NOMINAL
from beltarm_env.arrays import Flags, Singles
from beltarm_env.observation import decode
from beltarm_env.rollout import rollout
from beltarm_env.task.ranges import SHIFT_RANGES
from beltarm_env.task.seeds import ABLATIONS
from eval.comparison.methods import shipped_policies
from eval.comparison.rollouts import side_by_side
from eval.report.curves import BEST_CLASSICAL
from eval.report.style import COLOURS, below, panels


class Divided(NamedTuple):
    """Constant that bins divide, from below its training range to far above it."""

    title: str
    low: float  # in its unit
    high: float
    unit: float  # SI


DIVIDED = {
    "presliding_deflection": Divided("deflection before the motor slips (mrad)", 0.0, 20.0, 1e-3),
    "coulomb_friction": Divided("Coulomb friction (nominal = 1)", 0.7, 1.8, NOMINAL.coulomb_friction),
    "payload_mass": Divided("mass of a part (kg)", 0.05, 0.8, 1.0),
}
"""By the field's name in `ArmParams`."""
SHIPPED, REST = ("student", "ppo"), "student with rest logic"
COMPARED = {"cost": "cost", "torque_rate_rms": "torque rate", "torque_reversals_hz": "reversals"}
"""Metrics and their titles."""
_MOVES = 2  # one with a part, one without
_WINDOW, _TRAVEL = 34, 0.02  # angles, 50 ms apart at most; [rad]


class RestLogic:
    """Shipped students whose residual counts by how far the motor turned in the last 50 ms, in full from 20 mrad on."""

    def __init__(self) -> None:
        self._student = load_controller(*shipped_policies(method="student"))
        self.params, self.profile = self._student.params, self._student.profile

    def predict(
        self, observation: Singles, state: Any = None, episode_start: Flags | None = None, deterministic: bool = True
    ) -> tuple[Singles, Any]:
        """Torque over its limit, see `Controller`; in a rollout, where only arms that have left begin anew."""
        before, angles = state or (None, ())
        angles = (*angles, decode(observation)["motor_angle"])[-_WINDOW:]
        student: Any = self._student.predict(observation, before, episode_start, deterministic)[1]
        share = np.minimum(np.abs(np.diff(angles, axis=0)).sum(axis=0) / _TRAVEL, 1.0).astype(np.float32)
        limit = self._student.settings.limit
        return combine(student.informed.action, share[:, None] * student.residual, limit), (student, angles)


def measure(bins: int, arms: int, jobs: int | None) -> dict[str, list[dict[str, Any]]]:
    """Measure ratios to the best classical controller in each bin of each of `DIVIDED`; some arms for each policy."""
    arms *= math.lcm(*(len(shipped_policies(method=method)) for method in SHIPPED))
    results = side_by_side("bins", ratios, [(name, k, bins, arms) for name in DIVIDED for k in range(bins)], jobs)
    return {name: [results[name, k, bins, arms] for k in range(bins)] for name in DIVIDED}


def ratios(name: str, k: int, bins: int, arms: int) -> dict[str, Any]:
    """Ratios in one bin: of means over all moves of all arms, which the policies of a method share equally."""
    of = DIVIDED[name]
    low, high = (of.low + (of.high - of.low) * edge / bins for edge in (k, k + 1))
    ranges = {**SHIFT_RANGES, name: (low * of.unit, high * of.unit)}
    task = {"seed": ABLATIONS.first + k * arms, "randomization": ranges, "moves": _MOVES}
    controllers = {BEST_CLASSICAL: make_base(BEST_CLASSICAL), REST: RestLogic()}
    controllers |= {method: load_controller(*shipped_policies(method=method)) for method in SHIPPED}
    runs = {method: rollout(controller, arms, **task).metrics() for method, controller in controllers.items()}
    means = {method: {metric: run[metric].mean() for metric in COMPARED} for method, run in runs.items()}
    base = means.pop(BEST_CLASSICAL)
    found = {method: {metric: mean[metric] / base[metric] for metric in COMPARED} for method, mean in means.items()}
    return {"low": low, "high": high, **found}


def methods(measured: dict[str, list[dict[str, Any]]]) -> list[str]:
    """Methods that were measured."""
    return [name for name in (*SHIPPED, REST) if name in measured["payload_mass"][0]]


def worst(measured: dict[str, list[dict[str, Any]]]) -> list[dict[str, Any]]:
    """Largest and middle ratio of each method over the bins of each constant."""
    found = []
    for (name, rows), method in product(measured.items(), methods(measured)):
        row: dict[str, Any] = {"method": method, "title": DIVIDED[name].title}
        for metric in COMPARED:
            of_bins = [each[method][metric] for each in rows]
            row[metric] = {"median": np.median(of_bins), "most": max(of_bins)}
        found.append(row)
    return found


def drawn(measured: dict[str, list[dict[str, Any]]]) -> Figure:
    """Draw the ratios of the cost over the bins; grey: the training range."""
    figure, axes = panels(len(measured), 3, (4.2, 3.2), sharey=True)
    for axis, (name, rows) in zip(axes, measured.items(), strict=True):
        middles = [(row["low"] + row["high"]) / 2 for row in rows]
        low, high = SHIFT_RANGES[name]
        axis.axvspan(low / DIVIDED[name].unit, high / DIVIDED[name].unit, color="0.93", label="in training")
        axis.axhline(1.0, color="0.45", lw=1, ls="--")
        for method, colour in zip(methods(measured), COLOURS, strict=False):
            axis.plot(middles, [row[method]["cost"] for row in rows], "o-", ms=3, color=colour, label=method)
        axis.set_xlabel(DIVIDED[name].title)
        axis.grid(alpha=0.3)
    axes[0].set_ylabel(f"mean cost over that of {BEST_CLASSICAL}")
    below(figure, axes[0], 1 + len(methods(measured)))
    return figure
