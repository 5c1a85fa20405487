"""All studies: each runs as a user runs it, its page comes from its data alone, and freshness sees what changes it."""

import importlib
import json
from pathlib import Path

import pytest
from commands import mistake
from studies import hurry, try_study

from eval import pages, study
from eval.comparison import provenance
from eval.studies import _frame, _pages

NAMES = _frame.names()
SLOW = ("loops", "paper", "physics")
"""Studies of which tests of their own run what measures."""
TRIED = [name for name in NAMES if name != "learning"]  # which has a test of its own


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name for name in TRIED]
)
def test_a_first_try_writes_data_page_and_pictures(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Of the paper without alternatives, see `test_paper.py`; to the last dot in `test_curves_and_speed.py`."""
    hurry(monkeypatch)
    if name == "paper":
        kept = _frame.read_data(_frame.RESULTS / "paper")["alternatives"]
        monkeypatch.setattr("eval.studies.paper.vary", lambda *_: kept)
    try_study(name, tmp_path)


@pytest.mark.parametrize("name", NAMES)
def test_mistakes_are_one_line(name: str, tmp_path: Path):
    for option, (least, _) in _frame.load(name).Options.bounds.items():
        words = (name, f"--{option.replace('_', '-')}", str(least - 1))
        for line in (mistake(study.main, (*words, *more), tmp_path) for more in ((), ("--quick",))):
            assert words[1] in line and words[2] in line
    assert repr(f"{name}s") in mistake(study.main, (f"{name}s",), tmp_path)


@pytest.mark.parametrize("page", _pages.pages(), ids=lambda page: page.name)
def test_the_committed_page_comes_from_the_committed_data(page: _pages.Page):
    data = _frame.read_data(page.committed, page.data)
    written = (page.committed / "page.md").read_text(encoding="utf-8")
    assert written == _frame.text_of(page.name, importlib.import_module(page.module), data)
    if page.name == "comparison":
        readme = _pages.README.read_text(encoding="utf-8")
        assert readme == _pages.updated_readme(readme, data)


def test_data_keep_seven_digits_and_no_infinity(tmp_path: Path):
    _frame.write_data({"a": {"b": 1 / 3, "c": float("nan")}, "rows": [{"x": 1}], "n": 2}, tmp_path)
    written = json.loads((tmp_path / "data.json").read_text())
    assert written == {"a": {"b": 0.3333333, "c": None}, "rows": [{"x": 1}], "n": 2}


IMPORTED = "CONTROL_PERIOD = 1.5e-3"
MODULE = '''"""Words."""
from beltarm_env.timing import CONTROL_PERIOD
SCALE = 2.0
OTHER = 3.0
def helper(x):
    """Words."""
    return SCALE * x  # comment
def measure():
    return helper(CONTROL_PERIOD)
def tables(data):
    return OTHER
'''


@pytest.mark.parametrize(
    ("before", "after", "same"),
    [
        ("Words", "Other words", True),
        ("# comment", "", True),
        ("OTHER = 3.0", "OTHER = 4.0", True),
        ("SCALE = 2.0", "SCALE = 2.5", False),
        ("SCALE * x", "x", False),
        ("from beltarm_env.timing", "from beltarm_env.other", False),
        ("PERIOD = 1.5e-3", "PERIOD = 1e-3", False),  # of the module that is imported
        ("1.0", "2.0", False),  # in C
    ],
)
def test_digest_of_what_measures(before: str, after: str, same: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    digests = set()
    for folder, new in (("own", before), ("other", after)):
        c = "beltarm_env/engine/c/real.h", "#define ONE 1.0"
        for path, text in (("eval/study.py", MODULE), ("beltarm_env/timing.py", IMPORTED), c):
            (tmp_path / folder / path).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / folder / path).write_text(text.replace(before, new))
        monkeypatch.setattr(provenance, "ROOT", tmp_path / folder)
        digests.add(provenance.inputs_digest("eval.study"))
    assert (len(digests) == 1) is same


def test_pages_are_measured_on_a_clean_commit_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(_pages, "commit", lambda: "1234567-dirty")
    assert "1234567-dirty" in mistake(pages.main, ("--measure", "steps"), tmp_path)
    assert "'nothing'" in mistake(pages.main, ("--check", "nothing"), tmp_path)
