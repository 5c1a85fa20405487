"""Guards that are told nonsense: their command is a number within all limits, whatever comes in."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from baselines.guard.guard import GUARD_SIZE, LEVEL, PASSIVE_LEVEL, GuardInputs, guard_arms
from baselines.guard.settings import LARGEST, GuardDesign, GuardSettings
from beltarm_env import design_model
from beltarm_env.arrays import Flags, Floats
from eval.siege.report import Siege

SAMPLES = 3e7
"""Of guards, in a whole siege."""
_ARMS, _LENGTH = 256, 400
_RESTARTS = 0.002  # share of guards that begin a move, per sample
_LAST, _ANGLE = GuardInputs._fields.index("last_command"), GuardInputs._fields.index("motor_angle")
_SPECIAL = (np.nan, np.inf, -np.inf, 1.8e308, -1e300, 5e-324, 0.0, -0.0, 1.0, 1e9, -1e9, 1e-9, 1e30)
_ROUNDING = 1e-12


def besiege(share: float, seed: int) -> Siege:
    """Give guards of any settings any inputs, mixed into sound ones.

    Every command is a number within the torque limit, and within the slew limit of the last one; a guard that has
    given up stays so to the end of the move; and a guard alone does what it does among others.

    Args:
        share: Of a whole siege.
        seed: Of settings and inputs.
    """
    siege = Siege("guard", "samples of guards that are told nonsense", "commands that are allowed and unwise")
    for turn in range(max(1, round(share * SAMPLES / (_ARMS * _LENGTH)))):
        rng = np.random.default_rng((seed, turn))
        settings = GuardSettings() if turn % 2 == 0 else _any_settings(rng)
        design = settings.design(design_model(), residual=float(rng.choice([0.0, 0.3, 1.0])))
        wrong = _attack(design, rng)
        siege.count += _ARMS * _LENGTH
        siege.found += [f"seed {seed}, turn {turn}, {settings}: {wrong}"] if wrong else []
    return siege


def _any_settings(rng: np.random.Generator) -> GuardSettings:
    """Settings that nobody would choose, of those that are allowed."""
    highest = np.log10(LARGEST)
    return GuardSettings(**{one.name: float(10 ** rng.uniform(-300, highest)) for one in fields(GuardSettings)})


def _attack(design: GuardDesign, rng: np.random.Generator) -> str:
    """Guard arms for a while, one of them also alone; what is wrong, "" for nothing."""
    memory, torques = np.full((_ARMS, GUARD_SIZE), np.nan), np.zeros(_ARMS)
    one = int(rng.integers(_ARMS))
    memory_alone, torque_alone = memory[:1].copy(), np.zeros(1)
    begins, given_up = np.ones(_ARMS, np.bool_), np.zeros(_ARMS, np.bool_)
    wild = rng.choice([0.0, 0.01, 0.3, 1.0], size=(_ARMS, len(GuardInputs._fields)))
    for sample in range(_LENGTH):
        inputs = _inputs(design, rng, wild, torques, sample)
        guard_arms(design, inputs, begins, memory, torques)
        guard_arms(design, inputs[one : one + 1], begins[one : one + 1], memory_alone, torque_alone)
        wrong = _broken(design, inputs[:, _LAST], begins, torques)
        if torques[one].tobytes() != torque_alone[0].tobytes():
            wrong = "a guard does something else alone"
        if np.any(given_up & (memory[:, LEVEL] != PASSIVE_LEVEL)):
            wrong = "a guard that had given up returns"
        if wrong:
            return f"sample {sample}: {wrong}"
        given_up = memory[:, LEVEL] == PASSIVE_LEVEL
        begins = rng.random(_ARMS) < _RESTARTS
        given_up &= ~begins
    return ""


def _inputs(design: GuardDesign, rng: np.random.Generator, wild: Floats, last: Floats, sample: int) -> Floats:
    """Inputs of a sample, columns as `GuardInputs`: sound ones, of which some are replaced by anything."""
    sound = rng.normal(size=wild.shape) * design.limit
    sound[:, _ANGLE] = 10 + np.sin(0.01 * sample)
    sound[:, GuardInputs._fields.index("surprise")] = rng.choice([0.9, 1.0, 5.0], size=len(wild))
    sound[:, _LAST] = last
    anything = rng.choice([*_SPECIAL, design.limit, -design.limit, design.residual, design.surprise], size=wild.shape)
    return np.where(rng.random(wild.shape) < wild, anything, sound)


def _broken(design: GuardDesign, last: Floats, begins: Flags, torques: Floats) -> str:
    """Which limit commands are beyond; "" for none."""
    beyond = ~(np.abs(torques) <= design.limit)
    if beyond.any():
        return f"a command of {torques[beyond][0]:g} N m"
    known = np.abs(last) <= design.limit  # not that of a foreign motor
    change = np.abs(torques - np.where(begins, 0.0, last))[known | begins]
    if np.any(change > design.slew + _ROUNDING * design.limit):
        return f"a command that changes by {change.max():g} N m"
    return ""
