"""Parts that a comparison keeps and does not run again, which methods it runs, and what it does about mistakes."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from commands import mistake, stopped
from safetensors.numpy import save_file

from agents.policy.actor import Actor
from agents.policy.bundle import POLICIES, BundleSpec, save_bundle
from agents.residual.controller import ResidualSettings
from baselines import CONTROLLERS, DOMINATED
from baselines.servo.paper import PaperController
from beltarm_env import BeltArmVectorEnv
from beltarm_env.observation import index
from beltarm_env.task.moves import MOVE_FIELDS
from eval import compare
from eval.comparison import cache, custom, failures
from eval.comparison.cache import Metrics, Part, measure, parts_of, read_kept
from eval.comparison.failures import Failure
from eval.comparison.methods import classical_methods, learned_methods, privileged_method, shipped_policies
from eval.comparison.results import Comparison
from eval.comparison.run import choose_methods
from eval.comparison.schema import read_results
from eval.comparison.sets import development_set, fresh_set
from eval.comparison.splits import EDITION, VERSION
from eval.report import publish

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """No pictures and no report, where a test looks at neither: drawing takes longer than a few episodes."""
    monkeypatch.setattr(publish, "plots", lambda *_: {})
    monkeypatch.setattr(publish, "write_report", lambda *_: None)


# What is kept


def part(method: str = "paper", episodes: int = 4, split: str = "nominal") -> Part:
    (known,) = [known for known in classical_methods() if known.name == method]
    return Part(known, development_set().splits[split], episodes)


def run_and_keep(wanted: Part, folder: Path) -> Metrics | Failure:
    return cache.run_parts([wanted], folder, 1)[0]


# Parts that run together


def parts_on(method: str, *splits: str, episodes: int = 4) -> list[Part]:
    return [part(method, episodes, split) for split in splits]


def assert_same(found: list[Metrics | Failure], expected: list[Metrics]) -> None:
    for one, other in zip(found, expected, strict=True):
        assert isinstance(one, dict) and set(one) == set(other)
        for name, table in other.items():
            assert one[name].tobytes() == table.tobytes() and one[name].flags.c_contiguous, name


@pytest.mark.parametrize("method", ["paper", "privileged"])
def test_splits_together_are_each_by_itself_bit_for_bit(method: str):
    known = {one.name: one for one in [*classical_methods(), privileged_method()]}[method]
    several = [replace(one, method=known) for one in parts_on("paper", "nominal", "drive", "payload")]
    several[1] = replace(several[1], count=3)
    assert_same([*cache.measure_together(several)], [measure(one) for one in several])


def test_splits_and_training_seeds_together_are_each_by_itself():
    (method,) = learned_methods(shipped_policies()[:2])
    several = [replace(one, method=method) for one in parts_on("paper", "randomized", "friction", episodes=2)]
    assert len(method.sources) == 2 and method.batches(4) == [range(2)]
    assert_same([*cache.measure_together(several)], [measure(one) for one in several])


def test_what_runs_together_is_of_one_method_with_the_same_settings_and_few():
    splits = ("nominal", "sensing", "drive", "structural")
    mixed = [*parts_on("paper", *splits), *parts_on("zvd", *splits)]
    tasks = cache._tasks(mixed, list(range(len(mixed))))
    assert sorted(map(tuple, tasks)) == [(0, 2), (1,), (3,), (4, 6), (5,), (7,)]
    assert cache._tasks(mixed, [2, 6]) == [[2], [6]]
    large = parts_on("paper", "nominal", "drive", "payload", episodes=250)
    assert cache._tasks(large, [0, 1, 2]) == [[0, 1], [2]]
    added = [replace(one, method=replace(one.method, kind="added")) for one in parts_on("paper", "nominal", "drive")]
    assert cache._tasks(added, [0, 1]) == [[0], [1]]


def test_parts_of_many_scenarios_are_the_batch_bit_for_bit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    whole = part(episodes=11)
    together = measure(whole)
    monkeypatch.setattr(cache, "EPISODES", 4)
    cut = parts_of(whole.method, whole.split, 11)
    assert [(one.first, one.count) for one in cut] == [(0, 4), (4, 4), (8, 3)]
    results = cache.run_parts(cut, tmp_path, 1)
    for name, table in together.items():
        assert np.array_equal(
            np.concatenate([result[name] for result in results if isinstance(result, dict)], 1), table
        )
    assert cache.kept_count(cut, tmp_path) == 3


class Picky(PaperController):
    """Fails on arms that start where the first of a split does."""

    start = 0.0

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        if np.any(observation[:, index("start")] == self.start):
            raise ValueError("not this arm")
        return super().predict(observation, state, episode_start, deterministic)


def test_what_fails_on_a_split_does_so_there_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    several = parts_on("paper", "nominal", "drive", "payload")
    expected = [measure(one) for one in several]
    env = BeltArmVectorEnv(1)
    first = env.reset(options={"move": dict(zip(MOVE_FIELDS, several[1].split.moves[0], strict=True))})[0]
    monkeypatch.setattr(Picky, "start", first[0, index("start")])
    monkeypatch.setitem(CONTROLLERS, "paper", Picky)
    done: list[tuple[int, int]] = []
    nominal, drive, payload = cache.run_parts(several, tmp_path, 1, lambda *news: done.append(news))
    assert isinstance(drive, Failure) and drive.split == "drive" and "ValueError: not this arm" in drive.message
    assert_same([nominal, payload], [expected[0], expected[2]])
    assert done == [(0, 3), (1, 3), (2, 3), (3, 3)]
    assert [read_kept(one, tmp_path) is not None for one in several] == [True, False, True]


def test_keys_depend_on_everything_that_the_numbers_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    one = part("zvd")
    others = [
        part("zv"),
        part("zvd", 5),
        part("zvd", split="payload"),
        replace(one, split=replace(one.split, digest="other")),
        replace(one, split=replace(one.split, of="test")),
        replace(one, method=replace(one.method, identity="other gains")),
    ]
    files = {found.file(tmp_path) for found in [one, *others]}
    assert len(files) == 1 + len(others)
    assert one.file(tmp_path) == part("zvd").file(tmp_path)
    others_of_code = {"sources_digest": lambda *_: "other code", "version": lambda _: "other version"}
    for name, value in {**others_of_code, "sha256_of": lambda _: "other kept gains"}.items():
        with monkeypatch.context() as patched:
            cache._code.cache_clear()
            patched.setattr(cache, name, value)
            files.add(one.file(tmp_path))
    cache._code.cache_clear()
    assert len(files) == 4 + len(others)


def test_parts_of_a_method_of_unknown_identity_are_not_kept(tmp_path: Path):
    unknown = replace(part(), method=replace(part().method, identity=None))
    assert isinstance(run_and_keep(unknown, tmp_path), dict)
    assert read_kept(unknown, tmp_path) is None
    assert list(tmp_path.iterdir()) == []


def test_gains_are_part_of_the_identity(monkeypatch: pytest.MonkeyPatch):
    identities = {method.name: method.identity for method in classical_methods()}
    changed = {"zvd": {"gains": {"angle": 1.0}, "provenance": {"steps": 1, "seconds": 1.0}}}
    monkeypatch.setattr("eval.comparison.methods.read_file", lambda: changed)
    assert {method.name: method.identity for method in classical_methods()}["zvd"] != identities["zvd"]


@pytest.mark.parametrize("damage", [b"", b"half", None])
def test_damaged_parts_are_run_again(damage: bytes | None, tmp_path: Path):
    measured = run_and_keep(part(), tmp_path)
    path = part().file(tmp_path)
    path.write_bytes(path.read_bytes()[:-200] if damage is None else damage)
    assert read_kept(part(), tmp_path) is None
    again = run_and_keep(part(), tmp_path)
    assert isinstance(measured, dict) and isinstance(again, dict)
    assert np.array_equal(again["cost"], measured["cost"])


def test_parts_with_any_changed_bit_are_run_again(tmp_path: Path):
    """In the archive's directory, where its reader raises what it likes, as in the numbers."""
    measured = run_and_keep(part(), tmp_path)
    path = part().file(tmp_path)
    sound = path.read_bytes()
    directory = sound.index(b"PK\1\2")
    for place in (*range(directory, len(sound), 7), *range(0, directory, 997)):
        data = bytearray(sound)
        data[place] ^= 1 << place % 8
        path.write_bytes(data)
        assert read_kept(part(), tmp_path) is None and not path.exists()
    again = run_and_keep(part(), tmp_path)
    assert isinstance(measured, dict) and isinstance(again, dict)
    assert np.array_equal(again["cost"], measured["cost"])


def test_numbers_that_were_changed_by_hand_are_not_used(tmp_path: Path):
    measured = run_and_keep(part(), tmp_path)
    assert isinstance(measured, dict)
    np.savez(part().file(tmp_path), allow_pickle=False, **{**measured, "cost": 0.5 * measured["cost"]})
    assert read_kept(part(), tmp_path) is None


def test_outdated_parts_are_taken_away(tmp_path: Path):
    old = replace(part(), method=replace(part().method, identity="before"))
    run_and_keep(old, tmp_path)
    run_and_keep(part(episodes=5), tmp_path)
    fresh = replace(part(), split=fresh_set(0).splits["nominal"])
    run_and_keep(fresh, tmp_path)
    run_and_keep(part(), tmp_path)
    names = sorted(path.name for path in (tmp_path / "parts").iterdir())
    assert names == sorted(found.file(tmp_path).name for found in (part(), part(episodes=5), fresh))


def test_an_interrupted_run_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    several, ran = [part(split=name) for name in ("nominal", "sensing", "structural")], list[str]()

    def counted(of: Part) -> Metrics:
        if len(ran) == 2:
            raise KeyboardInterrupt
        ran.append(of.split.name)
        return measure(of)

    monkeypatch.setattr(cache, "measure", counted)
    with pytest.raises(KeyboardInterrupt, match="2 of 3 parts"):
        cache.run_parts(several, tmp_path, 1)
    first = ran.copy()
    ran.clear()
    done: list[tuple[int, int]] = []
    cache.run_parts(several, tmp_path, 1, lambda *news: done.append(news))
    assert len(first) == 2 and [*first, *ran] != [*ran, *first] and len(ran) == 1 and done == [(2, 3), (3, 3)]


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_an_interrupted_run_says_what_is_kept_and_goes_on(tmp_path: Path):
    methods, splits = ("paper", "rigid", "zvd", "ei"), ("nominal", "payload", "friction", "structural")
    arguments = ("--methods", *methods, "--splits", *splits, "--episodes", "30", "--out", "out")
    command = [sys.executable, str(ROOT / "eval/compare.py"), *arguments, "--jobs", "2"]
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 300
    while not list(tmp_path.glob("out/parts/[!.]*")) and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=300)
    assert process.returncode == 130, errors
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.glob("out/parts/[!.]*")}
    assert 1 <= len(kept) < 16
    assert [line for line in errors.splitlines() if "compiling" not in line] == errors.splitlines()[-1:]
    assert f"interrupted: {len(kept)} of 16 parts are kept in out; the same" in errors
    code, errors = stopped(compare.main, (*arguments, "--jobs", "1"), tmp_path)
    assert code == 0, errors
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    assert len(list(tmp_path.glob("out/parts/[!.]*"))) == 16


TWO = ("--splits", "nominal", "ideal")
MINE = """
import numpy as np
from pathlib import Path
from safetensors.numpy import load_file
class Mine:
    def __init__(self):
        self.weight = load_file(Path(__file__).with_name("weights.safetensors"))["weight"]
    def predict(self, observation, *_, **__):
        return np.full((len(observation), 1), self.weight, np.float32), None
"""


@pytest.mark.slow
def test_new_weights_and_fresh_runs_are_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    """Weights that are opened outside Python count as well, and results beside the controller do not."""
    (tmp_path / "mine.py").write_text(MINE)
    chosen = ("--add", "mine.py:Mine", "--methods", "paper", "Mine", "--splits", "nominal", "--episodes", "4")
    found: list[Comparison] = []
    monkeypatch.setattr(compare, "publish", lambda comparison, *_: found.append(comparison) or ({}, []))
    monkeypatch.setattr(compare, "page", lambda *_: "")
    monkeypatch.setattr(compare, "print_results", lambda *_, **__: None)

    def compared(weight: float, *options: str) -> tuple[float, int, str]:
        """Cost of the controller, how many parts were not run, and what was printed."""
        save_file({"weight": np.array(weight)}, tmp_path / "weights.safetensors")
        code, errors = stopped(compare.main, (*chosen, "--jobs", "1", "--out", "out", *options), tmp_path)
        assert code == 0, errors
        cost = found[-1].outcomes[1].metrics["cost"].mean()
        return cost, found[-1].provenance["pairs_kept_before"], capsys.readouterr().out

    first, kept, output = compared(0.0)
    assert kept == 0 and "will not be used again" not in output
    assert compared(0.0)[:2] == (first, 2)
    assert compared(0.0, "--fresh")[:2] == (first, 0)
    other, kept, _ = compared(0.01)
    assert other != first and kept == 1
    monkeypatch.setattr(custom, "MOST_FILES", 1)
    for _ in range(2):
        cost, kept, output = compared(0.0)
        assert (cost, kept) == (first, 1)
        assert f"Results of Mine will not be used again: {tmp_path} is too large" in output


# What goes wrong


FAILING = """
import numpy as np

class Fails:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        if len(observation) == 7:
            raise RuntimeError('no such\\nnumber of arms')
        return np.zeros((len(observation), 1), np.float32), None

class Nan:
    def predict(self, observation, *rest, **options):
        bad = np.nan if len(observation) == 7 else 0
        return np.full((len(observation), 1), bad, np.float32), None

class Alone:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        state = (0 if state is None else state) + 1
        if len(observation) == 1 and state > 700:
            raise IndexError('one arm\\nis too few')
        return np.zeros((len(observation), 1), np.float32), state
"""


@pytest.mark.slow
def test_controllers_that_fail_on_the_way_do_not_stop_the_others(tmp_path: Path):
    """On the scenarios, by an exception or a torque that is none, or where an arm is recorded alone."""
    (tmp_path / "mine.py").write_text(FAILING)
    added = [word for name in ("Fails", "Nan", "Alone") for word in ("--add", f"mine.py:{name}")]
    chosen = ("--methods", "paper", "Fails", "Nan", "Alone", "--splits", "nominal", "--episodes", "7", "--jobs", "1")
    code, errors = stopped(compare.main, (*added, *chosen, "--out", "out"), tmp_path)
    assert code == 1
    assert "eval/compare.py: Fails failed on nominal: RuntimeError: no such number of arms (mine.py:7)\n" in errors
    assert "eval/compare.py: Nan failed on nominal: ValueError" in errors
    assert re.search(
        r"Alone failed on nominal: on scenario \d: IndexError: one arm is too few \(mine\.py:19\)\n", errors
    )
    assert len(errors.strip().splitlines()) == 3
    results = read_results(tmp_path / "out" / "results.json")
    assert [row["method"] for row in results["rows"]] == ["paper", "Alone"]
    assert [failure["method"] for failure in results["failures"]] == ["Fails", "Nan", "Alone"]
    assert "- Fails on nominal: RuntimeError" in (tmp_path / "out" / "page.md").read_text()
    assert "<b>Alone</b> on nominal: on scenario" in (tmp_path / "out" / "report.html").read_text()
    assert not list(tmp_path.glob("out/parts/*Fails*"))  # tried again next time
    assert {*results["failures"][0]} == {"method", "split", "message"}


ENDING = """
import os, sys
import numpy as np
if __name__ == "controller_in_import_ends":
    os._exit(0)

class Sound:
    def end(self):
        pass
    def predict(self, observation, *rest, **options):
        if len(observation) == 7:
            self.end()
        return np.zeros((len(observation), 1), np.float32), None

class Exits(Sound):
    def end(self):
        sys.exit(0)

class AtOnce(Sound):
    def predict(self, *rest, **options):
        os._exit(0)
"""


@pytest.mark.parametrize("many", [pytest.param(False, marks=pytest.mark.slow), True])
def test_controllers_that_end_their_process_do_not_end_the_comparison(many: bool, tmp_path: Path):
    """Also where many scenarios are run in parts, and where importing the controller is enough."""
    names = ("Exits", "AtOnce") if many else ("Sound", "Exits", "AtOnce")
    (tmp_path / "mine.py").write_text(ENDING.replace("== 7", "in (7, 100)"))  # 600 scenarios are parts of 500 and 100
    (tmp_path / "import_ends.py").write_text(ENDING.replace("Sound", "Imported"))
    added = [word for name in names for word in ("--add", f"mine.py:{name}")]
    added += [] if many else ["--add", "import_ends.py:Imported"]
    episodes = ("--episodes", "600", "--scenario-seed", "1") if many else ("--episodes", "7")
    chosen = ("--methods", "paper", *names, *([] if many else ["Imported"]), "--splits", "nominal", "--out", "out")
    code, errors = stopped(compare.main, (*added, *chosen, *episodes, "--jobs", "1"), tmp_path)
    assert code == 1, errors
    causes = {
        "Exits": r"SystemExit: 0 \(mine.py:17\)",
        "AtOnce": "its process ended with exit status 0 before it was done",
        "Imported": "its process ended with exit status 0 before it was done",
    }
    failed = [line for line in errors.splitlines() if "failed on" in line]
    assert len(failed) == (2 if many else 3)
    for line in failed:
        (name,) = re.findall(r"^eval/compare.py: (\w+) failed on nominal: ", line)
        assert re.search(f"nominal: {causes[name]}", line), line
    if not many:
        results = read_results(tmp_path / "out" / "results.json")
        assert [row["method"] for row in results["rows"]] == ["paper", "Sound"]
        assert {row["method"] for row in results["failures"]} == {*causes}


def hang() -> None:
    time.sleep(600)


@pytest.mark.slow
def test_an_added_controller_has_a_limit_of_time(tmp_path: Path):
    (tmp_path / "mine.py").write_text(ENDING)
    (usual,) = choose_methods(("Sound",), added=(f"{tmp_path}/mine.py:Sound",))
    (mine,) = choose_methods(("Sound",), added=(f"{tmp_path}/mine.py:Sound",), time_limit=1.5)
    assert usual.time_limit == custom.TIME_LIMIT and mine.identity == usual.identity
    expected = Failure("Sound", "nominal", "it took longer than 1.5 s, and was ended")
    assert failures.run_controller(mine, "nominal", hang) == expected


@pytest.mark.usefixtures("undrawn")
def test_a_failure_can_be_shown_with_its_whole_traceback(tmp_path: Path):
    """Also where it is the only method's, and nothing is left to compare."""
    (tmp_path / "mine.py").write_text(FAILING)
    options = ("--add", "mine.py:Fails", "--splits", "nominal", "--episodes", "7", "--jobs", "1", "--traceback")
    for methods, status in ((("paper", "Fails"), 1), (("Fails",), 2)):
        code, errors = stopped(compare.main, ("--methods", *methods, *options, "--out", methods[0]), tmp_path)
        assert code == status
        assert "Traceback (most recent call last):" in errors
        assert f'File "{tmp_path}/mine.py", line 7, in predict\n    raise RuntimeError' in errors
    assert errors.splitlines()[-1].startswith("eval/compare.py: no method could be run: Fails on nominal")


def end_process() -> None:
    os._exit(3)


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_is_made_side_by_side_fails_as_a_whole(jobs: int):
    made = publish.side_by_side({"b": partial(int, "2"), "a": partial(int, "1")}, jobs)
    assert list(made.items()) == [("b", 2), ("a", 1)]
    with pytest.raises(ValueError, match="invalid literal"):
        publish.side_by_side({"a": partial(int, "1"), "b": partial(int, "one")}, jobs)


@pytest.mark.slow
def test_a_process_that_ends_while_it_draws_is_explained():
    with pytest.raises(OSError, match=r"broke off.*what is done is kept: try again with --jobs 1"):
        publish.side_by_side({"a": partial(int, "1"), "b": end_process}, 2)


# Which methods


def test_dominated_methods_run_where_they_are_named():
    for name, better in DOMINATED.items():
        assert name in CONTROLLERS and better in {*CONTROLLERS} - {*DOMINATED}
        assert [method.name for method in choose_methods((name, "paper"))] == ["paper", name]
    default = [method.name for method in choose_methods(())]
    assert default[:2] == ["paper", "rigid"] and not {*DOMINATED} & {*default}


def test_what_was_asked_for_runs_whatever_else_is_named(tmp_path: Path):
    """`--methods` chooses among the project's own; what `--add` and `--policy` give runs with them."""
    (tmp_path / "mine.py").write_text(ENDING)
    added, policies = (f"{tmp_path}/mine.py:Sound",), (bundle(tmp_path / "a"),)
    assert [one.name for one in choose_methods(("adaptive",), policies, added)] == ["adaptive", "my-ppo", "Sound"]
    assert [one.name for one in choose_methods(("adaptive", "Sound"), added=added)] == ["adaptive", "Sound"]
    assert [one.name for one in choose_methods(("privileged",), added=added)] == ["Sound", "privileged"]
    assert [one.name for one in choose_methods(("lqg",), policies, guard=True)] == [
        *("lqg", "lqg+guard", "my-ppo", "my-ppo+guard")
    ]


def bundle(folder: Path, base: str = "paper", sensors: str = "encoder") -> Path:
    spec = BundleSpec("ppo", base, ResidualSettings(), (4,), sensors=sensors, provenance={"run": {"steps": 5}})
    save_bundle(folder, spec, Actor(spec.shape()).weights())
    return folder


def test_policies_are_grouped_by_method(tmp_path: Path):
    folders: list[Path | str] = [bundle(tmp_path / "a"), bundle(tmp_path / "b", base="preview"), bundle(tmp_path / "c")]
    folders += [f"tried={folder}" for folder in folders[::2]]
    found = learned_methods(folders)
    assert [(method.name, method.base, len(method.sources)) for method in found] == [
        ("my-ppo", "paper", 2),
        ("my-ppo-preview", "preview", 1),
        ("tried", "paper", 2),
    ]
    assert found[0].training == {"simulator_steps": [20, 20], "wall_clock_s": [0.0, 0.0]}


@pytest.mark.usefixtures("undrawn")
def test_a_narrower_run_does_not_replace_what_is_there(tmp_path: Path):
    fixed = ("--jobs", "1", "--out", "out")
    assert stopped(compare.main, ("--methods", "paper", "zvd", *TWO, "--episodes", "6", *fixed), tmp_path)[0] == 0
    before = {path: path.read_bytes() for path in (tmp_path / "out").glob("*.*")}
    for narrower, lost in (
        (("--methods", "paper", *TWO, "--episodes", "6"), "zvd"),
        (("--methods", "paper", "zvd", "--splits", "ideal", "--episodes", "6"), "nominal"),
        (("--methods", "paper", "zvd", *TWO, "--episodes", "4"), "6 scenarios per split"),
    ):
        line = mistake(compare.main, (*narrower, *fixed), tmp_path)
        assert f"({lost})" in line and "--out" in line
    assert {path: path.read_bytes() for path in (tmp_path / "out").glob("*.*")} == before
    wider = ("--methods", "paper", "zvd", "rigid", *TWO, "--episodes", "6")
    assert stopped(compare.main, (*wider, *fixed), tmp_path)[0] == 0


@pytest.mark.usefixtures("undrawn")
def test_a_fresh_set_is_run_and_called_so(tmp_path: Path):
    arguments = ("--methods", "paper", "zvd", "--splits", "nominal", "--episodes", "4", "--jobs", "1", "--out", "out")
    code, errors = stopped(compare.main, (*arguments, "--scenario-seed", "3"), tmp_path)
    assert code == 0, errors
    results = read_results(tmp_path / "out" / "results.json")
    label = fresh_set(3).label
    assert results["scenario_set"] == label._asdict() and label.name == "seed 3"
    assert results["provenance"]["split_seeds"] == {"nominal": fresh_set(3).splits["nominal"].seed}
    assert f"results of the scenarios 'seed 3' ({label.sha256[:12]}), this run is of" in mistake(
        compare.main, arguments, tmp_path
    )
    assert all(path.name.startswith("seed-3.nominal.") for path in (tmp_path / "out" / "parts").iterdir())


def test_recipes_do_not_lead_onto_the_test_set():
    """Commands of the documentation that compare a method of one's own: only a submission names the test set."""
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    pages += [*(ROOT / "docs").glob("tutorials/*.py"), *(ROOT / "docs").glob("examples/*.py")]
    texts = [page.read_text(encoding="utf-8").replace("\\\n", "") for page in pages]
    command = r"^[# ]*`?((?:make compare|\S*python eval/compare\.py)\b.*--(?:add|policy) .*)"
    recipes = [line for text in texts for line in re.findall(command, text, re.M)]
    assert len(recipes) >= 9
    assert all("--scenarios development" in line or "--scenarios test" in line for line in recipes)
    assert len([line for line in recipes if "--scenarios test" in line]) == 1


# Mistakes


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("--policy", "nowhere"), "nowhere"),
        (("--policy", "runs/model.zip"), "runs/model.zip"),
        (("--episodes", "2"), "--episodes"),
        (("--episodes", "0"), "--episodes"),
        (("--episodes", "501"), "--scenario-seed"),
        (("--episodes", "100001", "--scenario-seed", "1"), "--episodes"),
        (("--jobs", "0"), "--jobs"),
        (("--out", "/dev/null/x"), "/dev/null/x"),
        (("--methods", "papr"), "did you mean paper?"),
        (("--methods", "foo"), "unknown method 'foo'"),
        (("--splits", "frictoin"), "did you mean friction?"),
        (("--methods", "privileged"), "--methods"),
        (("--add", "nowhere.py:Mine"), "nowhere.py"),
        (("--add", "paper.py:paper"), "'paper'"),
        (("--policy", "student=mine"), "'student'"),
        (("--time-limit", "0"), "--time-limit"),
        (("--time-limit", "nan"), "--time-limit"),
        (("--scenario-seed", "-1"), "--scenario-seed"),
        (("--scenario-seed", "1", "--scenarios", "development"), "--scenarios development"),
        (("--out", "old", "--methods", "paper"), f"version {VERSION + 1}"),
        (("--out", "first", "--methods", "paper"), "edition 1"),
        (("--out", "fresh", "--methods", "paper"), "'seed 1'"),
        (("--out", "unlike", "--methods", "paper"), "'development'"),
        (("--out", "damaged", "--methods", "paper"), "damaged/results.json"),
    ],
)
def test_mistakes_are_one_line(arguments: tuple[str, ...], named: str, tmp_path: Path):
    shutil.copytree(POLICIES / "student" / "seed0", tmp_path / "mine")
    (tmp_path / "paper.py").write_text("class paper:\n    def predict(self, *_, **__):\n        return 1, None\n")
    now = {"edition": EDITION, "version": VERSION}
    contents = {
        "old": {"edition": EDITION, "version": VERSION + 1},
        "first": {"version": 1},
        "fresh": {**now, "scenario_set": {"name": "seed 1", "sha256": "0000"}},
        "unlike": {**now, "scenario_set": {"name": "development", "sha256": "0000"}},
    }
    for name, text in {**{name: json.dumps(content) for name, content in contents.items()}, "damaged": "{"}.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "results.json").write_text(text)
    assert named in mistake(compare.main, arguments, tmp_path)


def test_a_full_disk_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    def full(path: Path, write: object) -> None:
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(cache, "write_arrays", full)
    arguments = ("--methods", "paper", "--splits", "nominal", "--episodes", "4", "--jobs", "1", "--out", str(tmp_path))
    monkeypatch.setattr(sys, "argv", ["compare.py", *arguments])
    with pytest.raises(SystemExit) as stopped:
        compare.main()
    assert stopped.value.code == 2
    errors = capsys.readouterr().err.strip().splitlines()
    assert len(errors) == 1
    assert "No space left on device" in errors[0]
