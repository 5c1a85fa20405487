"""Controllers over the drive: the effects, and `eval/drive.py` as a user runs it."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import mistake, stopped

from agents.policy.bundle import POLICIES, annotate
from beltarm_env import ArmParams, BeltArmVectorEnv
from beltarm_env.arm import COLUMN, DRIVE_EFFECTS
from beltarm_env.metrics import TORQUE_QUALITY
from beltarm_env.metrics import heading as of_metric
from beltarm_env.task.ranges import DRIVE_RANGES
from eval import drive
from eval.drives.effects import ALL, EFFECTS, IDEAL, heading, with_effect
from eval.drives.page import training
from eval.drives.study import choose_methods, trained_on

PAGE = Path(__file__).parents[2] / "docs/results/drive"


def drawn(count: int) -> np.ndarray:
    env = BeltArmVectorEnv(count, randomization="train")
    env.reset(seed=3)
    return env.params_table


class TestEffects:
    @pytest.mark.parametrize("name", [IDEAL, *EFFECTS])
    @pytest.mark.parametrize("size", [0.5, 2.0])
    def test_arms_have_the_effects_asked_for_and_no_others(self, name: str, size: float):
        table = drawn(6)
        arms = with_effect(table, name, size)
        for field in DRIVE_EFFECTS:
            column = getattr(COLUMN, field)
            end = size * DRIVE_RANGES[field][1] if name in (field, ALL) else 0.0
            np.testing.assert_allclose(np.abs(arms[:, column]), end)
            assert (arms[:, column] * table[:, column] >= 0).all(), "signs are those drawn"
        others = [k for k in range(arms.shape[1]) if k not in [getattr(COLUMN, field) for field in DRIVE_EFFECTS]]
        np.testing.assert_array_equal(arms[:, others], table[:, others])
        assert all(ArmParams.from_row(row) for row in arms), "twice the ranges are within the bounds"

    def test_of_size_0_the_drive_is_ideal(self):
        table = drawn(3)
        np.testing.assert_array_equal(with_effect(table, ALL, 0.0), with_effect(table, IDEAL, 1.0))

    def test_headings_have_the_upper_ends_with_their_units(self):
        assert heading("command_latency") == "latency 1.5 samples"
        assert heading("torque_ripple") == "torque ripple 6 mN m"
        assert heading("friction_drift") == "drift of friction ±15 %"


def manifest_of(method: str) -> dict[str, Any]:
    return json.loads((POLICIES / method / "seed0/policy.json").read_text(encoding="utf-8"))


class TestTraining:
    def test_committed_page_says_what_the_policies_say(self):
        trained = trained_on(choose_methods(()))
        for method, arms in trained.items():
            assert arms == manifest_of(method)["provenance"]["config"]["randomization"]
        provenance = json.loads((PAGE / "results.json").read_text(encoding="utf-8"))["provenance"]
        assert provenance["trained"] == trained
        assert training(trained) in (PAGE / "summary.md").read_text(encoding="utf-8")

    @pytest.mark.parametrize("config", [{"randomization": "ideal"}, {}])
    def test_policies_that_were_trained_otherwise_change_the_page(self, tmp_path: Path, config: dict[str, str]):
        folder = tmp_path / "other"
        shutil.copytree(POLICIES / "ppo/seed0", folder)
        annotate(folder, config=config)
        (method,) = choose_methods(["ppo"])
        other = replace(method, name="other", sources=(str(folder),))
        found = training(trained_on([method, other]))
        assert found.count(".") == 2, "one sentence for each kind of training"
        assert training(trained_on([method])) in found

    def test_without_learned_controllers_there_is_nothing_to_say(self):
        assert training(trained_on(choose_methods(["paper"]))) == ""


@pytest.mark.slow
def test_the_command_writes_the_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    arguments = ("paper", "zvd", "--arms", "4", "--sizes", "1", "2", "--jobs", "1", "--out", "out")
    code, errors = stopped(drive.main, arguments, tmp_path)
    assert code == 0, errors
    folder = tmp_path / "out"
    pictures = {"cost.png", "tip_rms.png", "residual.png"}
    assert {path.name for path in folder.iterdir()} == {"summary.md", "results.json", *pictures}
    page = (folder / "summary.md").read_text(encoding="utf-8")
    assert set(re.findall(r"!\[[^]]*\]\(([^)]*)\)", page)) == pictures
    assert not re.search(r"\b(nan|inf)\b", page)
    results = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    rows = {(row["method"], row["effect"], row["size"]): row for row in results["rows"]}
    assert set(rows) == {(name, effect, size) for name in ("paper", "zvd") for effect in EFFECTS for size in (0, 1, 2)}
    (table,) = (block for block in page.split("\n\n") if block.startswith("| controller"))
    assert table in capsys.readouterr().out
    (torques,) = (block for block in page.split("\n\n") if block.startswith("| torques"))
    assert all(of_metric(name) in torques for name in TORQUE_QUALITY)
    assert [line.split(" | ")[0].strip("| ") for line in torques.splitlines()[2:]] == ["paper", "zvd"]
    cells = {line.split(" | ")[0].strip("| "): line.strip("| ").split(" | ")[1:] for line in table.splitlines()[2:]}
    for name in ("paper", "zvd"):
        places = [(next(iter(EFFECTS)), 0), *((effect, 1) for effect in EFFECTS)]
        costs = [rows[name, effect, size]["metrics"]["cost"] for effect, size in places]
        for cell, cost in zip(cells[name], costs, strict=True):
            shown = re.match(r"(\d+) \((\d+)\)", cell)
            assert shown is not None
            assert [float(number) for number in shown.groups()] == pytest.approx([cost["iqm"], cost["mean"]], abs=0.51)
        assert len({rows[name, effect, 0]["metrics"]["cost"]["iqm"] for effect in EFFECTS}) == 1, "one ideal drive"
        assert rows[name, "command_latency", 1] != rows[name, "command_latency", 2]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("adaptve",), "unknown controller 'adaptve'; did you mean adaptive?"),
        (("--arms", "3"), "--arms must lie within 4 and 1000, got 3"),
        (("--sizes", "1", "2.5"), "--sizes must lie above 0 and at most at 2, got 2.5"),
        (("--sizes", "0.5"), "--sizes must have 1 among them"),
        (("--jobs", "0"), "--jobs must lie within 1 and 256, got 0"),
        (("--out", "/dev/null/x"), "cannot write to /dev/null/x"),
    ],
)
def test_bad_options(arguments: tuple[str, ...], message: str, tmp_path: Path):
    line = mistake(drive.main, arguments, tmp_path)
    assert line.startswith("eval/drive.py: ") and message in line
