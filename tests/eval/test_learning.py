"""The study of learning: what it varies, runs that are kept, go on or are refused, and its tables and picture."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from commands import mistake
from refusals import refused
from studies import hurry, try_study

from agents.learners.registry import ALGORITHMS
from baselines.tools.options import parse
from beltarm_env import EPISODE_STEPS
from eval import study
from eval.studies import _frame, learning
from eval.studies.learning.runs import DEFAULT, VARIANTS, Run, Variant, begun_options


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, dict[str, Any]]:
    """The run of a first try of the study, and its result; `test_curves_and_speed.py` computes levels of curves."""
    folder, kept = tmp_path_factory.mktemp("learning"), _frame.read_data(_frame.RESULTS / "learning")["shipped_levels"]
    with pytest.MonkeyPatch.context() as patch:
        hurry(patch)
        patch.setattr(learning, "levels", lambda _: kept)
        try_study("learning", folder)
    run = Run(DEFAULT, 0, 5_000, folder / learning.QUICK["runs"], quick=True)
    result = run.finished(4)
    assert result is not None
    return run, result


def test_every_variant_simulates_as_many_samples(tmp_path: Path):
    for variant in VARIANTS:
        script, *options = Run(variant, 0, 8_000_000, tmp_path).words
        config = parse(ALGORITHMS[Path(script).stem], arguments=options, begun=begun_options)
        config.check()
        assert config.length * config.hold == pytest.approx(8_000_000, rel=0.01), variant.name
    (memoryless,) = [variant for variant in VARIANTS if variant.name == "gru-0"]
    command = Run(memoryless, 1, 96_000, tmp_path).command
    assert command == "python train/student.py --arms 2 --rounds 8 --gru-width 0 --validation-arms 32 --seed 1"


def test_runs_are_read_or_go_on(done: tuple[Run, dict[str, Any]], tmp_path: Path):
    run, result = done
    assert result["curve"][-1][0] == 2 * 4 * EPISODE_STEPS
    shutil.copytree(run.runs, tmp_path / "runs")
    copied = Run(DEFAULT, 0, 5_000, tmp_path / "runs", quick=True)
    (copied.folder / "ablation.json").unlink()
    again = copied.finish(4)
    assert again["scores"] == result["scores"] and result["scores"]["left_percent"] == 0
    assert [point[0] for point in again["curve"]] == [point[0] for point in result["curve"]]
    assert run.finished(4) == result


def test_runs_of_another_command_or_other_code_are_refused(done: tuple[Run, dict[str, Any]], tmp_path: Path):
    shutil.copytree(done[0].runs, tmp_path / "runs")
    run = Run(DEFAULT, 0, 5_000, tmp_path / "runs", quick=True)
    kept = json.loads((record := run.folder / "ablation.json").read_text())
    for other, arms in ((Run(DEFAULT, 0, 50_000, run.runs, quick=True), 4), (run, 5)):
        refused(ValueError, ("--runs",), lambda other=other, arms=arms: other.finished(arms))
    for wrong in ([], {}):
        record.write_text(json.dumps(wrong))
        refused(ValueError, ("damaged",), lambda: run.finished(4))
    record.write_text(json.dumps(kept))
    run.folder.with_suffix(".code").write_text("other")
    refused(ValueError, ("other code", "--runs"), lambda: run.finished(4))
    refused(ValueError, ("begun by other code", "--runs"), lambda: run.finish(4))
    bad = Run(Variant("bad", "limit", "bad", ("--residual-limit", "3")), 0, 5_000, tmp_path, quick=True)
    refused(ValueError, ("bad, seed 0: ", "3.0"), lambda: bad.finish(4))


@pytest.mark.parametrize("words", [("--jobs", "0"), ("--only", "gru-O")])
def test_bad_options(words: tuple[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(learning, "calls_side_by_side", None)  # nothing is trained before
    line = mistake(study.main, ("learning", *words), tmp_path)
    assert words[0] in line and words[1] in line
