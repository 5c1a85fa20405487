"""The comparison as a user runs it: what it writes, keeps, resumes, and says of mistakes."""

from __future__ import annotations

import csv
import json
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import stopped

from agents.actor import Actor
from agents.bundle import BundleSpec, save_bundle
from agents.residual import ResidualSettings
from baselines import CONTROLLERS
from eval import compare, pairs
from eval.methods import classical_methods, learned_methods, shipped_policies
from eval.pairs import LEFT, Pair, read_kept, run_and_keep
from eval.readme import block
from eval.schema import check, read_results
from eval.splits import SPLITS, VERSION, load

ROOT = Path(__file__).resolve().parent.parent
pytestmark = pytest.mark.xdist_group(Path(__file__).stem)  # so that one worker makes what they share, once
EXAMPLE = f"{ROOT}/docs/examples/my_controller.py:MyController"
METHODS = ["paper", "zvd", "ppo", "MyController", "privileged"]
FEW = ("--splits", "nominal", "sensing", "--methods", *METHODS, "--add", EXAMPLE, "--episodes", "6")


def run(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOT / "eval/compare.py"), *arguments]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=600, check=False)


def read_csv(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    folder = tmp_path_factory.mktemp("compared")
    result = run(*FEW, "--out", "out", "--jobs", "2", cwd=folder)
    assert result.returncode == 0, result.stderr
    return folder / "out", result.stdout


@pytest.fixture(scope="module")
def results(compared: tuple[Path, str]) -> dict[str, Any]:
    return read_results(compared[0] / "results.json")


def test_everything_is_written(compared: tuple[Path, str]):
    folder, output = compared
    pictures = {"tip_error.png", "residual.png", "torque.png", "intervals.png"}
    assert {path.name for path in folder.iterdir()} == {
        "results.json",
        "episodes.csv",
        "summary.md",
        "report.html",
        "pairs",
        *pictures,
    }
    assert all((folder / name).read_bytes().startswith(b"\x89PNG") for name in pictures)
    assert all(method in output for method in METHODS)
    assert "ppo against" in output
    assert "privileged against" not in output


def test_all_methods_run_on_a_split_by_default(tmp_path: Path):
    result = run("--splits", "structural", "--episodes", "4", "--out", "out", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    rows = read_results(tmp_path / "out" / "results.json")["rows"]
    shipped = {path.parent.name for path in shipped_policies()}
    assert {row["method"] for row in rows} == {*CONTROLLERS, *shipped, "privileged"}


def test_rows_of_the_results(results: dict[str, Any]):
    kinds = {"paper": "classical", "zvd": "classical", "ppo": "learned", "privileged": "privileged"}
    assert [(row["method"], row["split"]) for row in results["rows"]] == [
        (method, split) for split in ("nominal", "sensing") for method in ("paper", "zvd", "ppo", *METHODS[3:])
    ]
    for row in results["rows"]:
        assert row["kind"] == kinds.get(row["method"], "added")
        assert (row["episodes"], row["seeds"]) == (6, 5 if row["method"] == "ppo" else 1)
        assert row["failures"]["runs"] == 6 * row["seeds"] >= row["failures"]["not_settled"]
        assert bool(row["training"]) == (row["method"] in ("zvd", "ppo"))
        for value in row["metrics"].values():
            assert value["low"] <= value["iqm"] <= value["high"]


def test_the_privileged_one_is_never_ranked(results: dict[str, Any], compared: tuple[Path, str]):
    compared_methods = {name for pair in results["paired"] for name in (pair["method"], pair["other"])}
    assert compared_methods == {"paper", "zvd", "ppo", "MyController"}
    lines = [line for line in (compared[0] / "summary.md").read_text().splitlines() if "privileged" in line]
    assert lines and not any("**" in line for line in lines if line.startswith("|"))
    tables = block(results).split("\n\n")
    assert all(table.splitlines()[-1].startswith("| *privileged* |") for table in tables if table.startswith("|"))


def test_paired_rows(results: dict[str, Any]):
    assert {(pair["method"], pair["against"]) for pair in results["paired"] if pair["split"] == "nominal"} == {
        ("paper", "best classical"),
        ("ppo", "best classical"),
        ("MyController", "best classical"),
        ("ppo", "base"),
    }
    for pair in results["paired"]:
        assert pair["other"] == ("zvd" if pair["against"] == "best classical" else "paper")
        for value in pair["metrics"].values():
            assert 0 < value["p"] <= value["p_holm"] <= 1
            assert 0 <= value["win_rate_low"] <= value["win_rate"] <= value["win_rate_high"] <= 1


def test_profiles_rise_from_none_to_all(results: dict[str, Any]):
    assert len(results["profiles"]) == 2 * 3
    for profile in results["profiles"]:
        assert set(profile["methods"]) == set(METHODS)
        assert np.all(np.diff(profile["thresholds"]) >= 0)
        for shares in profile["methods"].values():
            assert len(shares) == len(profile["thresholds"])
            assert np.all(np.diff(shares) >= 0)
            assert shares[-1] == 1


def test_episodes_agree_with_the_results(compared: tuple[Path, str], results: dict[str, Any]):
    rows = read_csv(compared[0] / "episodes.csv")
    assert len(rows) == (4 + 5) * 2 * 6
    costs = sorted(float(row["cost"]) for row in rows if (row["method"], row["split"]) == ("paper", "nominal"))
    iqm = results["rows"][0]["metrics"]["cost"]["iqm"]
    assert iqm == pytest.approx(sum(costs[1:5]) / 4, rel=1e-5)  # 6 episodes: one cut off at either end


def test_one_process_gives_what_two_give(compared: tuple[Path, str], tmp_path: Path):
    result = run(*FEW, "--out", "out", "--jobs", "1", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "out" / "episodes.csv").read_bytes() == (compared[0] / "episodes.csv").read_bytes()


# Schema


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda r: r.pop("rows"), "results: rows must be there"),
        (
            lambda r: r["rows"][1].update(kind="best"),
            r"results: rows\[1\]: kind must be one of classical, .* got 'best'",
        ),
        (lambda r: r["rows"][0]["metrics"]["cost"].update(low=float("nan")), r"rows\[0\].*low must be a finite number"),
        (lambda r: r["rows"][0]["metrics"].pop("settling_s"), "settling_s must be there"),
        (lambda r: r.update(version="1"), "version must be of type int, got '1'"),
        (lambda r: r.update(paired={}), "paired must be a list"),
        (lambda r: r["profiles"][2]["thresholds"].append("x"), r"profiles\[2\]: thresholds\[25\] must be a finite"),
    ],
)
def test_a_spoilt_results_file_is_refused(spoil: Any, message: str, results: dict[str, Any]):
    content = json.loads(json.dumps(results))
    spoil(content)
    with pytest.raises(ValueError, match=message):
        check(content, "results")


# What is kept


def pair(method: str = "paper", episodes: int = 4, split: str = "nominal") -> Pair:
    (found,) = [known for known in classical_methods() if known.name == method]
    return Pair(found, load()[split], episodes)


def test_pairs_are_kept_and_read_again(tmp_path: Path):
    measured = run_and_keep(pair(), tmp_path)
    kept = read_kept(pair(), tmp_path)
    assert isinstance(measured, dict) and kept is not None
    assert set(kept) == set(measured) and LEFT in kept
    assert all(np.array_equal(kept[name], measured[name]) for name in kept)


def test_keys_depend_on_everything_that_the_numbers_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    one = pair("zvd")
    others = [
        pair("zv"),
        pair("zvd", 5),
        pair("zvd", split="payload"),
        replace(one, split=replace(one.split, digest="other")),
        replace(one, method=replace(one.method, identity="other gains")),
    ]
    files = {found.file(tmp_path) for found in [one, *others]}
    assert len(files) == 1 + len(others)
    assert one.file(tmp_path) == pair("zvd").file(tmp_path)
    monkeypatch.setattr(pairs, "_sources", lambda: "other code")
    assert one.file(tmp_path) not in files


def test_gains_are_part_of_the_identity(monkeypatch: pytest.MonkeyPatch):
    identities = {method.name: method.identity for method in classical_methods()}
    changed = {"zvd": {"gains": {"angle": 1.0}, "provenance": {"steps": 1, "seconds": 1.0}}}
    monkeypatch.setattr("eval.methods.read_file", lambda: changed)
    assert {method.name: method.identity for method in classical_methods()}["zvd"] != identities["zvd"]


@pytest.mark.parametrize("damage", [b"", b"half", None])
def test_damaged_pairs_are_run_again(damage: bytes | None, tmp_path: Path):
    measured = run_and_keep(pair(), tmp_path)
    path = pair().file(tmp_path)
    path.write_bytes(path.read_bytes()[:-200] if damage is None else damage)
    assert read_kept(pair(), tmp_path) is None
    (again,) = pairs.run_pairs([pair()], tmp_path, 1, lambda _: None)
    assert isinstance(measured, dict) and isinstance(again, dict)
    assert np.array_equal(again["cost"], measured["cost"])


def test_outdated_pairs_are_taken_away(tmp_path: Path):
    old = replace(pair(), method=replace(pair().method, identity="before"))
    run_and_keep(old, tmp_path)
    run_and_keep(pair(episodes=5), tmp_path)
    run_and_keep(pair(), tmp_path)
    names = sorted(path.name for path in (tmp_path / "pairs").iterdir())
    assert names == sorted([pair().file(tmp_path).name, pair(episodes=5).file(tmp_path).name])


def test_what_is_done_is_not_done_again(compared: tuple[Path, str]):
    folder = compared[0]
    before = {path: path.stat().st_mtime_ns for path in (folder / "pairs").iterdir()}
    assert len(before) == 2 * len(METHODS)
    result = run(*FEW, "--out", str(folder), cwd=folder)
    assert result.returncode == 0, result.stderr
    assert {path: path.stat().st_mtime_ns for path in (folder / "pairs").iterdir()} == before


def test_an_interrupted_run_says_what_is_kept_and_goes_on(tmp_path: Path):
    methods, splits = ("paper", "zvd", "preview", "mpc"), ("nominal", "payload", "friction", "structural")
    arguments = ("--methods", *methods, "--splits", *splits, "--episodes", "24", "--out", "out")
    command = [sys.executable, str(ROOT / "eval/compare.py"), *arguments, "--jobs", "2"]
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 300
    while not list(tmp_path.glob("out/pairs/[!.]*")) and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=300)
    assert process.returncode == 130, errors
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.glob("out/pairs/*")}
    assert 1 <= len(kept) < 16
    assert len(errors.strip().splitlines()) == 1
    assert f"interrupted: {len(kept)} of 16 pairs of method and split are kept in out; the same" in errors
    result = run(*arguments, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    assert len(list(tmp_path.glob("out/pairs/*"))) == 16


# What goes wrong


def test_a_controller_that_fails_on_the_way_does_not_stop_the_others(tmp_path: Path):
    (tmp_path / "mine.py").write_text(
        "import numpy as np\n"
        "class Fails:\n"
        "    def predict(self, observation, state=None, episode_start=None, deterministic=True):\n"
        "        if len(observation) == 7:\n"
        "            raise RuntimeError('no such\\nnumber of arms')\n"
        "        return np.zeros((len(observation), 1), np.float32), None\n"
        "class Nan(Fails):\n"
        "    def predict(self, observation, *rest, **options):\n"
        "        bad = np.nan if len(observation) == 7 else 0\n"
        "        return np.full((len(observation), 1), bad, np.float32), None\n"
    )
    added = ("--add", "mine.py:Fails", "--add", "mine.py:Nan")
    chosen = ("--methods", "paper", "Fails", "Nan", "--splits", "nominal", "--episodes", "7")
    result = run(*added, *chosen, "--out", "out", cwd=tmp_path)
    assert result.returncode == 1
    assert "eval/compare.py: Fails failed on nominal: RuntimeError: no such number of arms" in result.stderr
    assert "eval/compare.py: Nan failed on nominal: ValueError" in result.stderr
    assert "Traceback" not in result.stderr
    results = read_results(tmp_path / "out" / "results.json")
    assert [row["method"] for row in results["rows"]] == ["paper"]
    assert [failure["method"] for failure in results["failures"]] == ["Fails", "Nan"]
    assert "- Fails on nominal: RuntimeError" in (tmp_path / "out" / "summary.md").read_text()
    assert not list(tmp_path.glob("out/pairs/*Fails*"))  # tried again next time


def test_a_controller_that_fails_on_a_single_arm_does_not_stop_the_others(tmp_path: Path):
    (tmp_path / "mine.py").write_text(
        "import numpy as np\n"
        "class Alone:\n"
        "    def predict(self, observation, state=None, episode_start=None, deterministic=True):\n"
        "        state = (0 if state is None else state) + 1\n"
        "        if len(observation) == 1 and state > 700:\n"
        "            raise IndexError('one arm\\nis too few')\n"
        "        return np.zeros((len(observation), 1), np.float32), state\n"
    )
    chosen = ("--add", "mine.py:Alone", "--methods", "paper", "Alone", "--splits", "nominal", "--episodes", "6")
    result = run(*chosen, "--out", "out", cwd=tmp_path)
    assert result.returncode == 1, result.stderr
    assert re.search(r"Alone failed on nominal: alone on scenario \d: IndexError: one arm is too few", result.stderr)
    assert len(result.stderr.strip().splitlines()) == 1
    results = read_results(tmp_path / "out" / "results.json")
    assert [row["method"] for row in results["rows"]] == ["paper", "Alone"]
    assert [failure["method"] for failure in results["failures"]] == ["Alone"]
    assert "<b>Alone</b> on nominal: alone on" in (tmp_path / "out" / "report.html").read_text()


def bundle(folder: Path, base: str = "paper", sensors: str = "encoder") -> Path:
    spec = BundleSpec("ppo", base, ResidualSettings(), (4,), sensors=sensors, provenance={"run": {"steps": 5}})
    save_bundle(folder, spec, Actor(spec.shape()))
    return folder


def test_policies_are_grouped_by_method(tmp_path: Path):
    folders = [bundle(tmp_path / "a"), bundle(tmp_path / "b", base="preview"), bundle(tmp_path / "c")]
    found = learned_methods(folders)
    assert [(method.name, method.base, len(method.sources)) for method in found] == [
        ("ppo", "paper", 2),
        ("ppo-preview", "preview", 1),
    ]
    assert found[0].training == {"simulator_steps": [20, 20], "wall_clock_s": [0.0, 0.0]}


def test_policies_of_other_sensors_are_refused(tmp_path: Path):
    with pytest.raises(ValueError, match="needs sensors='tip'; the comparison gives all methods the encoder alone"):
        learned_methods([bundle(tmp_path / "a", sensors="tip")])


def test_given_policies_take_the_place_of_the_shipped(tmp_path: Path):
    bundle(tmp_path / "mine")
    result = run(
        "--policy", "mine", "--methods", "ppo", "paper", "--splits", "nominal", "--episodes", "4", cwd=tmp_path
    )
    assert result.returncode == 0, result.stderr
    rows = read_results(tmp_path / "results" / "compare" / "results.json")["rows"]
    assert [(row["method"], row["seeds"]) for row in rows] == [("paper", 1), ("ppo", 1)]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--policy", "nowhere"), "no policy bundle at nowhere"),
        (("--episodes", "2"), "--episodes must lie within 4 and 200, got 2"),
        (("--episodes", "201"), "--episodes must lie within 4 and 200, got 201"),
        (("--jobs", "0"), "--jobs must lie within 1 and 256, got 0"),
        (("--out", "/dev/null/x"), "cannot write to /dev/null/x"),
        (("--methods", "papr"), "unknown method 'papr'; did you mean paper? Known: paper, rigid,"),
        (("--splits", "frictoin"), "unknown split 'frictoin'; did you mean friction? Known: nominal, randomized,"),
        (("--methods", "privileged"), "--methods names privileged alone"),
        (("--add", "nowhere.py:Mine"), "there is no file"),
        (("--add", "paper.py:paper"), "two methods are called 'paper': give yours another name"),
        (("--add", "bad.py:Bad"), "bad.py:Bad does not keep the protocol (drives 5 arms"),
        (("--out", "old", "--methods", "paper"), f"results of version {VERSION + 1} of the scenarios"),
        (("--out", "damaged", "--methods", "paper"), "damaged/results.json cannot be read"),
    ],
)
def test_mistakes_are_one_line(arguments: tuple[str, ...], message: str, tmp_path: Path):
    (tmp_path / "bad.py").write_text("class Bad:\n    def predict(self, *_, **__):\n        return 1, None\n")
    (tmp_path / "paper.py").write_text("class paper:\n    def predict(self, *_, **__):\n        return 1, None\n")
    for name, text in {"old": json.dumps({"version": VERSION + 1}), "damaged": "{"}.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "results.json").write_text(text)
    code, errors = stopped(compare.main, arguments, tmp_path)
    assert code == 2, errors
    assert message in errors
    assert len(errors.strip().splitlines()) == 1


def test_a_full_disk_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    def full(path: Path, write: object) -> None:
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(pairs, "write_atomically", full)
    arguments = ("--methods", "paper", "--splits", "nominal", "--episodes", "4", "--jobs", "1", "--out", str(tmp_path))
    monkeypatch.setattr(sys, "argv", ["compare.py", *arguments])
    with pytest.raises(SystemExit) as stopped:
        compare.main()
    assert stopped.value.code == 2
    errors = capsys.readouterr().err.strip().splitlines()
    assert len(errors) == 1
    assert "No space left on device" in errors[0]


def test_every_split_has_its_section_in_the_summary(compared: tuple[Path, str]):
    text = (compared[0] / "summary.md").read_text()
    assert all(
        f"## {name}\n\n{SPLITS[name].description.capitalize()}; 6 scenarios." in text for name in ("nominal", "sensing")
    )
    assert "## payload" not in text
