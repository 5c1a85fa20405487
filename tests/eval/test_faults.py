"""`eval/faults.py`, and what it says of the guard."""

from pathlib import Path

import numpy as np
import pytest
from commands import mistake
from pages import tables_of

from baselines import PaperController
from beltarm_env.rollout import record
from eval import faults
from eval.guarding import page, study
from eval.guarding.faults import FAULTS, FaultyArms
from eval.guarding.page import MEASURES, Compared, shortfalls
from eval.guarding.study import NAN, Outcome

SEED = 5


@pytest.mark.slow
def test_the_command_writes_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for module in (faults, page, study):
        monkeypatch.setattr(module, "BASES", {"ppo": "paper", "flat": "flat"})
        monkeypatch.setattr(module, "LEARNED", ("ppo",))
    for module in (faults, page):
        monkeypatch.setattr(module, "FAULTS", {name: FAULTS[name] for name in ("stuck encoder", NAN)})
    learned, classical, healthy = tables_of(faults.main, ("nominal",), "peak.png", tmp_path, "--arms", "2")
    assert len(learned.splitlines()) == 2 + 2
    assert len(classical.splitlines()) == 2 + 1 and NAN not in classical
    assert len(healthy.splitlines()) == 2 + 2


def test_what_falls_short_is_said_with_its_numbers():
    good, bad = Outcome(10.0, 0.0, 1.0, 0.0), Outcome(11.5, 2.0, 1.1, 0.0)
    one = Compared("ppo", "payload", good, good, bad)
    assert one.worse == ["peak", "left"]
    text = shortfalls([one, one._replace(guarded=good)])
    assert text.startswith(f"In {2 * len(MEASURES) - 2} of {2 * len(MEASURES)} comparisons")
    assert "`ppo`, payload: peak tip error (mm) 11.5 against 10.0 of `paper` alone" in text
    assert "In all 3 comparisons" in shortfalls([one._replace(guarded=good)])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--arms", "0"), "--arms must lie within 1 and 10000, got 0"),
        (("--splits", "nominl"), "unknown split 'nominl'; did you mean nominal?"),
    ],
)
def test_bad_options(arguments: tuple[str, ...], message: str, tmp_path: Path):
    line = mistake(faults.main, arguments, tmp_path)
    assert line.startswith("eval/faults.py: ") and message in line


def test_unknown_fault():
    with pytest.raises(ValueError, match="no fault 'rust'; there are none, stuck encoder"):
        FaultyArms(1, "rust")


def test_an_arm_that_leaves_changes_nothing_for_the_others():
    few, many = (
        record(PaperController(), FaultyArms(arms, "sign error", randomization="train"), seed=SEED) for arms in (2, 8)
    )
    assert not many.finished[2:].all()
    np.testing.assert_array_equal(few.state, many.state[:, :2])
