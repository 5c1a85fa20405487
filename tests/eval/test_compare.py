"""A comparison as a user runs it: its files, its numbers, its verification, and its report in a browser."""

import contextlib
import csv
import io
import json
import re
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from browser import asked
from commands import ROOT, mistake, stopped
from jsonschema import Draft202012Validator
from studies import draw_alone

from agents.policy.bundle import POLICIES
from beltarm_env.metrics import TORQUES
from eval import compare
from eval.comparison import custom, provenance
from eval.comparison.schema import SCHEMA, read_results
from eval.comparison.sets import choose_set
from eval.comparison.splits import EDITION, SPLITS, VERSION
from eval.report import publish
from eval.report.publish import LARGEST

SEEDS = 2
EPISODES, BOTH = 20, ("nominal", "sensing")
MOVES = {"nominal": 1, "sensing": 2}
METHODS = ["paper", "ei", "ppo", "privileged"]
CHOSEN = ("--methods", *METHODS, "--quick")


@pytest.fixture(scope="module", autouse=True)
def committed() -> Iterator[None]:
    """On a clean commit, and without the digest, which takes seconds."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(provenance, "inputs_digest", lambda *_: "0" * 64)
        patch.setattr(provenance, "commit", lambda: "1234567")
        yield


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    folder, output = tmp_path_factory.mktemp("compared"), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(output):
        patch.setattr(publish, "save_figures", draw_alone)
        assert stopped(compare.main, (*CHOSEN, "--splits", *BOTH, "--out", "out", "--jobs", "1"), folder)[0] == 0
    return folder / "out", output.getvalue()


@pytest.fixture(scope="module")
def results(compared: tuple[Path, str]) -> dict[str, Any]:
    return read_results(compared[0] / "results.json")


def test_everything_is_written_and_names_the_scenarios(compared: tuple[Path, str], results: dict[str, Any]):
    folder, output = compared
    assert {path.name for path in folder.iterdir()} == {*custom.WRITTEN, custom.PARTS}
    label = choose_set().label
    assert (results["edition"], results["version"]) == (EDITION, VERSION)
    assert results["scenario_set"] == label._asdict()
    texts = [output, *((folder / name).read_text(encoding="utf-8") for name in ("page.md", "report.html"))]
    assert all(label.note in " ".join(text.split()) and all(method in text for method in METHODS) for text in texts)
    assert [name for name in re.findall("^## (.*)$", texts[1], re.MULTILINE) if name in SPLITS] == [*BOTH]
    lines = [line for line in texts[1].splitlines() if "*privileged*" in line]
    assert lines and not any("**" in line for line in lines), "it is not ranked"


def test_rows_and_pairs_of_the_results(results: dict[str, Any]):
    kinds = {"paper": "classical", "ei": "classical", "ppo": "learned", "privileged": "privileged"}
    assert [(row["split"], row["method"]) for row in results["rows"]] == [*product(BOTH, METHODS)]
    for row in results["rows"]:
        assert row["kind"] == kinds[row["method"]] and row["moves"] == MOVES[row["split"]]
        assert (row["episodes"], row["seeds"]) == (EPISODES, SEEDS if row["method"] == "ppo" else 1)
        runs = EPISODES * row["seeds"] * row["moves"]
        assert row["failures"]["runs"] == runs >= row["failures"]["not_settled"]
        assert bool(row["training"]) == (row["method"] in ("ei", "ppo"))
        assert {*TORQUES} <= row["metrics"].keys()
        assert all(value["low"] <= value["iqm"] <= value["high"] for value in row["metrics"].values())
    assert {(pair["method"], pair["split"]) for pair in results["paired"]} == {*product(("paper", "ppo"), BOTH)}
    assert {(pair["other"], pair["against"]) for pair in results["paired"]} == {("ei", "best classical")}
    for value in (value for pair in results["paired"] for value in pair["metrics"].values()):
        assert 0 < value["p"] <= value["p_holm"] <= 1
        assert 0 <= value["win_rate_low"] <= value["win_rate"] <= value["win_rate_high"] <= 1


def test_episodes_agree_with_the_results(compared: tuple[Path, str], results: dict[str, Any]):
    with (compared[0] / "episodes.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == (3 + SEEDS) * 2 * EPISODES
    assert {row["scenario_set"] for row in rows} == {choose_set().label.name}
    costs = sorted(float(row["cost"]) for row in rows if (row["method"], row["split"]) == ("paper", "nominal"))
    iqm = results["rows"][0]["metrics"]["cost"]["iqm"]
    assert iqm == pytest.approx(sum(costs[5:15]) / 10, rel=1e-5)  # of 20 episodes, five cut off at either end
    assert results["rows"][0]["cost_mean"] == pytest.approx(np.mean(costs), rel=1e-5)


def verified(folder: Path) -> tuple[int, str]:
    output = io.StringIO()
    with contextlib.redirect_stdout(output):
        code, errors = stopped(compare.main, ("--verify", str(folder), "--jobs", "1"), folder.parent)
    return code, output.getvalue() + errors


@pytest.fixture(scope="module")
def claim(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("claim")
    (folder / "mine.py").write_text("from baselines.servo.paper import PaperController as Mine\n")
    words = ("--methods", "paper", "--splits", "nominal", "--episodes", "4", "--jobs", "1", "--out", "out")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(publish, "plots", lambda *_: {})
        patch.setattr(publish, "render", lambda *_: "")
        patch.setattr(provenance, "command_line", lambda: "python eval/compare.py --add=mine.py:Mine")
        assert stopped(compare.main, ("--add", "mine.py:Mine", *words), folder) == (0, "")
    return folder / "out"


def test_results_are_verified(claim: Path):
    before = {path: path.read_bytes() for path in claim.iterdir() if path.is_file()}
    code, output = verified(claim)
    assert [row["kind"] for row in read_results(claim / "results.json")["rows"]] == ["classical", "added"]
    assert code == 0 and len(output.strip().splitlines()) == 1
    assert {path: path.read_bytes() for path in claim.iterdir() if path.is_file()} == before


def scale(numbers: dict[str, Any], name: str, factor: float) -> None:
    numbers[name] *= factor


def test_the_first_claim_that_differs_is_named(claim: Path, tmp_path: Path):
    for change, code, named in (
        (lambda row, _: scale(row["metrics"]["cost"], "iqm", 1.002), 0, "come out again"),
        (lambda row, _: scale(row["metrics"]["cost"], "iqm", 0.99), 1, "paper on nominal, cost:"),
        (lambda row, _: scale(row, "cost_mean", 0.99), 1, "paper on nominal, cost_mean:"),
        (lambda row, _: row["failures"].update(not_settled=0), 1, "paper on nominal, not_settled:"),
        (lambda row, _: scale(row["metrics"]["still_s"], "iqm", 0.9), 1, "paper on nominal, still_s:"),
        (lambda row, _: scale(row["metrics"]["tip_rms_mm"], "iqm", 0.95), 1, "paper on nominal, tip_rms_mm:"),
        (lambda row, _: row["metrics"].pop("still_s"), 1, "claimed nan"),
        (lambda row, _: row.update(seeds=5), 1, "claimed 5, here 1"),
        (lambda _, content: content["paired"][0]["metrics"]["cost"].update(verdict="better"), 1, "claimed better"),
        (lambda _, content: content["paired"][0]["metrics"]["cost"].update(iqm=-100.0), 1, "claimed -100"),
        (lambda _, content: content["paired"].clear(), 1, "claimed nan"),
        (lambda _, content: content.update(verdict=["Mine is better."]), 0, "its verdict"),
    ):
        content = read_results(claim / "results.json")
        content["provenance"]["command"] = f"python eval/compare.py --add={claim.parent / 'mine.py'}:Mine"
        change(content["rows"][0], content)
        (tmp_path / "results.json").write_text(json.dumps(content))
        status, output = verified(tmp_path)
        assert status == code and named in output


def test_claims_that_cannot_be_verified_are_refused(claim: Path, tmp_path: Path):
    for part, value, named in (
        ("provenance", {"commit": "1234567-dirty"}, "1234567-dirty"),
        ("scenario_set", {"sha256": "0" * 64}, "other scenarios"),
        ("provenance", {"command": "python eval/compare.py"}, "--add"),
        ("provenance", {"added": {"Mine": "0" * 64}}, "other files of Mine"),
        ("provenance", {"command": "python eval/compare.py --add none.py:Mine"}, "none.py"),
    ):
        content = read_results(claim / "results.json")
        content["provenance"]["command"] = f"python eval/compare.py --add={claim.parent / 'mine.py'}:Mine"
        content[part] |= value
        (tmp_path / "results.json").write_text(json.dumps(content))
        assert named in mistake(compare.main, ("--verify", str(tmp_path)), tmp_path)


def test_policies_of_a_first_look(results: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    content = json.loads(json.dumps(results))
    content["provenance"]["command"] += f" --policy {POLICIES / 'ppo' / 'seed4'}"
    for row in content["rows"]:
        row["seeds"] += row["method"] == "ppo"
    (tmp_path / "results.json").write_text(json.dumps(content))
    again = mistake(compare.main, (*CHOSEN, "--splits", *BOTH, "--out", "."), tmp_path)
    assert "(3 policies of ppo)" in again and "--out" in again
    measure = Mock(side_effect=ValueError("measured"))
    monkeypatch.setattr("eval.comparison.run.compare", measure)
    assert "measured" in mistake(compare.main, ("--verify", "."), tmp_path)
    assert [len(method.sources) for method in measure.call_args.args[0]] == [1, 1, 3, 1]


def test_a_spoilt_results_file_is_refused(results: dict[str, Any], tmp_path: Path):
    Draft202012Validator.check_schema(SCHEMA)
    for spoil, place in (
        (lambda r: r.pop("rows"), "rows"),
        (lambda r: r["rows"][1].update(kind="best"), r"rows\[1\]\.kind"),
        (lambda r: r["rows"][0]["metrics"]["cost"].update(low=float("nan")), r"rows\[0\].*low"),
        (lambda r: r["rows"][0]["metrics"].pop("tip_max_mm"), "tip_max_mm"),
        (lambda r: r.update(version="1"), "version"),
        (lambda r: r.update(paired={}), "paired"),
    ):
        content = json.loads(json.dumps(results))
        spoil(content)
        (tmp_path / "results.json").write_text(json.dumps(content))
        with pytest.raises(ValueError, match=place):
            read_results(tmp_path / "results.json")


# The page in a browser


def test_the_page_is_one_small_file_without_machine_paths(compared: tuple[Path, str]):
    text = (compared[0] / "report.html").read_text(encoding="utf-8")
    assert len(text.encode()) < LARGEST
    assert not re.search(r"(?:src|href)=\"(?!#|data:)", text.replace("xlink:href", "href"))
    assert str(ROOT) not in text and "@import" not in text
    identifiers = re.findall(r'\bid="([^"]+)"', text)
    assert len(identifiers) == len(set(identifiers))
    assert text.count('role="img" aria-label="') == len(re.findall("<figure[ >]", text))
    assert {*re.findall(r'href="#([^"]+)"', text.split("<main>")[0])} <= {*identifiers}


@pytest.mark.parametrize("width", [390, 1400])
def test_nothing_overflows(compared: tuple[Path, str], tmp_path: Path, width: int):
    open_all = "document.querySelectorAll('details').forEach((details) => { details.open = true; });"
    outside = "[...document.querySelectorAll('body *')].filter((e) => !e.closest('.scroll, svg')"
    outside += " && e.getBoundingClientRect().right > innerWidth + 0.5).map((e) => e.outerHTML.slice(0, 80))"
    script = f"{open_all} return [innerWidth, document.documentElement.scrollWidth, {outside}]"
    shown, needed, beyond = asked(compared[0] / "report.html", script, tmp_path, width)
    assert shown == width >= needed and beyond == []


def test_tables_are_sorted_by_their_headings(compared: tuple[Path, str], tmp_path: Path):
    script = """
    const table = document.querySelector("table"), orders = [];
    for (const turn of [0, 1]) {
      table.querySelectorAll("thead button")[2].click();
      orders.push([...table.tBodies[0].rows].map((row) => Number(row.cells[2].dataset.value)));
    }
    const sorts = [...table.querySelectorAll("thead th")].map((th) => th.ariaSort);
    return [...orders, sorts, table.rows[table.rows.length - 1].innerText]"""
    first, second, sorts, last = asked(compared[0] / "report.html", script, tmp_path)
    assert first == sorted(first) == second[::-1] and len(first) == 3
    assert sorts.pop(2) == "descending" and {*sorts} == {"none"} and "privileged" in last


def test_the_animation_plays_pauses_and_can_be_scrubbed(compared: tuple[Path, str], tmp_path: Path):
    script = """
    const shot = () => document.querySelector("#stage canvas").toDataURL(), place = () => Number(scrub.value);
    const before = shot();
    play.click();
    await new Promise((go) => { const wait = () => place() > 5 ? go() : setTimeout(wait, 20); wait(); });
    play.click();
    const moved = play.textContent === "Play" && shot() !== before;
    scrub.value = 250;
    scrub.dispatchEvent(new Event("input"));
    const time = clock.value;
    scene.value = 1;
    scene.dispatchEvent(new Event("change"));
    const names = [...document.querySelectorAll("#stage figcaption")].map((caption) => caption.textContent);
    return [moved, time, place(), names]"""
    moved, time, place, names = asked(compared[0] / "report.html", script, tmp_path)
    assert (moved, time, place) == (True, "1.506 s", 0)
    assert "ppo" in names and "privileged" not in names
