"""The picture on each method's page, drawn when the site is built: one move of many randomized arms."""

from __future__ import annotations

from functools import cache
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS, BeltArmVectorEnv
from beltarm_env.rollout import Recording, rollout
from beltarm_env.task.seeds import fresh_arms
from eval.comparison.methods import classical_methods, learned_methods, privileged_method, shipped_policies
from eval.report.style import COLOURS

ARMS = 24
MOVE = {"start": np.pi / 4, "goal": np.pi / 2, "duration": 0.8, "ramp_time": 0.12}
"""The paper's standard move."""


def motion(*names: str) -> None:
    """Draw the error of the arm's end on all arms, and the torque on the first one, under some methods."""
    beside = "paper" if "adaptive" in names else "adaptive"
    _, (error, torque) = plt.subplots(2, 1, figsize=(6.6, 4.8), sharex=True, layout="constrained")
    for name, colour in zip((beside, *names), ("0.55", *COLOURS), strict=False):
        recording = _recorded(name)
        distance = 1e3 * np.linalg.norm(recording.tip_error, axis=2)
        low, middle, high = np.percentile(distance, [10, 50, 90], axis=1)
        error.fill_between(recording.time, low, high, color=colour, alpha=0.2, lw=0)
        error.plot(recording.time, middle, color=colour, label=f"{name}: median cost {np.median(recording.cost):.0f}")
        torque.plot(recording.time, recording.torque[:, 0], color=colour, lw=1)
    for axes in (error, torque):
        axes.axvline(MOVE["duration"], color="0.3", lw=0.8, ls=":")
        axes.grid(alpha=0.3)
    error.set(ylabel="error of the arm's end (mm)", ylim=(0, None))
    error.legend(fontsize=9)
    torque.set(
        ylabel="torque (N m)", xlabel="time (s); dotted: end of the move", xlim=(0, CONTROL_PERIOD * EPISODE_STEPS)
    )


@cache
def _recorded(name: str) -> Recording:
    """Record one episode of each arm under a method; a learned one acts as its first training seed does."""
    method = {m.name: m for m in (*classical_methods(), *learned_methods(shipped_policies()), privileged_method())}[
        name
    ]
    settings = {"randomization": "train", "sensors": method.sensors}
    env = BeltArmVectorEnv(ARMS, **settings)
    env.reset(seed=fresh_arms(0).first)
    return rollout(method.controller(0, env.params), ARMS, seed=fresh_arms(0).first, options={"move": MOVE}, **settings)


def lay_out_figures(gallery_conf: dict[str, Any], name: str) -> None:
    """Give the figures of a tutorial matplotlib's own style, and room for their labels."""
    plt.rcdefaults()
    plt.rcParams["figure.constrained_layout.use"] = True
