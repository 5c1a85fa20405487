"""Generated C beside Python, with sanitizers on: on sound encoders and on those that lie."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from eval.comparison.sets import development_set
from eval.comparison.splits import Split
from eval.deploy.building import SANITISED
from eval.deploy.check import compare
from eval.deploy.controllers import controller_of, loop_of
from eval.deploy.package import write
from eval.deploy.study import CONTROLLERS
from eval.siege import encoders
from eval.siege.report import Siege

STEPS = 1e7
"""Of arms, in a whole siege."""
_LENGTH = 1200


def besiege(share: float, seed: int) -> Siege:
    """Run exported controllers, compiled with sanitizers, beside Python's on development scenarios, bit for bit.

    In every other turn encoders lie, see `eval.siege.encoders`.

    Args:
        share: Of a whole siege.
        seed: Of the choice of controllers, guards, splits and lies.
    """
    siege = Siege(
        "translation", "steps of controllers in C", "other compilers and processors: `make embedded` has some"
    )
    rng = np.random.default_rng(seed)
    splits = list(development_set().splits.values())
    order = rng.permutation(len(CONTROLLERS) * 2)
    for turn in range(500):
        if siege.count >= share * STEPS and turn > 1:
            break
        choice, lies = int(order[turn // 2 % len(order)]), turn % 2 == 1
        source, guard = CONTROLLERS[choice // 2], bool(choice % 2)
        split = splits[rng.integers(len(splits))]
        arms = min(100, len(split.table), max(1, int(share * STEPS / _LENGTH)))
        behind, shown = " behind its guard" if guard else "", " with encoders that lie" if lies else ""
        name = f"seed {seed}, turn {turn}, {Path(source).parent.name or source}{behind} on {split.name}{shown}"
        try:
            with tempfile.TemporaryDirectory() as folder:
                made = Path(folder) / "made"
                if lies:
                    drawn = np.random.default_rng((seed, turn))
                    found = encoders.attack(source, guard, split, arms, _LENGTH, drawn, made)
                    siege.count += arms * _LENGTH
                else:
                    samples, found = _compared(source, guard, split, arms, made)
                    siege.count += samples
        except ValueError as error:
            found = [str(error)]
        siege.found += [f"{name}, {arms} arms: {wrong}" for wrong in found]
    return siege


def _compared(source: str, guard: bool, split: Split, episodes: int, folder: Path) -> tuple[int, list[str]]:
    """Compare a controller in C with Python's in closed loop: samples, and what was found."""
    loop = loop_of(source, guard)
    write(folder, loop)
    found = compare(folder, loop, controller_of(source, guard), split, episodes, flags=(*SANITISED, "-O1"))
    differ = found.samples - found.equal
    return found.samples, [f"{differ} torques differ, by {found.largest:.3g} N m"] if differ else []
