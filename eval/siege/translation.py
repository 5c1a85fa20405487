"""Generated C beside Python, with sanitizers on."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from eval.comparison.sets import development_set
from eval.deploy.building import SANITISED
from eval.deploy.check import compare
from eval.deploy.controllers import controller_of, loop_of
from eval.deploy.package import write
from eval.deploy.study import CONTROLLERS
from eval.siege.report import Siege

STEPS = 1e7
"""Of arms, in a whole siege."""
_LENGTH = 1200


def besiege(share: float, seed: int) -> Siege:
    """Run exported controllers, compiled with sanitizers, beside Python's on development scenarios, bit for bit.

    Args:
        share: Of a whole siege.
        seed: Of the choice of controllers, guards and splits.
    """
    siege = Siege(
        "translation", "steps of controllers in C", "other compilers and processors: `make embedded` has some"
    )
    rng = np.random.default_rng(seed)
    splits = list(development_set().splits.values())
    order = rng.permutation(len(CONTROLLERS) * 2)
    for turn in range(500):
        if siege.count >= share * STEPS and turn:
            break
        choice = int(order[turn % len(order)])
        source, guard = CONTROLLERS[choice // 2], bool(choice % 2)
        split = splits[rng.integers(len(splits))]
        episodes = min(100, len(split.table), max(1, int(share * STEPS / _LENGTH)))
        name = f"{Path(source).parent.name or source}{' behind its guard' if guard else ''} on {split.name}"
        try:
            with tempfile.TemporaryDirectory() as folder:
                made, loop = Path(folder) / "made", loop_of(source, guard)
                write(made, loop)
                controller = controller_of(source, guard)
                found = compare(made, loop, controller, split, episodes, flags=(*SANITISED, "-O1"))
        except ValueError as error:
            siege.found.append(f"{name}, {episodes} episodes: {error}")
            continue
        siege.count += found.samples
        if found.equal != found.samples:
            differ = found.samples - found.equal
            siege.found.append(f"{name}, {episodes} episodes: {differ} torques differ, by {found.largest:.3g} N m")
    return siege
