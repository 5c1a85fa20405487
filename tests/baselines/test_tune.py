"""The tuner: the search on small problems, the file of gains, and the command as a user runs it."""

from __future__ import annotations

import json
import math
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from baselines import TUNABLE, PaperController, PaperGains
from baselines.engines.parallel import Channel, Interrupted, StopRequest
from baselines.gains import Gains, Tunable, read_file, tunable, tuned, write_entry
from baselines.tune import Config, main
from baselines.tuning import run
from baselines.tuning.race import MAX_CHOICE_ARMS, MIN_BUDGET, RUNGS, charged, estimate, hopeless, split_budget
from baselines.tuning.search import SearchProgress, SearchResult, search
from baselines.tuning.study import begin_anew, open_study, rounded, space
from beltarm_env import EPISODE_STEPS
from beltarm_env.jit import ANNOUNCEMENT
from beltarm_env.task.seeds import GAIN_CHOICE, GAIN_SEARCH

ROOT = Path(__file__).resolve().parents[2]
NAMES = tuple(TUNABLE)[:2]
BATCH = RUNGS[0] * EPISODE_STEPS


@dataclass(frozen=True)
class OneGain(Gains):
    vibration: float = tunable(0.05, 0.01, 1.0, log=True)


class Counting:
    """The paper's controller, counting the steps of single arms that it sees."""

    steps = 0

    def __init__(self, gains: OneGain) -> None:
        self._controller = PaperController(gains=PaperGains(torsion_speed=gains.vibration, angle=400, speed=40))

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        Counting.steps += len(observation)
        return self._controller.predict(observation, state, episode_start, deterministic)


class Fragile(Counting):
    """Raises with some gains and returns NaN with others."""

    def __init__(self, gains: OneGain) -> None:
        super().__init__(gains)
        if gains.vibration > 0.3:
            raise RuntimeError("no solution")
        self._offset = math.nan if gains.vibration < 0.03 else 0.0

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        action, state = super().predict(observation, state, episode_start, deterministic)
        return action + np.float32(self._offset), state


# The search


@pytest.mark.parametrize("budget", [MIN_BUDGET, 3 * MIN_BUDGET + 1])
def test_budget_is_kept_and_counted(budget: int, tmp_path: Path):
    Counting.steps = 0
    told: list[SearchProgress] = []
    found = search(Tunable(Counting, OneGain), budget, 0, tmp_path / "journal", Channel(told.append))
    assert found.steps == Counting.steps == told[-1].steps <= budget
    assert split_budget(budget).search - BATCH < told[-1].steps
    assert found.cost <= found.cost_untuned
    assert found.trials == told[-1].trials and found.failed == 0


def test_same_seed_finds_the_same_gains_and_tuning_helps(tmp_path: Path):
    first, second = (search(Tunable(Counting, OneGain), 3 * MIN_BUDGET, 3, tmp_path / name) for name in "ab")
    assert (first.gains, first.cost, first.trials) == (second.gains, second.cost, second.trials)
    assert first.cost < first.cost_untuned
    assert 0 < first.pruned < first.trials


def test_interrupted_search_goes_on(tmp_path: Path):
    def interrupt(state: SearchProgress) -> None:
        if state.steps >= 5 * BATCH:
            raise KeyboardInterrupt

    journal, kind = tmp_path / "journal", Tunable(Counting, OneGain)
    with pytest.raises(KeyboardInterrupt):
        search(kind, 4 * MIN_BUDGET, 0, journal, Channel(interrupt))
    Counting.steps = 0
    found = search(kind, 4 * MIN_BUDGET, 0, journal)
    assert 4 * BATCH <= found.steps - Counting.steps <= 5 * BATCH  # all but the batch that was interrupted
    assert found.steps <= 4 * MIN_BUDGET
    Counting.steps = 0
    assert search(kind, 4 * MIN_BUDGET, 0, journal) == found
    assert Counting.steps == 0
    with pytest.raises(ValueError, match=r"holds more steps than --budget"):
        search(kind, MIN_BUDGET, 0, journal)
    with pytest.raises(ValueError, match=r"started with another seed"):
        search(kind, 4 * MIN_BUDGET, 1, journal)
    journal.write_text("not a journal\n" * 2)
    with pytest.raises(ValueError, match=r"journal is damaged"):
        search(kind, 4 * MIN_BUDGET, 0, journal)


def test_a_search_that_is_killed_in_the_middle_of_a_line_goes_on(tmp_path: Path):
    journal, kind = tmp_path / "journal", Tunable(Counting, OneGain)
    found = search(kind, MIN_BUDGET, 0, journal)
    written = journal.read_bytes()
    for end in (len(written) - 1, written.index(b"\n") + 100, written.index(b"\n") - 1):
        journal.write_bytes(written[:end])
        assert search(kind, MIN_BUDGET, 0, journal).gains == found.gains
        assert search(kind, MIN_BUDGET, 0, journal).gains == found.gains
    journal.write_text("notes of somebody")
    with pytest.raises(ValueError, match=r"journal is damaged"):
        search(kind, MIN_BUDGET, 0, journal)
    assert journal.read_text() == "notes of somebody"


def test_search_interrupted_in_its_first_trial_begins_with_the_untuned_gains(tmp_path: Path):
    def interrupt(_: SearchProgress) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        search(Tunable(Counting, OneGain), MIN_BUDGET, 0, tmp_path / "journal", Channel(interrupt))
    found = search(Tunable(Counting, OneGain), MIN_BUDGET, 0, tmp_path / "journal")
    assert found.gains == asdict(OneGain()) and found.trials == 1


def test_search_that_is_asked_to_stop_does_so_after_the_batch(tmp_path: Path):
    stop = StopRequest()
    stop.made = True
    Counting.steps = 0
    with pytest.raises(Interrupted):
        search(Tunable(Counting, OneGain), MIN_BUDGET, 0, tmp_path / "journal", Channel(stop=stop))
    assert Counting.steps == BATCH


def test_journal_of_another_search_is_left_alone(tmp_path: Path):
    """Its journal, and the lock by which Optuna writes to it."""
    journal, optuna_lock = tmp_path / "journal", tmp_path / "journal.lock"
    code = f"""
import sys, time
sys.path.insert(0, {str(ROOT)!r})
from pathlib import Path
from baselines.tuning.study import own
with own(Path({str(journal)!r})):
    print("held", flush=True)
    time.sleep(300)
"""
    other = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert other.stdout is not None and other.stdout.readline() == "held\n"
    journal.write_text("theirs")
    optuna_lock.write_text("")
    for attempt in (lambda: search(Tunable(Counting, OneGain), MIN_BUDGET, 0, journal), lambda: begin_anew(journal)):
        with pytest.raises(ValueError, match=r"another process tunes with .*journal: wait for it"):
            attempt()
    assert journal.read_text() == "theirs" and optuna_lock.exists()
    other.kill()
    other.communicate()
    begin_anew(journal)
    assert not journal.exists() and not optuna_lock.exists()


def test_controllers_that_fail_are_survived(tmp_path: Path):
    found = search(Tunable(Fragile, OneGain), 4 * MIN_BUDGET, 0, tmp_path / "journal")
    assert found.failed > 0
    assert 0.03 <= found.gains["vibration"] <= 0.3
    assert found.steps <= 4 * MIN_BUDGET


def test_controller_that_fails_untuned_is_an_error(tmp_path: Path):
    @dataclass(frozen=True)
    class Bad(Gains):
        vibration: float = tunable(0.5, 0.01, 1.0)

    with pytest.raises(ValueError, match=r"the controller fails with its untuned gains: no solution"):
        search(Tunable(Fragile, Bad), MIN_BUDGET, 0, tmp_path / "journal")


def test_estimate_takes_the_difficulty_of_the_arms_out():
    best = np.random.default_rng(0).lognormal(6, 1, RUNGS[-1])
    assert estimate(best[: RUNGS[0]] + 10, best) == pytest.approx(best.mean() + 10)
    assert estimate(best + 10, best) == pytest.approx(best.mean() + 10)
    assert estimate(best[: RUNGS[0]], np.empty(0)) == best[: RUNGS[0]].mean()


def test_only_what_is_clearly_worse_is_hopeless():
    best = np.random.default_rng(0).lognormal(6, 1, RUNGS[-1])
    noise = np.tile([-100.0, 100.0], RUNGS[0] // 2)
    assert hopeless(best[: RUNGS[0]] + noise + 50, best)
    assert not hopeless(best[: RUNGS[0]] + noise + 5, best)
    assert not hopeless(best[: RUNGS[0]] - 50, best)
    assert not hopeless(best[: RUNGS[0]] + 1000, np.empty(0))


def test_arms_are_those_of_tuning():
    assert RUNGS[-1] <= GAIN_SEARCH.size and MAX_CHOICE_ARMS <= GAIN_CHOICE.size


@pytest.mark.parametrize("name", TUNABLE)
def test_every_controller_can_be_searched(name: str):
    kind = TUNABLE[name].gains
    assert set(space(kind)) == {gain.name for gain in fields(kind)}
    assert rounded(asdict(kind()), kind) == kind()


def test_gains_are_rounded_within_their_range():
    assert rounded({"vibration": 0.123456789}, OneGain) == OneGain(0.123457)
    assert rounded({"vibration": 0.99999999}, OneGain) == OneGain(1.0)


# The file of gains


def test_entry_is_written_beside_the_others(tmp_path: Path):
    path = tmp_path / "gains.json"
    write_entry("b", OneGain(0.5), {"seed": 1}, path)
    write_entry("a", OneGain(0.25), {}, path)
    write_entry("b", OneGain(0.75), {"seed": 2}, path)
    assert read_file(path) == {
        "a": {"gains": {"vibration": 0.25}, "provenance": {}},
        "b": {"gains": {"vibration": 0.75}, "provenance": {"seed": 2}},
    }
    assert list(read_file(path)) == ["a", "b"]
    assert [file.name for file in tmp_path.iterdir()] == ["gains.json"]


def test_failed_write_leaves_the_old_file(tmp_path: Path):
    path = tmp_path / "gains.json"
    write_entry("a", OneGain(), {}, path)
    before = path.read_bytes()
    with pytest.raises(TypeError):
        write_entry("a", OneGain(0.5), {"seed": object()}, path)
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["gains.json"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"vibrating": {"gains": {"K": 1}}}', r"gains K for 'vibrating', but it needs vibration: run `"),
        ('{"vibrating": {"gains": {"vibration": 2}}}', r"OneGain.vibration must lie within 0.01 and 1, got 2; run"),
        ('{"vibrating": {"gains": {"vibration": "1"}}}', r"OneGain.vibration must be a number, got '1'; run"),
        ('{"vibrating": {}}', r"gains.json is damaged \(no gains by controller\)"),
        ("[]", r"gains.json is damaged \(no gains by controller\)"),
        ('{"vibrating": ', r"gains.json is damaged \(Expecting value"),
        ("\udcff", r"gains.json is damaged \('utf-8'"),
    ],
)
def test_gains_that_do_not_fit(text: str, message: str, tmp_path: Path):
    path = tmp_path / "gains.json"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(ValueError, match=message):
        tuned("vibrating", OneGain, path)


def test_controller_that_has_not_been_tuned_has_its_defaults():
    assert tuned("no such controller", OneGain) == OneGain()


@pytest.mark.parametrize("arguments", [(2, 0, 1), (0, 1, 2), (0, 0, 1, True), (math.nan, 0, 1)])
def test_gains_without_a_range_are_refused(arguments: tuple[Any, ...]):
    with pytest.raises(ValueError, match=r"a gain needs a range .*around its default, got"):
        tunable(*arguments)


# The command


@pytest.mark.slow
def test_command_writes_gains_with_their_provenance(tmp_path: Path):
    other = {"gains": {"x": 1.0}, "provenance": {"seed": 4}}
    (tmp_path / "gains.json").write_text(json.dumps({"another": other}))
    budget = MIN_BUDGET + BATCH
    options = ("--budget", str(budget), "--seed", "7", "--out", "gains.json")
    script = [sys.executable, str(ROOT / "baselines/tune.py"), *NAMES, *options]
    result = subprocess.run(script, cwd=tmp_path, capture_output=True, text=True, timeout=600, check=False)
    assert result.returncode == 0, result.stderr
    assert result.stderr.replace(f"{ANNOUNCEMENT}\n", "") == ""
    entries = read_file(tmp_path / "gains.json")
    assert entries.pop("another") == other
    assert set(entries) == set(NAMES)
    for name in NAMES:
        TUNABLE[name].gains(**entries[name]["gains"])
        origin = entries[name]["provenance"]
        assert (
            origin["command"]
            == f"python baselines/tune.py {' '.join(NAMES)} --budget {budget} --seed 7 --out gains.json"
        )
        assert (origin["seed"], origin["budget"]) == (7, budget)
        assert 0 < origin["steps"] <= budget and origin["trials"] >= 1 and origin["seconds"] > 0
        assert origin["cost"] <= origin["cost_untuned"]
        assert {"pruned", "failed", "refused", "measured_on", "date", "version", "commit"} <= set(origin)
        asked, reached = origin["margins"], origin["margins"]["reached"]
        assert reached["modulus"] >= asked["modulus"] == 0.4 and reached["delay_samples"] >= asked["delay"] == 1.0
        assert reached["modulus_at"].rsplit(", ", 1)[0] in asked["arms"]
        assert f"{origin['trials']} trials" in result.stdout
    assert sorted(file.name for file in tmp_path.iterdir()) == ["gains.json", "results"]


@pytest.fixture
def command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """Arguments of the command, which runs in a folder of its own and within this process."""
    monkeypatch.chdir(tmp_path)
    arguments = ["tune.py"]
    monkeypatch.setattr(sys, "argv", arguments)
    before = signal.getsignal(signal.SIGTERM)
    yield arguments
    signal.signal(signal.SIGTERM, before)


def test_all_gains_name_the_commit_that_they_were_searched_at(
    tmp_path: Path, command: list[str], monkeypatch: pytest.MonkeyPatch
):
    """Not one that the first gains, written while the others are searched, have changed."""
    out = tmp_path / "gains.json"
    monkeypatch.setattr(run, "commit", lambda: "changed" if out.exists() else "as searched")
    found = [SearchResult(asdict(TUNABLE[name].gains()), 2.0, 3.0, 8, 100, 1, 0, 0, 0, 1.0) for name in NAMES]
    monkeypatch.setattr(run, "run_side_by_side", lambda *_, **__: (pair for pair in zip(NAMES, found, strict=True)))
    command.extend([*NAMES, "--no-margins", "--out", "gains.json"])
    main()
    assert [read_file(out)[name]["provenance"]["commit"] for name in NAMES] == ["as searched"] * len(NAMES)


def test_margins_need_not_be_asked_for(tmp_path: Path, command: list[str], capsys: pytest.CaptureFixture[str]):
    command.extend([NAMES[0], "--no-margins", "--budget", str(MIN_BUDGET), "--out", "gains.json"])
    main()
    output, errors = capsys.readouterr()
    assert errors == "" and NAMES[0] in output.splitlines()[0] and str(MIN_BUDGET) in output.splitlines()[0]
    origin = read_file(tmp_path / "gains.json")[NAMES[0]]["provenance"]
    assert (origin["margins"], origin["refused"]) == ("not asked for", 0)
    command.remove("--no-margins")
    Path(f"results/tune/{NAMES[0]}.json").unlink()  # else the search goes on without margins
    with pytest.raises(SystemExit):
        command.append("--resume")
        main()
    assert "started with another seed, other margins or other ranges of gains: tune anew" in capsys.readouterr().err


@pytest.mark.parametrize("interrupt", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_interrupted_command_leaves_the_file_and_goes_on(
    interrupt: signal.Signals, tmp_path: Path, command: list[str], capsys: pytest.CaptureFixture[str]
):
    name, out, journal = NAMES[0], tmp_path / "gains.json", tmp_path / "results" / "tune" / f"{NAMES[0]}.journal"
    out.write_text("{}")
    script = [sys.executable, str(ROOT / "baselines/tune.py"), name, "--out", "gains.json"]
    process = subprocess.Popen(script, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 300
    while not (journal.exists() and '"costs"' in journal.read_text()) and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(interrupt)
    output, errors = process.communicate(timeout=300)
    assert process.returncode == 130, errors
    assert errors.replace(f"{ANNOUNCEMENT}\n", "") == ""
    assert f"python baselines/tune.py {name} --out gains.json --resume" in output
    assert out.read_text() == "{}"
    size = journal.stat().st_size
    budget = str(5 * MIN_BUDGET)
    command.extend([name, "--out", "gains.json", "--resume", "--budget", budget])
    main()
    assert capsys.readouterr().err == ""
    assert journal.stat().st_size > size
    assert read_file(out)[name]["provenance"]["steps"] <= int(budget)


def test_a_resumed_search_keeps_the_options_that_it_is_not_told(
    tmp_path: Path, command: list[str], capsys: pytest.CaptureFixture[str]
):
    """Its budget, the margins that it does without, and the file of its gains."""
    budget = MIN_BUDGET + BATCH
    command.extend([NAMES[0], "--no-margins", "--budget", str(budget), "--seed", "3", "--out", "gains.json"])
    main()
    found = read_file(tmp_path / "gains.json")[NAMES[0]]
    (tmp_path / "gains.json").unlink()
    command[1:] = [NAMES[0], "--resume"]
    main()
    again = read_file(tmp_path / "gains.json")[NAMES[0]]
    assert again["gains"] == found["gains"]
    of = ("budget", "seed", "steps", "margins")
    assert [again["provenance"][name] for name in of] == [found["provenance"][name] for name in of]
    command[1:] = [NAMES[0], "--resume", "--seed", "4"]
    with pytest.raises(SystemExit):
        main()
    assert "started with another seed" in capsys.readouterr().err
    command[1:] = [NAMES[1], "--no-margins", "--budget", str(MIN_BUDGET), "--out", "gains.json"]
    main()
    capsys.readouterr()
    command[1:] = [*NAMES, "--resume"]
    with pytest.raises(SystemExit) as stopped:
        main()
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert stopped.value.code == 2 and NAMES[0] in line and NAMES[1] in line


def test_a_search_that_is_resumed_draws_no_gains_twice(tmp_path: Path):
    """Wherever it is interrupted, at the first of its draws too."""
    journal, kind = tmp_path / "journal", Tunable(Counting, OneGain)
    for batches in (1, 3, 6):

        def interrupt(state: SearchProgress, batches: int = batches) -> None:
            if state.steps >= batches * BATCH:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            search(kind, 4 * MIN_BUDGET, 0, journal, Channel(interrupt))
    search(kind, 4 * MIN_BUDGET, 0, journal)
    trials = open_study(OneGain, 0, journal).get_trials()
    gains = [trial.params["vibration"] for trial in trials if trial.params["vibration"] != OneGain().vibration]
    assert len(set(gains)) == len(gains) > 3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "name controllers to tune or give --all, not both; there are"),
        ((NAMES[0], "--all"), "name controllers to tune or give --all, not both"),
        ((NAMES[0] + "x",), f"no controller '{NAMES[0]}x' to tune; did you mean '{NAMES[0]}'?"),
        (("qqqqqq",), "no controller 'qqqqqq' to tune; there are"),
        (
            (NAMES[0], "--budget", "1000"),
            f"--budget must be at least {MIN_BUDGET} steps, enough for one trial, got 1000",
        ),
        ((NAMES[0], "--seed", "-1"), "--seed must be at least 0, got -1"),
        ((NAMES[0], "--jobs", "0"), "--jobs must lie within 1 and 256, got 0"),
        ((NAMES[0], "--resume"), "nothing to resume in results/tune: run once without --resume"),
        ((NAMES[0], "--out", "/dev/null/gains.json"), "cannot write to /dev/null"),
        ((NAMES[0], "--journals", "/dev/null/x"), "cannot write to /dev/null/x"),
        ((NAMES[0], "--out", "damaged.json"), "damaged.json is damaged (Expecting"),
    ],
)
def test_bad_options(arguments: tuple[str, ...], message: str, command: list[str], capsys: pytest.CaptureFixture[str]):
    Path("damaged.json").write_text("{")
    command.extend(arguments)
    with pytest.raises(SystemExit) as stopped:
        main()
    assert stopped.value.code == 2
    errors = capsys.readouterr().err
    assert message in errors
    assert len(errors.strip().splitlines()) == 1
    assert [file.name for file in Path().iterdir() if file.suffix == ".json"] == ["damaged.json"]


def test_all_is_every_controller_and_names_count_once():
    assert Config(all=True).chosen() == list(TUNABLE)
    assert Config(names=(NAMES[0], NAMES[0])).chosen() == [NAMES[0]]


def test_torques_that_reverse_often_are_charged_in_proportion():
    costs = charged(np.array([100.0, 100.0, 100.0]), np.array([0.0, 10.0, 25.0]))
    np.testing.assert_allclose(costs, [100.0, 100.0, 250.0])
