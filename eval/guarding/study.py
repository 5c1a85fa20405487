"""Runs of controllers with and without the guard: while something breaks, and while nothing does."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from agents.policy.bundle import POLICIES, load_controller
from agents.residual.controller import ResidualController
from agents.residual.guarded import GuardedResidualController
from baselines import CONTROLLERS
from baselines.guard.controller import GuardedController, servo_for
from baselines.guard.guard import LEARNED_LEVEL, PASSIVE_LEVEL
from beltarm_env.arrays import Flags, Floats
from beltarm_env.rollout import Controller, record, rollout
from beltarm_env.task.seeds import FAULTS as SEEDS
from eval.comparison.splits import Split
from eval.guarding.faults import BrokenPolicy, FaultyArms

BASES = {"student": "adaptive", "ppo": "paper", "adaptive": "adaptive", "preview": "preview", "mpc": "mpc"}
"""Base of each controller of the study; a classical one is its own."""
LEARNED = tuple(name for name, base in BASES.items() if name != base)
NAN = "NaN weights"
"""The fault that classical controllers cannot have."""
MEASURES = {"peak": "peak tip error (mm)", "left": "left (%)", "energy": "torque energy (10⁻³ N²m²s)"}
"""Of an outcome, with their headings."""


@dataclass(frozen=True)
class Outcome:
    """What one controller came to on arms with one fault: means over the arms."""

    peak: float  # largest distance of the tip from its reference [mm]
    left: float  # share of arms that left the workspace [%]
    energy: float  # integral of the squared torque [10^-3 N^2 m^2 s]
    passive: float  # share of arms that the guard left without torque [%]


@dataclass(frozen=True)
class Health:
    """What the guard does to a controller on a split where nothing breaks."""

    before: float  # mean cost without the guard
    after: float  # and with it
    changed: float  # share of commands that the guard changed
    arms: float  # share of arms with such a command
    fallen: float  # share of arms on which it fell back


class Watched:
    """Guarded controller of which is kept what the guard did; shares are of arms, each of shape (n,)."""

    def __init__(self, of: GuardedController) -> None:
        self.params, self._of = of.params, of
        self.changed: list[Flags] = []
        self.levels: list[Floats] = []

    def predict(self, *arguments: Any, **named: Any) -> Any:
        """Call the controller; see `Controller`."""
        action, memory = self._of.predict(*arguments, **named)
        self.changed.append(memory.changed)
        self.levels.append(memory.level)
        return action, memory


def plain(name: str) -> Controller:
    """Make a controller without the guard; of a learned method that of its first training seed."""
    return load_controller(POLICIES / name / "seed0") if name in LEARNED else CONTROLLERS[name]()


def with_guard(controller: Controller, name: str) -> GuardedController:
    """Put the guard behind a controller of the study."""
    servo = servo_for(BASES.get(name, name))
    if isinstance(controller, ResidualController):
        return GuardedResidualController(controller, servo)
    return GuardedController(controller, servo)


@cache
def outcome(name: str, fault: str, guard: bool, arms: int) -> Outcome:
    """Run a controller, with or without the guard, on the first arms of the study's seeds while something breaks."""
    env, controller = FaultyArms(arms, fault, randomization="train"), plain(name)
    if fault == NAN and isinstance(controller, ResidualController):
        controller.policy = BrokenPolicy(controller.policy, env)
    watched = Watched(with_guard(controller, name)) if guard else None
    run = record(watched or controller, env, seed=SEEDS.first)
    peak = 1000 * np.linalg.norm(run.tip_error, axis=2).max(axis=0)
    passive = (np.array(watched.levels) == PASSIVE_LEVEL).any(axis=0) if watched else np.zeros(arms)
    left, energy = 100 * np.mean(~run.finished), 1000 * np.mean(env.energies())
    return Outcome(float(np.mean(peak)), float(left), float(energy), 100 * float(np.mean(passive)))


def health(name: str, split: Split, episodes: int) -> Health:
    """Run a controller with and without the guard on the first scenarios of a split."""
    arguments = split.arguments(slice(episodes))
    before = rollout(plain(name), episodes, **arguments)
    watched = Watched(with_guard(plain(name), name))
    after = rollout(watched, episodes, **arguments)
    changed, levels = np.array(watched.changed), np.array(watched.levels)
    return Health(
        before=float(np.mean(before.cost)),
        after=float(np.mean(after.cost)),
        changed=float(np.mean(changed)),
        arms=float(np.mean(changed.any(axis=0))),
        fallen=float(np.mean((levels > LEARNED_LEVEL).any(axis=0))),
    )
