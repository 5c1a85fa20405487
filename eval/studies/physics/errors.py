"""Error of the step: of one sample, of whole moves, and of costs, against 16 steps a sample.

The order of convergence (`eval.studies.physics`) ties many steps a sample to an independent solution. Here many arms
are moved by torques that controllers commanded on them. From each state of such a motion one sample is integrated as
usual, and in 16 times as many steps.
"""

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from baselines.registry import CONTROLLERS
from beltarm_env import EPISODE_STEPS, BeltArmVectorEnv
from beltarm_env.arm import COLUMN, ArmParams, params_columns
from beltarm_env.arrays import Floats
from beltarm_env.kernels import layout as at
from beltarm_env.rollout import record
from beltarm_env.simulation import ArmSimulation, X
from beltarm_env.task.ranges import PRESLIDING, TRAIN_RANGES
from beltarm_env.task.seeds import CROSSCHECK
from eval.comparison.statistics import interquartile_mean
from eval.studies._arms import ALL, drawn, with_effect

FINE = 16
"""Steps of the comparison, over those that a sample needs."""
SETS = {
    "training": "of the training ranges",
    "ends": "of the training ranges, with all effects of their drives at the upper ends",
    "giving": "of the training ranges, with motors that give by 0.3 to 5 mrad before they slip",
}
"""Sets of arms."""
DRIVERS = ("paper", "adaptive", "random")
"""What commanded the torques: two controllers, and noise, uniform over the torque limit and new in every sample."""
SENSITIVE = 1000.0
"""Growth of a small displacement from which on a motion tells nothing about the step."""
_SHIFT = 1e-9  # displacement at the start whose growth is measured [m]
_REACH = 0.5  # distance of the arm's end from joint 1 [m]
_AT_ONCE = 250  # arms whose states take little memory


def arms_of(name: str, count: int) -> Floats:
    """Return the constants of the arms of one of `SETS`, shape (count, len(FIELDS))."""
    ranges = {**TRAIN_RANGES, **PRESLIDING} if name == "giving" else TRAIN_RANGES
    table = drawn(count, CROSSCHECK.first, ranges).params_table
    return with_effect(table, ALL, 1.0) if name == "ends" else table


def commanded(driver: str, table: Floats, model: str, seed: int) -> tuple[Floats, Floats]:
    """Return the torques that one of `DRIVERS` commands [N m], (T, n), and the motor angles at the start, (n,).

    The first arm has the move of the seed, and the others those of the next ones.
    """
    settings: dict[str, Any] = {"model": model, "autoreset_mode": AutoresetMode.DISABLED}
    env = BeltArmVectorEnv(len(table), **settings)
    options = {"params": params_columns(table)}
    recording = record(CONTROLLERS["paper" if driver == "random" else driver](), env, seed=seed, options=options)
    starts = recording.moves[:, 0] * table[:, COLUMN.gear_ratio]
    if driver == "random":
        limits = table[:, COLUMN.torque_limit]
        return np.random.default_rng(seed).uniform(-limits, limits, recording.torque.shape), starts
    return recording.torque, starts


class _Simulations:
    """The same arms, integrated in a number of times as many steps as they need."""

    def __init__(self, table: Floats, model: str, factor: float) -> None:
        self._simulation = ArmSimulation([ArmParams.from_row(row) for row in table], model=model)
        self._table, self._factor, self._count = table, factor, len(table)

    def at_rest(self, angles: Floats) -> Floats:
        return self._simulation.at_rest(angles)

    def advance(self, states: Floats, torques: Floats, sample: int) -> Floats:
        self._simulation.set_table(self._table, np.full(self._count, float(sample)))
        blocks = self._simulation.room.blocks
        needed = at.rows(blocks, at.SUBSTEPS, 1, self._count)
        at.put_rows(blocks, at.SUBSTEPS, self._factor * needed)
        return self._simulation.advance(states, torques)


def _apart(x: Floats, y: Floats, gear: Floats) -> Floats:
    """Return how far the ends of arms are apart, from their angles [m]."""
    distance = np.abs(x[:, :X] - y[:, :X])
    return _REACH * np.maximum(distance[:, 0] / gear, distance[:, 2])


def motion_errors(table: Floats, model: str, torques: Floats, starts: Floats) -> dict[str, Floats]:
    """Move arms by commands, and measure the error of each sample and of the whole.

    Returns:
        `sample` [m] and `speed`, of the motor [rad/s], of each sample, shape (T, n); `whole`, largest distance over the
        motion [m], and `growth` of a small displacement, shape (n,).
    """
    gear = table[:, COLUMN.gear_ratio]
    usual, fine = _Simulations(table, model, 1.0), _Simulations(table, model, float(FINE))
    x = usual.at_rest(starts)
    exact, shifted = x.copy(), x.copy()
    shifted[:, 0] += _SHIFT / _REACH * gear
    sample, speed = np.empty(torques.shape), np.empty(torques.shape)
    whole, growth = np.zeros(len(table)), np.zeros(len(table))
    for k, torque in enumerate(torques):
        y, better = usual.advance(x, torque, k), fine.advance(x, torque, k)
        sample[k], speed[k] = _apart(y, better, gear), np.abs(y - better)[:, 1]
        exact, shifted, x = fine.advance(exact, torque, k), fine.advance(shifted, torque, k), y
        whole = np.maximum(whole, _apart(x, exact, gear))
        growth = np.maximum(growth, _apart(shifted, exact, gear) / _SHIFT)
    return {"sample": sample, "speed": speed, "whole": whole, "growth": growth}


def errors_of(name: str, model: str, driver: str, count: int, samples: int) -> dict[str, Any]:
    """Summarise `motion_errors` for one set of arms, model and driver."""
    parts = []
    for low in range(0, count, _AT_ONCE):
        table = arms_of(name, count)[low : low + _AT_ONCE]
        torques, starts = commanded(driver, table, model, CROSSCHECK.first + low)
        parts.append(motion_errors(table, model, torques[:samples], starts))
    joined = {key: np.concatenate([part[key] for part in parts], axis=-1) for key in parts[0]}
    steady = joined["growth"] < SENSITIVE
    return {
        "set": name,
        "model": model,
        "driver": driver,
        "sample_median": float(np.median(joined["sample"])),
        "sample_worst": float(joined["sample"].max()),
        "speed_worst": float(joined["speed"].max()),
        "sensitive": float(np.mean(~steady)),
        "whole_median": float(np.median(joined["whole"])),
        "whole_worst": float(joined["whole"][steady].max(initial=0.0)),
        "above": float(np.mean(joined["whole"][steady] > 1e-6)) if steady.any() else 0.0,
    }


def cost_change(name: str, count: int) -> dict[str, Any]:
    """Cost of a controller in closed loop, and by how much `FINE` steps change it."""
    usual, fine = (_costs(name, steps, count) for steps in (1, FINE))
    return {
        "controller": name,
        "cost": interquartile_mean(usual),
        "change": interquartile_mean(fine) / interquartile_mean(usual) - 1,
        "arm": float(np.abs(fine / usual - 1).max()),
    }


def _costs(name: str, steps: int, count: int) -> Floats:
    """Costs of a controller on arms of the training ranges, with a number of steps per sample at least, shape (n,)."""
    env = BeltArmVectorEnv(count, randomization="train", autoreset_mode=AutoresetMode.DISABLED)
    observation, _ = env.reset(seed=CROSSCHECK.first)
    env._batch.set_substeps(steps)
    controller, memory, costs = CONTROLLERS[name](), None, np.zeros(count)
    for _ in range(EPISODE_STEPS):
        action, memory = controller.predict(observation, memory)
        observation, reward, *_ = env.step(action)
        costs -= reward
    return costs
