"""Files of the scenarios: the test set, and the record of the development set.

    eval/comparison/development.json   seeds, hashes and a few motions of the development set, which is drawn on the fly
    eval/comparison/scenarios.json     the test set: the numbers themselves, with the same; written once, there or not

By the motions a changed physics is noticed: those of the test set once it is there, and until then, and for sets that
are drawn afresh, those of the development set.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.tools.command import this_python
from baselines.tools.files import read_text, write_text
from baselines.tools.provenance import last_commit_of
from baselines.tools.schema import in_a_line, loads
from beltarm_env.arm import FIELDS, NOMINAL, params_columns
from beltarm_env.observation import index
from beltarm_env.rollout import rollout
from beltarm_env.task.moves import MOVE_FIELDS
from beltarm_env.task.seeds import arms_chosen_by
from eval.comparison.sets import (
    DEVELOPMENT_NAME,
    TEST_NAME,
    ScenarioSet,
    development_set,
    draw_set,
    fresh_set,
    make_set,
)
from eval.comparison.splits import (
    EDITION,
    SPLITS,
    VERSION,
    Split,
    beside_one_another,
    digest_of,
    first_seed,
    make_split,
    side_by_side,
)

FILE = Path(__file__).with_name("scenarios.json")
PROTOCOL = Path(__file__).resolve().parents[2] / "docs" / "benchmark" / "protocol.md"
RECORD = Path(__file__).with_name("development.json")
FORMATS = {DEVELOPMENT_NAME: "beltarm-development", TEST_NAME: "beltarm-scenarios"}
COMMAND, FREEZE = "python eval/scenarios.py --write", "python eval/scenarios.py --freeze-test"

_CHECKED = 3  # scenarios of a split whose motion is kept, to notice a changed physics
_AGREEMENT = 1e-6  # relative, of kept and fresh numbers: far above rounding, far below any change that matters


def choose_set(name: str | None = None, seed: int | None = None) -> ScenarioSet:
    """Choose a set of scenarios: by its name, by a seed of the user's, or the test set as soon as it is there.

    Raises:
        ValueError: If both are given, the name is unknown, or the file of the test set is missing or damaged.
    """
    if seed is not None:
        if name is not None:
            raise ValueError(f"--scenario-seed {seed} draws a set of its own: leave out --scenarios {name}")
        return fresh_set(seed)
    name = name or (TEST_NAME if FILE.exists() else DEVELOPMENT_NAME)
    if name not in FORMATS:
        raise ValueError(f"--scenarios must be one of {', '.join(FORMATS)}, got {name!r}")
    return development_set() if name == DEVELOPMENT_NAME else load(FILE)


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


def motions(splits: Sequence[Split]) -> list[list[list[float]]]:
    """Last state, cost and RMS tip error of each split's first scenarios under a fixed simple controller."""
    by_place: dict[int, list[list[float]]] = {}
    for group in beside_one_another(splits):
        together = side_by_side([(splits[k], slice(_CHECKED)) for k in group])
        run = rollout(_Probe(), len(together.table), **together.arguments(slice(None)))
        rows = np.column_stack([run.state[-1], run.cost, run.metrics()["tip_rms_mm"]])
        by_place |= zip(group, rows.reshape(len(group), _CHECKED, -1).tolist(), strict=True)
    return [by_place[k] for k in range(len(splits))]


def content_of(scenarios: ScenarioSet, protocol: str = "") -> dict[str, Any]:
    """Content of the file of a set: of the test set with all numbers and the protocol's commit; else without."""
    name, splits = scenarios.label.name, list(scenarios.splits.values())
    entries = {}
    for split, moved in zip(splits, motions(splits), strict=True):
        entries[split.name] = {
            "description": SPLITS[split.name].description,
            "seed": split.seed,
            "settings": split.settings,
            **({"columns": _columns(split)} if name == TEST_NAME else {}),
            "motions": moved,
            "sha256": split.digest,
        }
    origin = {"command": FREEZE, "protocol": protocol} if name == TEST_NAME else {"command": COMMAND}
    content = {"format": FORMATS[name], "edition": EDITION, "version": VERSION, **origin, "splits": entries}
    return {**content, "sha256": digest_of(content)}


def _columns(split: Split) -> dict[str, list[float]]:
    """Columns of a split by name, without the constants that are nominal in all its scenarios."""
    constants = {k: v for k, v in params_columns(split.table).items() if np.any(v != getattr(NOMINAL, k))}
    columns = {**constants, **dict(zip(MOVE_FIELDS, split.moves.T, strict=True)), "delay": split.delays}
    return {name: values.tolist() for name, values in columns.items()}


def text_of(content: dict[str, Any]) -> str:
    """JSON with a line for each list of numbers."""
    lists = re.compile(r"\[[^][{}]*\]")
    return lists.sub(lambda numbers: " ".join(numbers[0].split()), json.dumps(content, indent=1)) + "\n"


def write_record(path: Path) -> None:
    """Write the record of the development set."""
    write_text(path, text_of(content_of(development_set())))


def freeze_test_set(path: Path) -> None:
    """Draw the test set from the hash of the last commit of the protocol, and write its file.

    Raises:
        ValueError: If the file is there already, the protocol is not committed, or the physics is not that of the
            development set's record.
    """
    if path.exists():
        raise ValueError(f"{path} is there already: the test set is drawn once, and not again")
    require_same_physics(development_set())
    protocol = last_commit_of(PROTOCOL)
    write_text(path, text_of(content_of(draw_set(TEST_NAME, arms_chosen_by(protocol)), protocol)))


def load(path: Path) -> ScenarioSet:
    """Read the test set from its file.

    Raises:
        ValueError: If the file is missing, damaged, changed by hand, of another version, or not of the seeds that its
            protocol's commit chooses.
    """
    remedy = f"restore {path.name} from the repository"
    content = _read(path, TEST_NAME, remedy)
    try:
        seeds = arms_chosen_by(content["protocol"])
        splits = {name: _split_of(name, entry) for name, entry in content["splits"].items()}
        if wrong := [name for name, split in splits.items() if split.seed != first_seed(name, seeds)]:
            raise ValueError(f"the seed of {wrong[0]} is not the one that the protocol's commit chooses")
        return make_set(TEST_NAME, splits)
    except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
        raise ValueError(f"{path} does not hold what it should ({in_a_line(repr(error), 120)}): {remedy}") from None


def _read(path: Path, name: str, remedy: str) -> dict[str, Any]:
    """Content of the file of a set, of this version and as it was written."""
    try:
        content = loads(read_text(path))
    except (OSError, ValueError) as error:
        raise ValueError(f"{path} cannot be read ({in_a_line(error)}): {remedy}") from None
    if not isinstance(content, dict) or content.get("format") != FORMATS[name]:
        raise ValueError(f"{path} is no file of {FORMATS[name]}: {remedy}")
    if content.get("version") != VERSION:
        version = in_a_line(repr(content.get("version")), 80)
        raise ValueError(f"{path} has version {version}, this checkout needs {VERSION}: {remedy}")
    if content.get("sha256") != digest_of({key: value for key, value in content.items() if key != "sha256"}):
        raise ValueError(f"{path} was changed after it was written, its SHA-256 does not match: {remedy}")
    return content


def _split_of(name: str, entry: dict[str, Any]) -> Split:
    columns = {key: _numbers(key, values) for key, values in entry["columns"].items()}
    moves = np.column_stack([columns[key] for key in MOVE_FIELDS])
    table = np.column_stack([columns.get(key, np.full(len(moves), getattr(NOMINAL, key))) for key in FIELDS])
    split = make_split(name, TEST_NAME, entry["seed"], entry["settings"], table, moves, columns["delay"])
    if split.digest != entry["sha256"]:
        raise ValueError(f"the SHA-256 of {name} does not match")
    return split


def _numbers(key: str, values: list[Any]) -> NDArray[np.float64]:
    # Of words, NumPy would make an array in which each takes as much memory as the longest.
    if not {type(value) for value in values} <= {float, int}:
        raise TypeError(f"{key} has entries that are no numbers")
    return np.array(values, np.float64)


def require_same_physics(scenarios: ScenarioSet) -> None:
    """Check that the arms still move as they did when the scenarios, or the development set's record, were written.

    Raises:
        ValueError: Naming the first split in which they do not, or whose scenarios are others.
    """
    own = scenarios.label.name in FORMATS  # of a fresh set no motions are kept
    kept = scenarios if own else development_set().only(list(scenarios.splits))
    name = kept.label.name
    path = FILE if name == TEST_NAME else RECORD
    remedy = (
        "raise VERSION in eval/comparison/splits.py"
        if name == TEST_NAME
        else f"run `{COMMAND.replace('python', this_python(), 1)}`"
    )
    entries = _read(path, name, remedy)["splits"]
    splits = list(kept.splits.values())
    for split, moved in zip(splits, motions(splits), strict=True):
        entry = entries.get(split.name, {})
        if entry.get("sha256") != split.digest:
            raise ValueError(f"{path} has no split {split.name} with the scenarios that are drawn here: {remedy}")
        fresh, known = np.array(moved), np.array(entry["motions"])
        if not np.allclose(fresh, known, rtol=_AGREEMENT, atol=_AGREEMENT):
            raise ValueError(
                f"on split {split.name} the arms move otherwise than when {path.name} was written, by up to "
                f"{np.abs(fresh - known).max():.2g}: the physics, the sensors or the cost has changed; {remedy}"
            )
