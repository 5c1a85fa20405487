"""Gains of `robust` that are kept, as their design takes longer than all else that a controller needs at its start.

`robust.json` holds the gains for the tuned weights, and all that they were designed for. For anything else they are
designed as they are needed. Where the design has changed, `python baselines/design.py` writes the file anew.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from baselines.tools.files import read_text, write_text
from baselines.tools.schema import loads
from beltarm_env.arrays import Floats

FILE = Path(__file__).with_name("robust.json")


def kept_gains(design: dict[str, Any], path: Path = FILE) -> Floats | None:
    """Read the gains of a design, shape (places, 5); None if others are kept, or none.

    Args:
        design: All that the gains depend on, as JSON holds it.
        path: File of the gains.

    Raises:
        ValueError: If the file is damaged.
    """
    known, gains = _read(path)
    return gains if known == design else None


@cache
def _read(path: Path) -> tuple[Any, Floats]:
    if not path.exists():
        return None, np.empty((0, 5))
    try:
        content = loads(read_text(path))
        gains = np.array(content["gains"], np.float64)
        if gains.ndim != 2 or gains.shape[1] != 5 or not np.isfinite(gains).all():
            raise ValueError("no gains of shape (places, 5)")
        return content["design"], gains
    except (OSError, ValueError, TypeError, KeyError) as error:  # no file, no JSON, or not of this form
        raise ValueError(f"{path} is damaged ({error}): restore it, or remove it to have gains designed") from None


def keep(design: dict[str, Any], gains: Floats, path: Path = FILE) -> None:
    """Keep the gains of a design, shape (places, 5), and no others.

    Raises:
        OSError: If the file cannot be written.
    """
    write_text(path, json.dumps({"design": design, "gains": gains.tolist()}, indent=1) + "\n")
