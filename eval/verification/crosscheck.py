"""The full arm in two engines: this package's kernel against MuJoCo, given the same torques without feedback."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from baselines import PaperController
from baselines.tools.progress import progress_over
from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS, ArmParams, BeltArmVectorEnv
from beltarm_env.arm import params_columns, params_table
from beltarm_env.mujoco.drive import EXPRESSIBLE
from beltarm_env.mujoco.engine import MuJoCoArm
from beltarm_env.rollout import rollout
from beltarm_env.task.ranges import DRIVE_RANGES
from beltarm_env.task.reference import MoveShape
from eval.verification.event_located import tip

Floats = NDArray[np.float64]

REGIMES = {
    "smooth": "no Coulomb friction",
    "moves": "the benchmark's moves",
    "stick-slip": "back and forth",
    "drive": "back and forth behind a drive",
}
DRIVE = {name: DRIVE_RANGES[name][1] for name in EXPRESSIBLE}
"""What MuJoCo can express of the drive as it is built, at the upper ends of the training ranges."""
STEPS = (1, 2, 4, 8)
"""MuJoCo steps per control period."""
SETTINGS = {
    "RK4": {"integrator": "rk4"},
    "implicitfast": {"integrator": "implicitfast"},
    "Euler": {"integrator": "euler"},
    "RK4, d = 0.9, b = 100/s": {"integrator": "rk4", "friction_impedance": 0.9, "friction_rate": 100.0},
    "RK4, d = 0.9999, b = 100/s": {"integrator": "rk4", "friction_impedance": 0.9999, "friction_rate": 100.0},
    "RK4, d = 0.9999, b = 400/s": {"integrator": "rk4", "friction_impedance": 0.9999, "friction_rate": 400.0},
}
"""Arguments of `load_model`. The first three have its friction, d = 0.9999 and b in proportion to 1 / step; the others
differ from the first in friction alone, beginning with MuJoCo's own."""


@dataclass(frozen=True, slots=True)
class EngineDistance:
    """Distance of the tips in the two engines, in one regime and under one setting of MuJoCo."""

    regime: str
    setting: str
    stops: int  # of the motor, in all arms
    distances: dict[int, float]  # largest over the arms [mm], by MuJoCo steps per sample


@dataclass(frozen=True, slots=True)
class Motion:
    """One arm, its torques and where the kernel's full arm goes."""

    params: ArmParams
    torques: Floats  # commanded [N m]     (T,)
    start: Floats  # x at the beginning     (4,)
    tips: Floats  # after each sample [m]     (T, 2)
    stops: int  # samples in which the motor came to rest


def motions(regime: str, arms: int, seed: int) -> list[Motion]:
    """Arms, torques and where the kernel takes them.

    Args:
        regime: "smooth", without Coulomb friction; "moves", as the benchmark has them; "stick-slip", a torque that goes
            back and forth; or "drive", the same through `DRIVE`.
        arms: Number of arms.
        seed: Of the first arm; arm i has seed + i.
    """
    env = BeltArmVectorEnv(arms, randomization="ideal")
    env.reset(seed=seed)
    changes = {"smooth": {"coulomb_friction": 0.0}, "drive": DRIVE}.get(regime, {})
    params = [replace(p, **changes) for p in env.params]
    moves = env.moves
    starts = np.zeros((arms, 4))
    starts[:, 0] = [p.gear_ratio for p in params] * moves[:, 0]
    if regime in ("stick-slip", "drive"):
        starts[:, 0] = params[0].gear_ratio * np.pi / 4
        periods = 2 * np.pi * CONTROL_PERIOD * np.arange(EPISODE_STEPS)[:, None]
        friction = np.array([p.coulomb_friction for p in params])
        torques = 1.5 * friction * np.sin(np.linspace(2.0, 5.0, arms) * periods)
    else:
        torques = _under_the_papers_controller(params, moves, friction=regime != "smooth")
    return _in_the_kernel(params, starts, torques)


def _under_the_papers_controller(params: list[ArmParams], moves: Floats, friction: bool) -> Floats:
    controller = PaperController(ArmParams() if friction else ArmParams(coulomb_friction=0.0))
    options = {
        "params": params_columns(params_table(params)),
        "move": dict(zip(MoveShape._fields, moves.T, strict=True)),
    }
    return rollout(controller, len(params), seed=0, options=options, model="lagrangian").torque


def _in_the_kernel(params: list[ArmParams], starts: Floats, torques: Floats) -> list[Motion]:
    env = BeltArmVectorEnv(len(params), model="lagrangian", autoreset_mode="Disabled")
    env.reset(seed=0, options={"params": params_columns(params_table(params)), "state": starts})
    limits = np.array([p.torque_limit for p in params])
    states = np.empty((len(torques), len(params), 4))
    for k, torque in enumerate(torques):
        _, _, terminated, _, _ = env.step((torque / limits)[:, None])  # pyright: ignore[reportArgumentType]
        if terminated.any():
            raise ValueError(f"arm {int(np.argmax(terminated))} left the workspace: choose another --seed")
        states[k] = env.state
    at_rest = states[:, :, 1] == 0
    stops = np.sum(at_rest[1:] & ~at_rest[:-1], axis=0)
    tips = [np.array([tip(p, x) for x in states[:, arm]]) for arm, p in enumerate(params)]
    arms = zip(params, torques.T, starts, tips, stops.tolist(), strict=True)
    return [Motion(*arm) for arm in arms]


def distance(motion: Motion, steps: int, **settings: object) -> float:
    """Largest distance of MuJoCo's tip from the kernel's [m], with some MuJoCo steps per sample."""
    arm = MuJoCoArm(motion.params, steps, **settings)
    arm.begin(motion.start)
    worst = 0.0
    for torque, there in zip(motion.torques.tolist(), motion.tips, strict=True):
        worst = max(worst, float(np.linalg.norm(tip(motion.params, arm.advance(torque)) - there)))
    return worst


def crosscheck(arms: int, seed: int) -> list[EngineDistance]:
    """Compare the engines in every regime, under the settings that matter to it."""
    results = []
    for regime in progress_over("kinds of motion", REGIMES):
        cases = motions(regime, arms, seed)
        stops = sum(motion.stops for motion in cases)
        for name, setting in SETTINGS.items():
            if regime in ("smooth", "drive") and "friction_rate" in setting:
                continue
            worst = [1e3 * max(distance(motion, steps, **setting) for motion in cases) for steps in STEPS]
            results.append(EngineDistance(regime, name, stops, dict(zip(STEPS, worst, strict=True))))
    return results
