"""Test scenarios: the file is what its seeds give, says so by hashes, and notices a changed physics."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from baselines.servo.paper import PaperController
from beltarm_env import ArmParams
from beltarm_env.arm import FIELDS
from beltarm_env.rollout import rollout
from beltarm_env.task.ranges import TRAIN_RANGES
from eval.comparison.scenarios import content_of, require_same_physics, text_of
from eval.comparison.splits import EPISODES, FILE, SPLITS, VERSION, Split, digest_of, draw, load

SHIFTED = {
    "payload": {"payload_mass": (0.2, 0.5)},
    "stiffness": {"belt_stiffness": (0.5 * 33, 0.8 * 33)},
    "friction": {
        "coulomb_friction": (1.3 * 0.032, 1.8 * 0.032),
        "motor_viscous_friction": (1.3 * 3.5e-4, 1.8 * 3.5e-4),
    },
    "sensing": {},
    "structural": {},
}


@pytest.fixture(scope="module")
def splits() -> dict[str, Split]:
    return load()


def test_there_are_seven_splits_of_two_hundred_scenarios(splits: dict[str, Split]):
    assert list(splits) == ["nominal", "randomized", *SHIFTED] == list(SPLITS)
    for split in splits.values():
        assert len(split.table) == len(split.moves) == len(split.delays) == EPISODES >= 200
    assert FILE.stat().st_size < 300_000


@pytest.mark.parametrize("name", SPLITS)
def test_the_file_is_what_the_seeds_give(name: str, splits: dict[str, Split]):
    drawn = draw(name)
    for field in ("table", "moves", "delays"):
        assert np.array_equal(getattr(drawn, field), getattr(splits[name], field))
    assert drawn.digest == splits[name].digest


@pytest.mark.parametrize(("name", "randomization"), [("nominal", "off"), ("randomized", "train")])
def test_scenarios_of_the_file_are_episodes_of_the_environment(name: str, randomization: Any, splits: dict[str, Split]):
    """Bit for bit what the environment itself plays from the stated seeds."""
    count = 12
    seeded = rollout(PaperController(), count, seed=SPLITS[name].seed, randomization=randomization)
    ((scenarios, arguments),) = splits[name].batches(count)
    stored = rollout(PaperController(), count, **arguments)
    assert scenarios.tolist() == list(range(count))
    for field in ("state", "torque", "tip_error", "cost", "params", "moves"):
        assert np.array_equal(getattr(stored, field), getattr(seeded, field))


@pytest.mark.parametrize("name", SHIFTED)
def test_off_range_splits_are_the_randomized_one_but_for_the_shift(name: str, splits: dict[str, Split]):
    split, base = splits[name], splits["randomized"]
    assert np.array_equal(split.moves, base.moves)
    for k, field in enumerate(FIELDS):
        low, high = SHIFTED[name].get(field, TRAIN_RANGES.get(field, (0.0, np.inf)))
        assert np.all((split.table[:, k] >= low) & (split.table[:, k] <= high))
        assert np.array_equal(split.table[:, k], base.table[:, k]) == (field not in SHIFTED[name])
        if field in SHIFTED[name]:  # over the whole new range
            assert np.ptp(split.table[:, k]) > 0.95 * (high - low)
            train_low, train_high = TRAIN_RANGES[field]
            assert np.mean((split.table[:, k] > train_low) & (split.table[:, k] < train_high)) < 0.05


def test_settings_of_the_splits(splits: dict[str, Split]):
    assert splits["sensing"].settings == {"encoder_counts": 1000}
    assert splits["structural"].settings == {"model": "lagrangian"}
    assert all(splits[name].settings == {} for name in ("nominal", "randomized", "payload", "stiffness", "friction"))
    assert np.bincount(splits["sensing"].delays).tolist() == [0, 100, 100]
    assert not any(split.delays.any() for name, split in splits.items() if name != "sensing")


@pytest.mark.parametrize("episodes", [1, 5, 200])
def test_batches_hold_each_scenario_once(episodes: int, splits: dict[str, Split]):
    found = [scenarios for scenarios, _ in splits["sensing"].batches(episodes)]
    assert sorted(np.concatenate(found).tolist()) == list(range(episodes))
    assert len(found) == min(episodes, 2)


@pytest.mark.parametrize("name", ["sensing", "structural"])
def test_a_scenario_alone_is_as_in_its_batch(name: str, splits: dict[str, Split]):
    split, scenario = splits[name], 5
    alone = split.run(PaperController(), scenario)
    for scenarios, arguments in split.batches(8):
        if scenario in scenarios:
            together = rollout(PaperController(), len(scenarios), **arguments)
            place = scenarios.tolist().index(scenario)
            assert np.array_equal(together.state[:, place], alone.state[:, 0])
            assert together.cost[place] == alone.cost[0]


def test_arms_are_those_of_the_table(splits: dict[str, Split]):
    arm = splits["friction"].arms(np.array([7]))[0]
    assert [getattr(arm, name) for name in FIELDS] == splits["friction"].table[7].tolist()
    assert arm != ArmParams()


def test_the_file_is_written_as_it_is_read(splits: dict[str, Split]):
    assert text_of(content_of(splits)) == FILE.read_text(encoding="utf-8")


# Damage


def rehashed(content: dict[str, Any]) -> dict[str, Any]:
    rest = {key: value for key, value in content.items() if key != "sha256"}
    return {**rest, "sha256": digest_of(rest)}


def change_a_number(content: dict[str, Any]) -> dict[str, Any]:
    content["splits"]["payload"]["columns"]["payload_mass"][3] += 1e-15
    return content


def drop_the_moves(content: dict[str, Any]) -> dict[str, Any]:
    del content["splits"]["nominal"]["columns"]["goal"]
    return rehashed(content)


DAMAGE: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "another format": (lambda c: {**c, "format": "x"}, "no file of beltarm-scenarios"),
    "another version": (lambda c: rehashed({**c, "version": VERSION + 1}), f"has version {VERSION + 1}"),
    "no object": (lambda c: [c], "no file of beltarm-scenarios"),
    "last digit changed": (change_a_number, "SHA-256 does not match"),
    "last digit changed and hashed": (lambda c: rehashed(change_a_number(c)), "SHA-256 of payload does not match"),
    "column missing": (drop_the_moves, "KeyError"),
    "split missing": (lambda c: rehashed({key: c[key] for key in ("format", "version")}), "KeyError"),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_damaged_files_are_refused(damage: str, tmp_path: Path):
    change, message = DAMAGE[damage]
    path = tmp_path / "scenarios.json"
    path.write_text(json.dumps(change(json.loads(FILE.read_text()))))
    with pytest.raises(ValueError, match=message) as caught:
        load(path)
    assert "python eval/scenarios.py --write" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", FILE.read_text()[:1000]])
def test_half_a_file_is_refused(text: str, tmp_path: Path):
    path = tmp_path / "scenarios.json"
    path.write_text(text)
    with pytest.raises(ValueError, match="cannot be read"):
        load(path)
    with pytest.raises(ValueError, match="cannot be read"):
        load(tmp_path / "nowhere.json")


# Physics


def test_the_arms_move_as_when_the_file_was_written(splits: dict[str, Split]):
    require_same_physics(splits)


@pytest.mark.parametrize(
    "change",
    [
        lambda split: replace(split, settings={"model": "lagrangian"}),
        lambda split: replace(split, settings={"encoder_counts": 3999}),
        lambda split: replace(split, table=split.table * np.where(np.array(FIELDS) == "coulomb_friction", 1 + 1e-4, 1)),
        lambda split: replace(split, table=split.table * np.where(np.array(FIELDS) == "belt_stiffness", 1 + 1e-4, 1)),
    ],
    ids=["equations", "encoder", "friction", "belt"],
)
def test_a_changed_physics_is_noticed(change: Callable[[Split], Split], splits: dict[str, Split]):
    with pytest.raises(ValueError, match=r"on split nominal the arms move otherwise .* Raise VERSION"):
        require_same_physics({"nominal": change(splits["nominal"])})
