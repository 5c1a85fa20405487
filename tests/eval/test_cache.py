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
from collections.abc import Sequence
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
from eval.comparison.cache import Metrics, Part, measure, parts_of, read_kept, run_parts
from eval.comparison.failures import Failure
from eval.comparison.methods import classical_methods, learned_methods, privileged_method, shipped_policies
from eval.comparison.results import Comparison
from eval.comparison.rollouts import calls_side_by_side
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
    monkeypatch.setattr(publish, "render", lambda *_: "")


def part(method: str = "paper", episodes: int = 4, split: str = "nominal") -> Part:
    known = {known.name: known for known in [*classical_methods(), privileged_method()]}
    known["learned"] = learned_methods(shipped_policies()[:2])[0]
    return Part(known[method], development_set().splits[split], episodes)


def assert_same(results: Sequence[Metrics | Failure], expected: Sequence[Metrics | Failure]) -> None:
    for result, other in zip(results, expected, strict=True):
        assert isinstance(result, dict) and isinstance(other, dict) and set(result) == set(other)
        for name, table in other.items():
            assert result[name].tobytes() == table.tobytes(), name


# Parts that run together


@pytest.mark.parametrize("method", ["paper", "privileged", "learned"])
def test_splits_and_training_seeds_together_are_each_by_itself_bit_for_bit(method: str):
    several = [part(method, k, split) for k, split in ((4, "randomized"), (3, "drive"), (4, "payload"))]
    assert_same(cache.measure_together(several), [measure(single) for single in several])


def test_parts_of_many_scenarios_are_the_batch_bit_for_bit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    whole = part(episodes=11)
    together = measure(whole)
    monkeypatch.setattr(cache, "EPISODES", 4)
    cut = parts_of(whole.method, whole.split, 11)
    assert [(each.first, each.count) for each in cut] == [(0, 4), (4, 4), (8, 3)]
    results = [result for result in run_parts(cut, tmp_path, 1) if isinstance(result, dict)]
    for name, table in together.items():
        assert np.array_equal(np.concatenate([result[name] for result in results], 1), table)
    assert cache.kept_count(cut, tmp_path) == 3


class Picky(PaperController):
    """Fails on arms that start where the first of a split does."""

    start = 0.0

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        if np.any(observation[:, index("start")] == self.start):
            raise ValueError("not this arm")
        return super().predict(observation, state, episode_start, deterministic)


def test_a_controller_that_fails_on_a_split_does_so_there_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    several = [part(split=split) for split in ("nominal", "drive", "payload")]
    expected = [measure(single) for single in several]
    env = BeltArmVectorEnv(1)
    first = env.reset(options={"move": dict(zip(MOVE_FIELDS, several[1].split.moves[0], strict=True))})[0]
    monkeypatch.setattr(Picky, "start", first[0, index("start")])
    monkeypatch.setitem(CONTROLLERS, "paper", Picky)
    done: list[tuple[int, int]] = []
    nominal, drive, payload = run_parts(several, tmp_path, 1, lambda *news: done.append(news))
    assert isinstance(drive, Failure) and drive.split == "drive" and "ValueError: not this arm" in drive.message
    assert_same([nominal, payload], [expected[0], expected[2]])
    assert done == [(0, 3), (1, 3), (2, 3), (3, 3)]
    assert [read_kept(single, tmp_path) is not None for single in several] == [True, False, True]


# What is kept


def test_keys_depend_on_everything_that_the_numbers_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    same = part("zvd")
    others = [
        part("zv"),
        part("zvd", 5),
        part("zvd", split="payload"),
        replace(same, split=replace(same.split, digest="other")),
        replace(same, split=replace(same.split, of="test")),
        replace(same, method=replace(same.method, identity="other gains")),
    ]
    files = {each.file(tmp_path) for each in [same, part("zvd"), *others]}
    assert len(files) == 1 + len(others)
    others_of_code = {"sources_digest": lambda *_: "other code", "version": lambda _: "other version"}
    for name, value in {**others_of_code, "sha256_of": lambda _: "other kept gains"}.items():
        with monkeypatch.context() as patched:
            cache._code.cache_clear()
            patched.setattr(cache, name, value)
            files.add(same.file(tmp_path))
    cache._code.cache_clear()
    assert len(files) == 4 + len(others)
    monkeypatch.setattr("eval.comparison.methods.read_file", lambda: {"zvd": {"gains": {"angle": 1.0}}})
    assert part("zvd").method.identity != same.method.identity


def test_parts_of_a_method_of_unknown_identity_are_not_kept(tmp_path: Path):
    unknown = replace(part(), method=replace(part().method, identity=None))
    assert isinstance(run_parts([unknown], tmp_path, 1)[0], dict)
    assert read_kept(unknown, tmp_path) is None and list(tmp_path.iterdir()) == []


def test_damaged_parts_are_run_again(tmp_path: Path):
    """With any bit changed, cut off anywhere, or with other numbers that somebody wrote."""
    measured = run_parts([part()], tmp_path, 1)
    path = part().file(tmp_path)
    sound = path.read_bytes()
    directory = sound.index(b"PK\1\2")  # where the reader of archives raises what it likes
    damaged = [b"", b"half", sound[:-200]]
    for place in (*range(directory, len(sound), 7), *range(0, directory, 997)):
        changed = bytearray(sound)
        changed[place] ^= 1 << place % 8
        damaged.append(bytes(changed))
    for data in damaged:
        path.write_bytes(data)
        assert read_kept(part(), tmp_path) is None and not path.exists()
    assert isinstance(measured[0], dict)
    np.savez(path, allow_pickle=False, **{**measured[0], "cost": 0.5 * measured[0]["cost"]})
    assert read_kept(part(), tmp_path) is None
    assert_same(run_parts([part()], tmp_path, 1), measured)


def test_outdated_parts_are_taken_away(tmp_path: Path):
    old = replace(part(), method=replace(part().method, identity="before"))
    fresh = replace(part(), split=fresh_set(0).splits["nominal"])
    for each in (old, part(episodes=5), fresh, part()):
        run_parts([each], tmp_path, 1)
    names = sorted(path.name for path in (tmp_path / "parts").iterdir())
    assert names == sorted(each.file(tmp_path).name for each in (part(), part(episodes=5), fresh))


def test_an_interrupted_run_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    several, ran = [part(split=name) for name in ("nominal", "sensing", "structural")], list[str]()

    def counted(each: Part) -> Metrics:
        if len(ran) == 2:
            raise KeyboardInterrupt
        ran.append(each.split.name)
        return measure(each)

    monkeypatch.setattr(cache, "measure", counted)
    with pytest.raises(KeyboardInterrupt, match="2 of 3 parts"):
        run_parts(several, tmp_path, 1)
    ran.pop()
    run_parts(several, tmp_path, 1)
    assert len(ran) == len(set(ran)) == 2 and cache.kept_count(several, tmp_path) == 3


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_a_run_that_is_stopped_keeps_its_parts_and_goes_on(number: signal.Signals, tmp_path: Path):
    methods, splits = ("paper", "rigid", "zvd", "ei"), ("nominal", "payload", "friction", "structural")
    arguments = ("--methods", *methods, "--splits", *splits, "--episodes", "30", "--out", "out")
    command = [sys.executable, str(ROOT / "eval/compare.py"), *arguments, "--jobs", "2"]
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 300
    while not list(tmp_path.glob("out/parts/[!.]*")) and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(number)
    _, errors = process.communicate(timeout=300)
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.glob("out/parts/[!.]*")}
    assert 1 <= len(kept) < 16
    if number == signal.SIGINT:
        assert process.returncode == 130, errors
        assert f"interrupted: {len(kept)} of 16 parts are kept in out; the same" in errors.splitlines()[-1]
    assert stopped(compare.main, (*arguments, "--jobs", "1"), tmp_path)[0] == 0
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    assert len(list(tmp_path.glob("out/parts/[!.]*"))) == 16


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
    made: list[Comparison] = []
    monkeypatch.setattr(compare, "publish", lambda comparison, *_: made.append(comparison) or ({}, []))
    monkeypatch.setattr(compare, "page", lambda *_: "")
    monkeypatch.setattr(compare, "print_results", lambda *_, **__: None)

    def compared(weight: float, *options: str) -> tuple[float, int, str]:
        """Cost of the controller, how many parts were not run, and what was printed."""
        save_file({"weight": np.array(weight)}, tmp_path / "weights.safetensors")
        code, errors = stopped(compare.main, (*chosen, "--jobs", "1", "--out", "out", *options), tmp_path)
        assert code == 0, errors
        cost = made[-1].outcomes[1].metrics["cost"].mean()
        return cost, made[-1].provenance["pairs_kept_before"], capsys.readouterr().out

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
import os, sys
import numpy as np
if __name__ == "controller_in_import_ends":
    os._exit(0)

class Sound:
    def fail(self):
        pass
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        state = 0 if state is None else state + 1
        if len(observation) in (7, 100):
            self.fail()
        return np.zeros((len(observation), 1), np.float32), state

class Raises(Sound):
    def fail(self):
        raise RuntimeError("no such\\nnumber of arms")

class Exits(Sound):
    def fail(self):
        sys.exit(0)

class AtOnce(Sound):
    def predict(self, *rest, **options):
        os._exit(0)

class Nan(Sound):
    def predict(self, observation, *rest, **options):
        action, state = super().predict(observation, *rest, **options)
        return action + np.float32(np.nan if len(observation) == 7 else 0), state

class Shown(Sound):
    def predict(self, observation, *rest, **options):
        action, state = super().predict(observation, *rest, **options)
        if len(observation) < 7 and state > 700:
            raise IndexError("only\\nto be drawn")
        return action, state
"""
ENDED = "its process ended with exit status 0 before it was done"
CAUSES = {
    "Raises": r"RuntimeError: no such number of arms \(mine.py:18\)",
    "Exits": r"SystemExit: 0 \(mine.py:22\)",
    "AtOnce": ENDED,
    "Imported": ENDED,
    "Nan": "ValueError",
    "Shown": r"on scenario \d: IndexError: only to be drawn \(mine\.py:\d+\)",
}
"""Controllers that pass the checks of the protocol or not, and the failures that are reported."""


@pytest.fixture
def failing(tmp_path: Path) -> Path:
    (tmp_path / "mine.py").write_text(FAILING)
    (tmp_path / "import_ends.py").write_text(FAILING.replace("Sound", "Imported"))
    return tmp_path


def compared_with(failing: Path, names: Sequence[str], *options: str) -> list[str]:
    """Failures that a comparison reports, which goes on with its other methods."""
    files = {"Imported": "import_ends.py"}
    added = [word for name in names for word in ("--add", f"{files.get(name, 'mine.py')}:{name}")]
    fixed = ("--methods", "paper", "--splits", "nominal", "--jobs", "1", "--out", "out")
    code, errors = stopped(compare.main, (*added, *fixed, *options), failing)
    assert code == 1, errors
    return errors.splitlines()


@pytest.mark.slow
def test_failures_of_controllers_do_not_stop_the_others(failing: Path):
    """An exception, a torque that is none, or the end of the process: as it is imported, checked, run, or drawn."""
    lines = compared_with(failing, ("Sound", *CAUSES), "--episodes", "7")
    for name, line in zip(CAUSES, sorted(lines, key=lambda line: list(CAUSES).index(line.split()[1])), strict=True):
        assert re.match(rf"eval/compare.py: {name} failed on nominal: {CAUSES[name]}", line), line
    results = read_results(failing / "out" / "results.json")
    assert [row["method"] for row in results["rows"]] == ["paper", "Sound", "Shown"]
    assert {failure["method"] for failure in results["failures"]} == {*CAUSES}
    assert {*results["failures"][0]} == {"method", "split", "message"}
    assert "- Raises on nominal: RuntimeError" in (failing / "out" / "page.md").read_text()
    assert "<b>Shown</b> on nominal: on scenario" in (failing / "out" / "report.html").read_text()
    assert not list(failing.glob("out/parts/*Raises*"))  # tried again next time


def test_many_scenarios_are_run_without_the_controllers_that_fail(failing: Path):
    """600 scenarios are parts of 500 and 100."""
    lines = compared_with(failing, ("Exits", "AtOnce"), "--episodes", "600", "--scenario-seed", "1")
    assert [re.findall(r"compare.py: (\w+) failed on nominal", line) for line in lines] == [["Exits"], ["AtOnce"]]


def hang() -> None:
    time.sleep(600)


@pytest.mark.slow
def test_an_added_controller_has_a_limit_of_time(failing: Path):
    (usual,) = choose_methods(("Sound",), added=(f"{failing}/mine.py:Sound",))
    (mine,) = choose_methods(("Sound",), added=(f"{failing}/mine.py:Sound",), time_limit=1.5)
    assert usual.time_limit == custom.TIME_LIMIT and mine.identity == usual.identity
    expected = Failure("Sound", "nominal", "it took longer than 1.5 s, and was ended")
    assert failures.run_controller(mine, "nominal", hang) == expected


@pytest.mark.usefixtures("undrawn")
def test_a_failure_can_be_shown_with_its_whole_traceback(failing: Path):
    """Also where it is the only method's, and nothing is left to compare."""
    options = ("--add", "mine.py:Raises", "--splits", "nominal", "--episodes", "7", "--jobs", "1", "--traceback")
    for methods, status in ((("paper", "Raises"), 1), (("Raises",), 2)):
        code, errors = stopped(compare.main, ("--methods", *methods, *options, "--out", methods[0]), failing)
        assert code == status
        assert "Traceback (most recent call last):" in errors
        assert f'File "{failing}/mine.py", line 18, in fail\n    raise RuntimeError' in errors
    assert errors.splitlines()[-1].startswith("eval/compare.py: no method could be run: Raises on nominal")


def end_process() -> None:
    os._exit(3)


@pytest.mark.parametrize("jobs", [1, 2])
def test_calls_side_by_side_keep_their_order_and_fail_as_a_whole(jobs: int):
    made = calls_side_by_side("calls", {"b": partial(int, "2"), "a": partial(int, "1")}, jobs)
    assert list(made.items()) == [("b", 2), ("a", 1)]
    with pytest.raises(ValueError, match="invalid literal"):
        calls_side_by_side("calls", {"a": partial(int, "1"), "b": partial(int, "one")}, jobs)


@pytest.mark.slow
def test_a_process_that_ends_is_explained():
    with pytest.raises(OSError, match=r"broke off.*--jobs 1"):
        calls_side_by_side("calls", {"a": partial(int, "1"), "b": end_process}, 2)


# Which methods


TWO = ("--splits", "nominal", "ideal")


def test_dominated_methods_run_where_they_are_named():
    for name, better in DOMINATED.items():
        assert name in CONTROLLERS and better in {*CONTROLLERS} - {*DOMINATED}
        assert [method.name for method in choose_methods((name, "paper"))] == ["paper", name]
    default = [method.name for method in choose_methods(())]
    assert default[:2] == ["paper", "rigid"] and not {*DOMINATED} & {*default}


def test_what_was_asked_for_runs_whatever_else_is_named(failing: Path):
    """`--methods` chooses among the project's own; what `--add` and `--policy` give runs with them."""
    added, policies = (f"{failing}/mine.py:Sound",), (bundle(failing / "a"),)
    assert [method.name for method in choose_methods(("adaptive",), policies, added)] == ["adaptive", "my-ppo", "Sound"]
    assert [method.name for method in choose_methods(("adaptive", "Sound"), added=added)] == ["adaptive", "Sound"]
    assert [method.name for method in choose_methods(("privileged",), added=added)] == ["Sound", "privileged"]
    assert [method.name for method in choose_methods(("lqg",), policies, guard=True)] == [
        *("lqg", "lqg+guard", "my-ppo", "my-ppo+guard")
    ]


def bundle(folder: Path, base: str = "paper", sensors: str = "encoder") -> Path:
    spec = BundleSpec("ppo", base, ResidualSettings(), (4,), sensors=sensors, provenance={"run": {"steps": 5}})
    save_bundle(folder, spec, Actor(spec.shape()).weights())
    return folder


def test_policies_are_grouped_by_method(tmp_path: Path):
    folders: list[Path | str] = [bundle(tmp_path / "a"), bundle(tmp_path / "b", base="preview"), bundle(tmp_path / "c")]
    folders += [f"tried={folder}" for folder in folders[::2]]
    methods = learned_methods(folders)
    assert [(method.name, method.base, len(method.sources)) for method in methods] == [
        ("my-ppo", "paper", 2),
        ("my-ppo-preview", "preview", 1),
        ("tried", "paper", 2),
    ]
    assert methods[0].training == {"simulator_steps": [20, 20], "wall_clock_s": [0.0, 0.0]}


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
        (("--episodes", "501"), "--scenario-seed"),
        (("--episodes", "100001", "--scenario-seed", "1"), "--episodes"),
        (("--jobs", "0"), "--jobs"),
        (("--out", "/dev/null/x"), "/dev/null/x"),
        (("--methods", "papr"), "did you mean paper?"),
        (("--splits", "frictoin"), "did you mean friction?"),
        (("--methods", "privileged"), "--methods"),
        (("--add", "nowhere.py:Mine"), "nowhere.py"),
        (("--add", "paper.py:paper"), "'paper'"),
        (("--policy", "student=mine"), "'student'"),
        (("--time-limit", "0"), "--time-limit"),
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


def test_a_full_disk_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def full(path: Path, write: object) -> None:
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(cache, "write_arrays", full)
    arguments = ("--methods", "paper", "--splits", "nominal", "--episodes", "4", "--jobs", "1", "--out", "out")
    assert "No space left on device" in mistake(compare.main, arguments, tmp_path)
