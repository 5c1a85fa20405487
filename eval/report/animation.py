"""Data of the animation, as the page's script reads them."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np

from beltarm_env.arm import COLUMN, ArmParams
from beltarm_env.rollout import Recording
from beltarm_env.task.reference import TRAPEZOID, MoveShape, reference_at
from beltarm_env.timing import CONTROL_PERIOD
from eval.report.scenes import Scene

EVERY = 4  # samples per frame: 6 ms
COLUMNS = ("joint angle", "torsion", "radial error", "lateral error", "torque")
"""Of each frame [rad, rad, mm, mm, N m]."""
_LONGEST_MM = 500.0  # an arm that left its workspace may be anywhere


def frames(recording: Recording) -> np.ndarray:
    """Every fourth sample as float32, shape (frames, 5), columns as `COLUMNS`."""
    chosen = slice(EVERY - 1, None, EVERY)
    gear_ratio = recording.params[0, COLUMN.gear_ratio]
    state = recording.state[chosen, 0]
    errors = np.clip(1000 * recording.tip_error[chosen, 0], -_LONGEST_MM, _LONGEST_MM)
    columns = [state[:, 0] / gear_ratio, state[:, 2], errors[:, 0], errors[:, 1], recording.torque[chosen, 0]]
    return np.column_stack(columns).astype("<f4")


def reference_angles(recording: Recording) -> np.ndarray:
    """Reference of the joint at each row of a recording of one arm [rad], shape (T,)."""
    move = MoveShape(*map(float, recording.moves[0]))
    return np.array([reference_at(TRAPEZOID, move, float(time)).angle for time in recording.time])


def encode(values: np.ndarray) -> str:
    """Little-endian float32 in base64, row by row."""
    return base64.b64encode(values.astype("<f4").tobytes()).decode()


def animation(scenes: list[Scene], colours: dict[str, str]) -> dict[str, Any]:
    """Data for the script: JSON with arrays in base64."""
    return {"period": EVERY * CONTROL_PERIOD, "scenes": [_scene(scene, list(colours)) for scene in scenes]}


def _scene(scene: Scene, names: list[str]) -> dict[str, Any]:
    moved = {method: frames(scene.motions[method]) for method in names if method in scene.motions}
    first = next(iter(scene.motions.values()))
    arm = ArmParams.from_row(first.params[0])
    reference = reference_angles(first)[EVERY - 1 :: EVERY]
    largest = [float(np.hypot(found[:, 2], found[:, 3]).max()) for found in moved.values()]
    return {
        "title": scene.title,
        "link": arm.link_length,
        "hand": arm.hand_length,
        "payload": arm.payload_mass,
        "duration": float(first.moves[0, 2]),
        "magnified": _round_up(float(np.median(largest))),
        "reference": encode(reference),
        "methods": [
            {"name": method, "colour": names.index(method), "frames": encode(found)} for method, found in moved.items()
        ],
    }


def _round_up(millimetres: float) -> float:
    """Round up to 1, 2 or 5 times a power of ten, at least 2 mm."""
    power = 10.0 ** np.floor(np.log10(max(millimetres, 2.0)))
    return float(next(step * power for step in (1, 2, 5, 10) if step * power >= max(millimetres, 2.0)))
