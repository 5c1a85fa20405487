"""File of the test scenarios: written from the splits' seeds, checked against the motions that it holds."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np

from baselines.tools.files import write_text
from beltarm_env.observation import index
from eval.comparison.splits import COMMAND, FILE, FORMAT, SPLITS, VERSION, Split, columns_of, digest_of, draw

_CHECKED = 3  # scenarios of a split whose motion is kept, to notice a changed physics
_AGREEMENT = 1e-6  # relative, of kept and fresh numbers: far above rounding, far below any change that matters


class _Probe:
    """Weak servo with a slow wave on top: moves arms by what their sensors say."""

    _ANGLE, _SPEED, _TIME = index("motor_angle_error"), index("motor_speed_error"), index("elapsed_time")

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> Any:
        """Torque over its limit; see `Controller`."""
        wave = 0.2 * np.sin(20 * observation[:, self._TIME])
        action = 0.1 * observation[:, self._ANGLE] + 0.05 * observation[:, self._SPEED] + wave
        return action[:, None].astype(np.float32), None


def motions(split: Split) -> list[list[float]]:
    """Last state, cost and RMS tip error of a split's first scenarios under a fixed simple controller."""
    rows = []
    for scenario in range(_CHECKED):
        run = split.run(_Probe(), scenario)
        rows.append([*map(float, run.state[-1, 0]), float(run.cost[0]), float(run.metrics()["tip_rms_mm"][0])])
    return rows


def content_of(splits: dict[str, Split]) -> dict[str, Any]:
    """Content of the file for some splits; `randomized` comes before those that differ from it."""
    entries = {}
    for name, split in splits.items():
        definition = SPLITS[name]
        base = splits["randomized"] if definition.seed == SPLITS["randomized"].seed else split
        columns = columns_of(split)
        if base is not split:
            known = columns_of(base)
            columns = {key: values for key, values in columns.items() if not np.array_equal(values, known[key])}
        entries[name] = {
            "description": definition.description,
            "seed": split.seed,
            "settings": split.settings,
            "like": None if base is split else base.name,
            "columns": {key: values.tolist() for key, values in columns.items()},
            "motions": motions(split),
            "sha256": split.digest,
        }
    content = {"format": FORMAT, "version": VERSION, "command": COMMAND, "splits": entries}
    return {**content, "sha256": digest_of(content)}


def text_of(content: dict[str, Any]) -> str:
    """JSON with a line for each list of numbers."""
    lists = re.compile(r"\[[^][{}]*\]")
    return lists.sub(lambda found: " ".join(found[0].split()), json.dumps(content, indent=1)) + "\n"


def write(path: Path = FILE) -> None:
    """Draw all splits from their seeds and write their file."""
    write_text(path, text_of(content_of({name: draw(name) for name in SPLITS})))


def require_same_physics(splits: dict[str, Split], path: Path = FILE) -> None:
    """Check that the arms still move as they did when the file was written.

    Raises:
        ValueError: Naming the first split in which they do not.
    """
    kept = json.loads(path.read_text(encoding="utf-8"))["splits"]
    for name, split in splits.items():
        fresh, known = np.array(motions(split)), np.array(kept[name]["motions"])
        if not np.allclose(fresh, known, rtol=_AGREEMENT, atol=_AGREEMENT):
            raise ValueError(
                f"on split {name} the arms move otherwise than when version {VERSION} of the scenarios was written, by "
                f"up to {np.abs(fresh - known).max():.2g}: the physics, the sensors or the cost has changed. Raise "
                f"VERSION in eval/comparison/splits.py and run `{COMMAND}`"
            )
