"""Encoders that lie, to controllers in Python and in C, with sanitizers on, side by side.

The arms move as Python's controllers command; what lies is what both are shown of their motors.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from beltarm_env import BeltArmVectorEnv
from beltarm_env.arrays import Floats, Integers
from beltarm_env.task.reference import MoveShape
from beltarm_env.task.sensors import ENCODER_COUNTS
from eval.comparison.splits import Split
from eval.deploy.building import SANITISED, here
from eval.deploy.controllers import controller_of, loop_of
from eval.deploy.in_the_loop import InTheLoop, counts_of
from eval.deploy.loop import Device, begin, commanded, empty_device, observe
from eval.deploy.package import write

FAULTS = (
    *("none", "stuck", "other way round", "lost", "late", "jump", "spike", "flipped bit", "ends of the range"),
    *("anything", "noise", "dead", "twice as fast", "of 16 bits"),
)
"""What may be wrong with an encoder from some sample on."""
_MOST, _LEAST = 2**31 - 1, -(2**31)
_LATE = 4
_SLEW_ROUNDING = 1e-6  # of single precision


class LyingEncoders:
    """Encoders of arms, each with a fault of its own from some sample on.

    Args:
        counts: Of the first sample, shape (n,).
        length: Samples of an episode.
        rng: What is drawn from.
    """

    def __init__(self, counts: Integers, length: int, rng: np.random.Generator) -> None:
        self.faults = rng.choice(FAULTS, size=len(counts))
        self._onset, self._rng, self._sample = rng.integers(0, length, size=len(counts)), rng, 0
        self._true, self._shown = np.repeat(counts[None], _LATE + 1, axis=0), counts

    def shown(self, counts: Integers) -> Integers:
        """What is shown in place of the true counts of a sample, shape (n,): 32 bits with a sign."""
        rng, n = self._rng, len(counts)
        self._true = np.concatenate([counts[None], self._true[:-1]])
        rare = rng.random(n) < 0.02
        anything = rng.integers(_LEAST, _MOST, size=n, endpoint=True)
        lies = {
            "stuck": self._shown,
            "other way round": self._shown - (counts - self._true[1]),
            "lost": np.where(rng.random(n) < 0.5, self._shown, counts),
            "late": self._true[_LATE],
            "jump": counts + 700,
            "spike": np.where(rare, anything, counts),
            "flipped bit": np.where(rare, counts ^ (1 << rng.integers(0, 31, size=n)), counts),
            "ends of the range": np.where(rng.random(n) < 0.5, _MOST, _LEAST),
            "anything": anything,
            "noise": counts + rng.integers(-8, 8, size=n, endpoint=True),
            "dead": np.zeros(n, np.intp),
            "twice as fast": 2 * counts,
            "of 16 bits": (counts * 97 + 2**15) % 2**16 - 2**15,
        }
        wrong = np.select([self.faults == name for name in lies], list(lies.values()), counts)
        self._shown = np.clip(np.where(self._sample >= self._onset, wrong, counts), _LEAST, _MOST)
        self._sample += 1
        return self._shown


def attack(
    source: str, guard: bool, split: Split, arms: int, length: int, rng: np.random.Generator, folder: Path
) -> list[str]:
    """Let encoders lie to a controller, in Python and in C.

    Both command the same torque to the last bit, within the limit; behind the guard it changes by no more than the slew
    limit. Wrong accesses and undefined operations end the program in C.

    Args:
        source: Name of a classical controller, or folder of a policy.
        guard: Whether the guard stands between it and the motor.
        split: Of whose first scenarios the arms are.
        arms: How many.
        length: Samples.
        rng: What faults are drawn from.
        folder: That does not exist yet, for the sources.

    Returns:
        What was found, a line each.

    Raises:
        ValueError: If the program does not compile, or ends.
    """
    settings = split.arguments(slice(arms))
    seed, options = settings.pop("seed"), settings.pop("options")
    env = BeltArmVectorEnv(arms, **settings)
    seen, _ = env.reset(seed=seed, options=options)
    per_turn = int(split.settings.get("encoder_counts", ENCODER_COUNTS))
    quantum, loop = 2 * np.pi / per_turn, loop_of(source, guard)
    limit, slew = loop.params.torque_limit, loop.design.guard.slew if guard else np.inf
    encoders = LyingEncoders(counts_of(seen, quantum), length, rng)
    controller, devices = controller_of(source, guard), [empty_device() for _ in range(arms)]
    write(folder, loop)
    program = InTheLoop(folder, loop.name, split.moves[:arms], limit, here(), per_turn, (*SANITISED, "-O1"))
    found, state, last = [], None, np.zeros(arms)
    with program:
        for sample in range(length):
            begins, counts = np.full(arms, sample == 0), encoders.shown(counts_of(seen, quantum))
            for arm, device in enumerate(devices):
                if sample == 0:
                    begin(device, loop.params.plant(), quantum, MoveShape(*split.moves[arm]), int(counts[arm]))
                observe(device, int(counts[arm]))
            shown = np.concatenate([device.observation for device in devices])
            action, state = controller.predict(shown, state, begins)
            compiled = program.torques(counts, begins)
            torques = _held(devices, action, limit)
            wrong = ~(np.abs(compiled) <= limit) | ~(np.abs(compiled - last) <= slew + _SLEW_ROUNDING * limit)
            for arm in np.flatnonzero((compiled != torques) | wrong)[: 3 - len(found)]:
                told = f"{torques[arm]:.17g} N m in Python, {compiled[arm]:.17g} N m in C after {last[arm]:.17g}"
                found.append(f"sample {sample}, encoder {arm} ({encoders.faults[arm]}): {told}")
            last = torques
            seen = env.step(np.nan_to_num(np.clip(action, -1, 1)).astype(np.float32))[0]
    return found


def _held(devices: list[Device], action: Any, limit: float) -> Floats:
    """Torques that the devices hold [N m], shape (n,)."""
    return np.array([commanded(device, row[0], limit) for device, row in zip(devices, action, strict=True)])
