"""The tuner: the search on small problems, its margins, the file of gains, and the command as a user runs it."""

import itertools
import math
import signal
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pytest
from commands import ROOT, mistake, started
from optuna.trial import TrialState
from refusals import refused
from waiting import until

from baselines import TUNABLE, PaperController, PaperGains, gains
from baselines.engines.parallel import Channel
from baselines.gains import FILE, Gains, read_file, tunable, tuned, write_entry
from baselines.loops.condition import MarginCondition
from baselines.loops.laws import LAWS, retuned_law
from baselines.servo.paper import RetunedController, RetunedGains
from baselines.tune import main
from baselines.tuning.search import RUNGS, SearchProgress, Terms, estimate, search, split_budget
from baselines.tuning.study import begin_anew, own, storage_in
from beltarm_env import EPISODE_STEPS
from beltarm_env.engine.library import ANNOUNCEMENT

SCRIPT = str(ROOT / "baselines/tune.py")
NAMES = tuple(TUNABLE)[:2]
BATCH = RUNGS[0] * EPISODE_STEPS
MIN_BUDGET = RUNGS[-1] * EPISODE_STEPS * 5 // 4


@dataclass(frozen=True)
class OneGain(Gains):
    vibration: float = tunable(0.05, 0.01, 1.0, log=True)


class Counting(PaperController):
    """The paper's controller, counting the steps of single arms that it sees."""

    gains_type, steps = OneGain, 0

    def __init__(self, gains: OneGain) -> None:
        super().__init__(gains=PaperGains(torsion_speed=gains.vibration, angle=400, speed=40))
        self.vibration = gains.vibration

    def predict(self, observation: Any, *rest: Any, **named: Any) -> Any:
        Counting.steps += len(observation)
        return super().predict(observation, *rest, **named)


class Fragile(Counting):
    def __init__(self, gains: OneGain) -> None:
        super().__init__(gains)
        if gains.vibration > 0.3:
            raise RuntimeError("no solution")

    def predict(self, observation: Any, *rest: Any, **named: Any) -> Any:
        action, state = super().predict(observation, *rest, **named)
        return action + np.float32(math.nan if self.vibration < 0.03 else 0.0), state


@dataclass(frozen=True)
class BadGain(Gains):
    vibration: float = tunable(0.5, 0.01, 1.0)


@dataclass(frozen=True)
class TwoGains(Gains):
    angle: float = tunable(60.0, 10.0, 10_000.0, log=True)
    torsion_speed: float = tunable(0.001, 1e-4, 0.2, log=True)


class Watched(RetunedController):
    """The retuned controller with two gains free, keeping all gains that are simulated."""

    gains_type = TwoGains
    simulated: set[TwoGains] = set()  # noqa: RUF012

    def __init__(self, gains: TwoGains = TwoGains()) -> None:
        self.gains_type = RetunedGains  # type: ignore[misc]  of what it is made with
        super().__init__(RetunedGains(angle=gains.angle, torsion_speed=gains.torsion_speed, speed=30.0))
        self.free = gains

    def predict(self, *arguments: Any, **named: Any) -> Any:
        Watched.simulated.add(self.free)
        return super().predict(*arguments, **named)


LAWS[Watched] = retuned_law


def interrupted_after(calls: int) -> Channel:
    """Channel that interrupts a search after so many reports of its progress."""
    reports = itertools.count()

    def interrupt(_: SearchProgress) -> None:
        if next(reports) == calls:
            raise KeyboardInterrupt

    return Channel(interrupt)


def test_a_search_keeps_its_budget_and_helps(tmp_path: Path):
    moves, reported = 2, list[SearchProgress]()
    budget = 3 * moves * MIN_BUDGET + 1
    Counting.steps = 0
    first = search(Counting, Terms(budget, 3, moves), tmp_path / "journal", Channel(reported.append))
    assert first.steps == Counting.steps == reported[-1].steps <= budget
    assert split_budget(budget, moves)[0] - RUNGS[-1] * moves * EPISODE_STEPS < reported[-1].steps
    assert first.trials == reported[-1].trials and first.failed == 0
    assert first.cost < first.cost_untuned and 0 < first.pruned < first.trials
    more = search(Counting, Terms(budget + moves * MIN_BUDGET, 3, moves), tmp_path / "journal")
    assert more.steps == Counting.steps > first.steps and more.trials > first.trials


def finished(journal: Path) -> list[tuple[Any, ...]]:
    trials = optuna.load_study(study_name=None, storage=storage_in(journal)).get_trials(states=(TrialState.COMPLETE,))
    return [(trial.params, trial.value, trial.intermediate_values) for trial in trials]


def test_interrupted_search_is_the_uninterrupted_one(tmp_path: Path):
    """Wherever it is interrupted, at the first of its draws too: what was begun is repeated, nothing else is drawn."""
    journal, budget = tmp_path / "journal", 4 * MIN_BUDGET
    for calls in (0, 2, 3):
        with pytest.raises(KeyboardInterrupt):
            search(Counting, Terms(budget), journal, interrupted_after(calls))
    Counting.steps = 0
    result = search(Counting, Terms(budget), journal)
    assert result.steps <= budget
    assert 4 * BATCH <= result.steps - Counting.steps <= 6 * BATCH  # all but the batches that were interrupted
    search(Counting, Terms(budget + MIN_BUDGET), tmp_path / "whole")
    ours, theirs = (finished(path) for path in (journal, tmp_path / "whole"))
    assert 3 < len(ours) < len(theirs) and ours == theirs[: len(ours)] and ours[0][0] == asdict(OneGain())
    Counting.steps = 0
    assert search(Counting, Terms(budget), journal) == result and Counting.steps == 0
    for other, seed, words in ((MIN_BUDGET, 0, "--budget"), (budget, 1, "seed 0, not 1")):
        refused(ValueError, (words,), partial(search, Counting, Terms(other, seed), journal))


def test_a_search_that_is_killed_in_the_middle_of_a_line_goes_on(tmp_path: Path):
    journal = tmp_path / "journal"
    result = search(Counting, Terms(MIN_BUDGET), journal)
    written = journal.read_bytes()
    for end in (len(written) - 1, written.index(b"\n") + 100, written.index(b"\n") - 1):
        journal.write_bytes(written[:end])
        assert all(search(Counting, Terms(MIN_BUDGET), journal).gains == result.gains for _ in range(2))
    for damage in ("notes of somebody", "not a journal\n" * 2):
        journal.write_text(damage)
        refused(ValueError, (str(journal), "damaged"), lambda: search(Counting, Terms(MIN_BUDGET), journal))
        assert journal.read_text() == damage


def test_journal_of_another_search_is_left_alone(tmp_path: Path):
    journal, optuna_lock = tmp_path / "journal", tmp_path / "journal.lock"
    with own(journal):
        journal.write_text("theirs")
        optuna_lock.write_text("")
        for attempt in (lambda: search(Counting, Terms(MIN_BUDGET), journal), lambda: begin_anew(journal)):
            refused(ValueError, ("another process", str(journal)), attempt)
        assert journal.read_text() == "theirs" and optuna_lock.exists()
    begin_anew(journal)
    assert not journal.exists() and not optuna_lock.exists()


def test_controllers_that_fail_are_survived_but_not_untuned(tmp_path: Path):
    actual = search(Fragile, Terms(4 * MIN_BUDGET), tmp_path / "journal")
    assert actual.failed > 0 and 0.03 <= actual.gains["vibration"] <= 0.3
    assert actual.steps <= 4 * MIN_BUDGET
    for kind, condition, words in (
        (type("Bad", (Fragile,), {"gains_type": BadGain}), None, ("untuned gains", "no solution")),
        (Watched, MarginCondition(modulus=0.9), ("modulus=", "TwoGains")),
    ):
        path = tmp_path / kind.__name__
        refused(ValueError, words, partial(search, kind, Terms(MIN_BUDGET, condition=condition), path))


def test_an_interrupted_search_with_margins_goes_on_and_simulates_nothing_that_falls_short(tmp_path: Path):
    condition, journal, progress = MarginCondition(), tmp_path / "journal", list[SearchProgress]()
    Watched.simulated.clear()
    terms = Terms(6 * MIN_BUDGET, condition=condition)
    with pytest.raises(KeyboardInterrupt):
        search(Watched, terms, journal, interrupted_after(11))
    result = search(Watched, terms, journal, Channel(progress.append))
    assert result.refused > 0 and result.steps <= terms.budget
    assert any(before.steps == after.steps for before, after in itertools.pairwise(progress)), "a refusal costs none"
    assert TwoGains(**result.gains) in Watched.simulated
    assert {condition.shortfall(Watched(gains)) for gains in Watched.simulated} == {0.0}
    assert search(Watched, terms, journal) == result
    for other in (None, MarginCondition(modulus=0.3)):
        refused(ValueError, ("margins",), partial(search, Watched, terms._replace(condition=other), journal))


def test_estimates_take_the_difficulty_of_the_arms_out():
    best = np.random.default_rng(0).lognormal(6, 1, RUNGS[-1])
    few = best[: RUNGS[0]]
    assert all(estimate(costs + 10, best) == pytest.approx(best.mean() + 10) for costs in (few, best))
    assert estimate(few, np.empty(0)) == few.mean()


def test_gains_are_written_beside_others_and_refused_where_wrong(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "gains.json"
    monkeypatch.setattr(gains, "FILE", path)
    write_entry("b", OneGain(0.5), {"seed": 1}, path)
    write_entry("a", OneGain(0.25), {}, path)
    write_entry("b", OneGain(0.75), {"seed": 2}, path)
    with pytest.raises(TypeError):
        write_entry("a", OneGain(0.5), {"seed": object()}, path)
    assert list(read_file(path).items()) == [
        ("a", {"gains": {"vibration": 0.25}, "provenance": {}}),
        ("b", {"gains": {"vibration": 0.75}, "provenance": {"seed": 2}}),
    ]
    assert [file.name for file in tmp_path.iterdir()] == ["gains.json"]
    for text, words in (
        (b'{"vibrating": {"gains": {"K": 1}}}', ("K", "vibration")),
        (b'{"vibrating": {"gains": {"vibration": 2}}}', ("OneGain.vibration", "2")),
        (b'{"vibrating": {"gains": {"vibration": "1"}}}', ("OneGain.vibration", "'1'")),
        *((text, ("gains.json", "damaged")) for text in (b'{"vibrating": {}}', b"[]", b'{"vibrating": ', b"\xff")),
    ):
        path.write_bytes(text)
        refused(ValueError, words, lambda: tuned("vibrating", OneGain))


@pytest.fixture
def tune(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., dict[str, Any]]]:
    """The command in a folder of its own, within this process: its words, to the entries of the file of gains."""
    monkeypatch.chdir(tmp_path)
    before = signal.getsignal(signal.SIGTERM)

    def run(*words: str) -> dict[str, Any]:
        monkeypatch.setattr(sys, "argv", [SCRIPT, *words])
        main()
        return read_file(tmp_path / "gains.json")

    yield run
    signal.signal(signal.SIGTERM, before)


def test_interrupted_command_leaves_the_file_and_goes_on(tmp_path: Path, tune: Any, capsys: pytest.CaptureFixture[str]):
    name, out, journal = NAMES[0], tmp_path / "gains.json", tmp_path / "results" / "tune" / f"{NAMES[0]}.journal"
    out.write_text("{}")
    words = (name, "--moves", "1", "--out", "gains.json")
    process = started(SCRIPT, *words, cwd=tmp_path)
    until(lambda: journal.exists() and '"step":127' in journal.read_text(), 300)
    process.send_signal(signal.SIGTERM)
    output, errors = process.communicate(timeout=300)
    assert process.returncode == 130 and errors.replace(f"{ANNOUNCEMENT}\n", "") == "", errors
    assert f"python baselines/tune.py {' '.join(words)} --resume" in output and out.read_text() == "{}"
    size, budget = journal.stat().st_size, 2 * MIN_BUDGET
    words = (*words, "--resume", "--budget", str(budget))
    origin = tune(*words)[name]["provenance"]
    assert capsys.readouterr().err == ""
    assert journal.stat().st_size > size and origin["command"] == f"python baselines/tune.py {' '.join(words)}"
    assert 0 < origin["steps"] <= budget == origin["budget"] and origin["cost"] <= origin["cost_untuned"]
    assert {"trials", "refused", "seconds", "measured_on", "date", "version", "commit"} <= {*origin}
    wanted, reached = origin["margins"], origin["margins"]["reached"]
    assert reached["modulus"] >= wanted["modulus"] == 0.4 and reached["delay_samples"] >= wanted["delay"] == 1.0
    assert reached["modulus_at"].rsplit(", ", 1)[0] in wanted["arms"]


def test_a_resumed_search_keeps_options_it_is_not_given(tmp_path: Path, tune: Any, capsys: pytest.CaptureFixture[str]):
    name, other = NAMES
    limits = ("--moves", "1", "--budget", str(MIN_BUDGET + BATCH))
    options = ("--no-margins", *limits, "--seed", "3", "--out", "gains.json")
    first = tune(name, *options)[name]
    assert capsys.readouterr().err == ""
    assert (first["provenance"]["margins"], first["provenance"]["refused"]) == ("not asked for", 0)
    (tmp_path / "gains.json").unlink()
    again = tune(name, "--resume")[name]
    assert again["gains"] == first["gains"]
    for kept in ("budget", "moves", "seed", "steps", "margins"):
        assert again["provenance"][kept] == first["provenance"][kept]
    assert tune(name, "--resume", "--budget", str(MIN_BUDGET + 2 * BATCH))[name]["provenance"]["moves"] == 1
    tune(other, "--no-margins", "--moves", "1", "--budget", str(MIN_BUDGET), "--out", "gains.json")
    assert "seed" in mistake(main, (name, "--seed", "4", "--resume"), tmp_path)
    together = mistake(main, (*NAMES, "--resume"), tmp_path)
    assert name in together and other in together


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "--all"),
        ((NAMES[0] + "x",), f"'{NAMES[0]}'"),
        ((NAMES[0], "--budget", "1000"), "--budget"),
        ((NAMES[0], "--seed", "-1"), "--seed"),
        ((NAMES[0], "--moves", "0"), "--moves"),
        ((NAMES[0], "--resume"), "--resume"),
        ((NAMES[0], "--no-margins", "--out", str(FILE.parent / "tuning" / ".." / FILE.name)), "--no-margins"),
        ((NAMES[0], "--out", "/dev/null/gains.json"), "/dev/null"),
        ((NAMES[0], "--journals", "/dev/null/x"), "/dev/null/x"),
        ((NAMES[0], "--out", "damaged.json"), "damaged.json"),
    ],
)
def test_bad_options(arguments: tuple[str, ...], words: str, tmp_path: Path):
    (tmp_path / "damaged.json").write_text("{")
    assert words in mistake(main, arguments, tmp_path)
    assert [file.name for file in tmp_path.iterdir() if file.suffix == ".json"] == ["damaged.json"]
