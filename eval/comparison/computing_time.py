"""Time that each method takes for an action; where it counts, it is measured once and kept in `computing_time.json`.

Where computing time counts, a command acts later than the drive's own latency by the 99th percentile of the method's
time per action for one arm, in every scenario. A run that goes on from kept results must not measure that again: its
arms would be others. So the times are kept beside the results, under a key of everything that the method depends on,
and measured anew only for `--fresh`, or for another method or other code.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from baselines.tools.files import read_text, write_text
from baselines.tools.schema import loads
from beltarm_env import ArmParams
from eval.comparison.methods import Method
from eval.comparison.pairs import Failure, key_of, run_controller
from eval.comparison.timing import action_times

FILE = "computing_time.json"
_LONGEST = 1e9  # time that is believed [us]
Times = tuple[float, float]
"""Median and 99th percentile of the time per action for one arm [us]."""


def measured_times(methods: Sequence[Method]) -> dict[str, Times | Failure]:
    """Times of some methods, by name, measured now; a failure where a controller fails on one arm."""
    return {method.name: run_controller(method, "", partial(_time, method), "one arm") for method in methods}


def _time(method: Method) -> Times:
    return action_times(method.controller(0, [ArmParams()]), method.sensors)


def measured_once(methods: Sequence[Method], folder: Path, *, fresh: bool = False) -> dict[str, Times | Failure]:
    """Times of some methods, by name: those that the folder has, the others measured and kept in it.

    Args:
        methods: What to time; one of unknown identity is always measured.
        folder: Of the comparison.
        fresh: Whether to measure all of them anew.

    Raises:
        OSError: If the times cannot be written.
    """
    kept, found = _read(folder / FILE), {}
    for method in methods:
        key = None if method.identity is None else key_of(method)
        entry = kept.get(method.name, {})
        if not fresh and key is not None and entry.get("key") == key:
            found[method.name] = entry["p50"], entry["p99"]
            continue
        found |= measured_times([method])
        if key is not None and not isinstance(times := found[method.name], Failure):
            kept[method.name] = {"key": key, "p50": times[0], "p99": times[1]}
            write_text(folder / FILE, json.dumps(kept, indent=1) + "\n")
    return found


def _read(path: Path) -> dict[str, dict[str, Any]]:
    """Times that are kept, by method; those of a damaged file, or damaged in it, are measured anew."""
    try:
        content = loads(read_text(path))
        return {name: entry for name, entry in content.items() if _LONGEST >= entry["p99"] >= entry["p50"] > 0}
    except (OSError, ValueError, AttributeError, KeyError, TypeError):
        return {}
