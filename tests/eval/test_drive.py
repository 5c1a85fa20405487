"""The study of the drive: arms that have the effects asked for, and what the page says about training."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import mistake

from agents.policy.bundle import POLICIES, annotate
from beltarm_env import ArmParams, BeltArmVectorEnv
from beltarm_env.arm import COLUMN, DRIVE_EFFECTS
from beltarm_env.task.ranges import DRIVE_RANGES
from eval import study
from eval.comparison.rollouts import shipped_methods
from eval.studies import _frame, drive
from eval.studies._effects import ALL, EFFECTS, IDEAL, heading, with_effect


@pytest.fixture(scope="module")
def drawn() -> np.ndarray:
    env = BeltArmVectorEnv(6, randomization="train")
    env.reset(seed=3)
    return env.params_table


@pytest.mark.parametrize("name", [IDEAL, *EFFECTS])
@pytest.mark.parametrize("size", [0.5, 2.0])
def test_arms_have_the_effects_asked_for_and_no_others(name: str, size: float, drawn: np.ndarray):
    arms = with_effect(drawn, name, size)
    for field in DRIVE_EFFECTS:
        column = getattr(COLUMN, field)
        end = size * DRIVE_RANGES[field][1] if name in (field, ALL) else 0.0
        np.testing.assert_allclose(np.abs(arms[:, column]), end)
        assert (arms[:, column] * drawn[:, column] >= 0).all(), "signs are those drawn"
    others = [k for k in range(arms.shape[1]) if k not in [getattr(COLUMN, field) for field in DRIVE_EFFECTS]]
    np.testing.assert_array_equal(arms[:, others], drawn[:, others])
    assert all(ArmParams.from_row(row) for row in arms), "twice the ranges are within the bounds"


def test_of_size_0_the_drive_is_ideal(drawn: np.ndarray):
    np.testing.assert_array_equal(with_effect(drawn, ALL, 0.0), with_effect(drawn, IDEAL, 1.0))


def test_headings_have_the_upper_ends_with_their_units():
    assert [heading(name) for name in ("command_latency", "torque_ripple")] == [
        "latency 1.5 samples",
        "torque ripple 6 mN m",
    ]


@pytest.mark.parametrize(
    ("config", "kind"), [({"randomization": "ideal"}, "ideal"), ({"randomization": "train"}, "train"), ({}, "unknown")]
)
def test_training_is_read_from_the_policies(config: dict[str, Any], kind: str, tmp_path: Path):
    folder = tmp_path / "other"
    shutil.copytree(POLICIES / "ppo/seed0", folder)
    annotate(folder, config=config)
    (method,) = shipped_methods(["ppo"])
    assert drive.trained_on([replace(method, sources=(str(folder),))]) == {"ppo": kind}
    assert drive.trained_on(shipped_methods(["paper"])) == {}


def test_the_page_tells_kinds_of_training_apart():
    data = _frame.read_data(_frame.RESULTS / "drive")
    pages = {
        _frame.page("drive", drive, data | {"trained": trained})
        for trained in (
            {},
            {"ppo": "ideal"},
            {"ppo": "train"},
            {"ppo": "unknown"},
            {"ppo": "ideal", "student": "train"},
        )
    }
    assert len(pages) == 5


def test_the_ideal_drive_is_that_of_size_0_of_every_effect():
    levels = drive._Levels(_frame.read_data(_frame.RESULTS / "drive"))
    for controller in levels.controllers:
        assert len({levels.rows[controller, effect]["cost"][0] for effect in levels.effects}) == 1


@pytest.mark.parametrize(("option", "wrong"), [("--controllers", "adaptve"), ("--effects", "torque_riple")])
def test_unknown_names_are_mistakes(option: str, wrong: str, tmp_path: Path):
    assert f"'{wrong}'" in mistake(study.main, ("drive", option, wrong), tmp_path)
