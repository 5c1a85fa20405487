"""Mutants are made, tried and told of; what is committed about them is up to date."""

from contextlib import nullcontext
from pathlib import Path

import pytest
from commands import mistake

from eval import mutants
from eval.mutation import study
from eval.mutation.mutants import Mutant, drawn
from eval.mutation.page import Judgement, judgements, markdown
from eval.mutation.study import Tried
from eval.mutation.subjects import SUBJECTS
from eval.mutation.trial import trials

ROOT = Path(__file__).resolve().parents[2]
SENSORS = "beltarm_env/task/sensors.py"
COUNTS = "tests/env/test_sensors.py::TestCounting::test_one_count_per_sample_is_about_one_radian_per_second"


@pytest.mark.parametrize("module", SUBJECTS)
def test_tests_of_a_module_are_there(module: str):
    assert (ROOT / module).is_file()
    for test in SUBJECTS[module]:
        file, *names = test.partition("[")[0].split("::")
        text = (ROOT / file).read_text(encoding="utf-8")
        assert all(f"class {name}" in text or f"def {name}(" in text for name in names), test


def test_judgements_are_of_lines_that_there_are():
    for module, judged in judgements().items():
        assert module in SUBJECTS
        lines = {" ".join(line.split()) for line in (ROOT / module).read_text(encoding="utf-8").splitlines()}
        for judgement in judged:
            assert judgement.before in lines, f"{module}: {judgement.before}"
            assert judgement.after != judgement.before and judgement.why.endswith(".")


@pytest.mark.slow
def test_a_mutant_is_killed_and_the_checkout_stays_as_it_is():
    source = (ROOT / SENSORS).read_text(encoding="utf-8")
    with trials(SENSORS, [COUNTS]) as seconds:
        assert seconds(source.replace("3.0 * change", "4.0 * change"), 300), "another test would find it"
        assert seconds(source.replace("ENCODER_COUNTS = 4000", "ENCODER_COUNTS = 4001"), 300) is None
        assert seconds("while True:\n    pass\n", 1) is None
    assert (ROOT / SENSORS).read_text(encoding="utf-8") == source


def test_mutants_leave_alone_what_is_no_behaviour():
    pytest.importorskip("cosmic_ray")
    source = '''"""1 + 1."""
from __future__ import annotations
import dataclasses

@dataclasses.dataclass(frozen=True)
class Few:
    many: int | None = None

def least(a: int | None, b: int) -> int | None:
    if a is None:
        raise ValueError(f"{b + 1}")
    return a - b
'''
    found = drawn(source, 100)
    assert {(mutant.function, mutant.before) for mutant in found} == {
        ("least", "if a is None:"),
        ("least", "return a - b"),
    }
    assert ("return a - b", "return a + b") in {(mutant.before, mutant.after) for mutant in found}
    more = drawn(source.replace("least(a", "least(  a") + "\nx = 1\n", 100)
    assert [mutant.name for mutant in more if mutant.function] == [mutant.name for mutant in found], "order, too"


def test_a_run_goes_on_where_it_was_interrupted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    pytest.importorskip("cosmic_ray")
    asked, stopped_after = [], 5

    def seconds(source: str, _: float) -> float | None:
        asked.append(source)
        if len(asked) == stopped_after:
            raise KeyboardInterrupt
        sound = source == (ROOT / SENSORS).read_text(encoding="utf-8")
        return 1.0 if sound or "ROUNDER) + ROUNDER" in source else None

    monkeypatch.setattr(study, "trials", lambda *_: nullcontext(seconds))
    with pytest.raises(KeyboardInterrupt):
        study.tried(SENSORS, [COUNTS], 100, tmp_path / "kept.json")
    found = study.tried(SENSORS, [COUNTS], 100, tmp_path / "kept.json")
    assert [one.after for one in found.survivors] == ["return (angle / resolution + ROUNDER) + ROUNDER"]
    assert len(asked) <= len(found.mutants) + 4, "one is tried twice, and the source itself; a survivor always is"
    asked.clear()
    assert study.tried(SENSORS, [COUNTS], 100, tmp_path / "kept.json") == found
    assert len(asked) == 2


def test_tests_that_fail_without_a_fault_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    pytest.importorskip("cosmic_ray")
    monkeypatch.setattr(study, "trials", lambda *_: nullcontext(lambda *_: None))
    with pytest.raises(ValueError, match="fail, or take more than 600 s, without a fault"):
        study.tried(SENSORS, [COUNTS], 1, tmp_path / "kept.json")


def test_the_page():
    known = Judgement("f", "a = b", "a = -b", True, "It is squared.")
    found = [Mutant("f", "a = b", after, "") for after in ("a = -b", "a = 1", "a = 2")]
    page = markdown([Tried("x.py", found, found[:2])], "origin", {"x.py": [known]})
    assert "| x.py | 3 | 1 | 2 | 1 | 50% |" in page
    assert "In `f`, equivalent: It is squared.\n\n```diff\n-a = b\n+a = -b\n```" in page
    assert "In `f`, not found: Not judged yet." in page and page.endswith("origin\n")


def test_mistakes_are_named(tmp_path: Path):
    assert "there is no module 'moon'" in mistake(mutants.main, ("--modules", "moon"), tmp_path)
    assert "--count must be at least 1, got 0" in mistake(mutants.main, ("--count", "0"), tmp_path)
