"""A comparison as a user runs it: its files, its numbers, and its report in a browser."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from browser import Page, browser
from commands import stopped
from jsonschema import Draft202012Validator

from beltarm_env.metrics import TORQUE_QUALITY, TORQUES, heading
from eval import compare
from eval.comparison.failures import Failure
from eval.comparison.methods import (
    added_method,
    classical_methods,
    learned_methods,
    privileged_method,
    shipped_policies,
)
from eval.comparison.pairs import Metrics, Pair, run_pairs
from eval.comparison.scenarios import choose_set
from eval.comparison.schema import SCHEMA, check, read_results
from eval.comparison.splits import EDITION, SPLITS, VERSION
from eval.report import maps
from eval.report.page import LARGEST
from eval.report.readme import answer, tables

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = f"{ROOT}/docs/examples/my_controller.py:MyController"
SEEDS = len([folder for folder in shipped_policies() if folder.parent.name == "ppo"])
EPISODES = 20
METHODS = ["paper", "zvd", "ppo", "MyController", "privileged"]
FEW = (
    "--splits",
    "nominal",
    "sensing",
    "--methods",
    *METHODS[:3],
    "privileged",
    "--add",
    EXAMPLE,
    "--episodes",
    str(EPISODES),
)


def read_csv(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Folder and output of the command, with robustness maps of four cells and two moves each."""
    folder, output = tmp_path_factory.mktemp("compared"), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(output):
        for name, values in {"_STIFFNESS": [0.5, 1.2], "_PAYLOAD": [0.0, 0.5], "_FRICTION": [0.5, 1.8]}.items():
            patch.setattr(maps, name, values)
        patch.setattr(maps, "_DELAY", [0.0, 2.0])
        patch.setattr(maps, "MAPS", maps.MAPS._replace(size=2))
        assert stopped(compare.main, (*FEW, "--maps", "--out", "out", "--jobs", "1"), folder)[0] == 0
    return folder / "out", output.getvalue()


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
    assert "report.html" in output
    assert "the best learned method, ppo," in " ".join(output.split())
    assert "privileged against" not in output


def test_every_file_names_the_scenarios(compared: tuple[Path, str], results: dict[str, Any]):
    folder, output = compared
    label = choose_set().label
    assert (results["edition"], results["version"]) == (EDITION, VERSION)
    assert results["scenario_set"] == label._asdict()
    assert label.note in " ".join(output.split())
    assert all(label.note in (folder / name).read_text(encoding="utf-8") for name in ("summary.md", "report.html"))
    assert {row["scenario_set"] for row in read_csv(folder / "episodes.csv")} == {label.name}
    assert f"{EPISODES} scenarios per split of the {label.title};" in tables(results)


def test_torques_of_every_method_are_everywhere(compared: tuple[Path, str], results: dict[str, Any]):
    assert all(name in row["metrics"] for row in results["rows"] for name in TORQUES)
    section = (compared[0] / "summary.md").read_text().split("## Torques\n")[1].split("\n## ")[0]
    assert all(heading(name) in section for name in TORQUES)
    assert [line.split(" | ")[0].strip("|* ") for line in section.splitlines()[-len(METHODS) :]] == METHODS
    table = (compared[0] / "report.html").read_text().split("<summary>Torques on nominal</summary>")[1]
    assert all(f'data-value="{method}"' in table.split("</details>")[0] for method in METHODS)
    assert all(heading(name) in tables(results) for name in TORQUE_QUALITY)


def test_rows_of_the_results(results: dict[str, Any]):
    kinds = {"paper": "classical", "zvd": "classical", "ppo": "learned", "privileged": "privileged"}
    assert [(row["method"], row["split"]) for row in results["rows"]] == [
        (method, split) for split in ("nominal", "sensing") for method in ("paper", "zvd", "ppo", *METHODS[3:])
    ]
    for row in results["rows"]:
        assert row["kind"] == kinds.get(row["method"], "added")
        assert (row["episodes"], row["seeds"]) == (EPISODES, SEEDS if row["method"] == "ppo" else 1)
        assert row["failures"]["runs"] == EPISODES * row["seeds"] >= row["failures"]["not_settled"]
        assert bool(row["training"]) == (row["method"] in ("zvd", "ppo"))
        for value in row["metrics"].values():
            assert value["low"] <= value["iqm"] <= value["high"]


def test_the_privileged_one_is_never_ranked(results: dict[str, Any], compared: tuple[Path, str]):
    compared_methods = {name for pair in results["paired"] for name in (pair["method"], pair["other"])}
    assert compared_methods == {"paper", "zvd", "ppo", "MyController"}
    lines = [line for line in (compared[0] / "summary.md").read_text().splitlines() if "privileged" in line]
    assert lines and not any("**" in line for line in lines if line.startswith("|"))
    shown = tables(results).split("\n\n")
    assert all(table.splitlines()[-1].startswith("| *privileged* |") for table in shown if table.startswith("|"))
    assert "privileged" not in answer(results)


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
            assert shares[-1] == 1 or profile["metric"] == "residual_pp_mm"  # runs that do not arrive


def test_episodes_agree_with_the_results(compared: tuple[Path, str], results: dict[str, Any]):
    rows = read_csv(compared[0] / "episodes.csv")
    assert len(rows) == (4 + SEEDS) * 2 * EPISODES
    costs = sorted(float(row["cost"]) for row in rows if (row["method"], row["split"]) == ("paper", "nominal"))
    iqm = results["rows"][0]["metrics"]["cost"]["iqm"]
    assert iqm == pytest.approx(sum(costs[5:15]) / 10, rel=1e-5)  # of 20 episodes, five cut off at either end


def test_every_split_has_its_section_in_the_summary(compared: tuple[Path, str]):
    text = (compared[0] / "summary.md").read_text()
    assert all(
        f"## {name}\n\n{SPLITS[name].description.capitalize()}; {EPISODES} scenarios." in text
        for name in ("nominal", "sensing")
    )
    assert "## payload" not in text


def pairs_compared() -> list[Pair]:
    """The pairs of method and split of `compared`, in their order."""
    known = [*classical_methods(), *learned_methods(shipped_policies()), added_method(EXAMPLE), privileged_method()]
    splits = choose_set().splits
    chosen = [method for method in known if method.name in METHODS]
    return [Pair(method, splits[name], EPISODES) for name in ("nominal", "sensing") for method in chosen]


def same(first: list[Metrics | Failure], second: list[Metrics | Failure]) -> bool:
    """Whether the same was measured, bit for bit."""
    assert len(first) == len(second)
    return all(
        isinstance(ours, dict)
        and isinstance(theirs, dict)
        and ours.keys() == theirs.keys()
        and all(np.array_equal(ours[name], theirs[name]) for name in ours)
        for ours, theirs in zip(first, second, strict=True)
    )


@pytest.mark.slow
def test_one_process_gives_what_two_gave_and_what_is_done_is_not_done_again(
    compared: tuple[Path, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    torch.set_num_threads(1)  # as the comparison does
    alone = run_pairs(pairs_compared(), tmp_path, 1, lambda _: None)
    before = {path: path.stat().st_mtime_ns for path in (compared[0] / "pairs").iterdir()}
    assert len(before) == 2 * len(METHODS)
    monkeypatch.setattr("eval.comparison.pairs.measure", None)  # nothing is run
    kept = run_pairs(pairs_compared(), compared[0], 1, lambda _: None)
    assert {path: path.stat().st_mtime_ns for path in (compared[0] / "pairs").iterdir()} == before
    assert same(alone, kept)


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
        (lambda r: r["rows"][0]["metrics"].pop("tip_max_mm"), "tip_max_mm must be there"),
        (lambda r: r.update(version="1"), "version must be an integer, got '1'"),
        (lambda r: r["scenario_set"].pop("sha256"), "scenario_set: sha256 must be there"),
        (lambda r: r.update(paired={}), "paired must be a list"),
        (
            lambda r: r["provenance"].update(seconds=float("inf")),
            "provenance: seconds must be a finite number",
        ),
        (lambda r: r["profiles"][2]["thresholds"].append("x"), r"profiles\[2\]: thresholds\[25\] must be a finite"),
    ],
)
def test_a_spoilt_results_file_is_refused(spoil: Any, message: str, results: dict[str, Any]):
    content = json.loads(json.dumps(results))
    spoil(content)
    with pytest.raises(ValueError, match=message):
        check(content, "results")


def test_nan_is_refused_as_a_file_is_read(results: dict[str, Any], tmp_path: Path):
    content = json.loads(json.dumps(results))
    content["rows"][0]["metrics"]["cost"]["low"] = float("nan")
    path = tmp_path / "results.json"
    path.write_text(json.dumps(content))
    with pytest.raises(ValueError, match=r"rows\[0\]: metrics: cost: low must be a finite number, got 'NaN'"):
        read_results(path)


def test_the_schema_is_a_schema():
    Draft202012Validator.check_schema(SCHEMA)


# The page in a browser


@pytest.fixture(scope="module")
def report(compared: tuple[Path, str]) -> Path:
    return compared[0] / "report.html"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with browser(tmp_path_factory.mktemp("browser")) as found:
        yield found


def test_the_page_is_one_small_file_without_machine_paths(report: Path):
    text = report.read_text(encoding="utf-8")
    assert len(text.encode()) < LARGEST
    assert not re.search(r"(?:src|href)=\"(?!#|data:)", text.replace("xlink:href", "href"))
    assert str(ROOT) not in text
    assert "@import" not in text
    identifiers = re.findall(r'\bid="([^"]+)"', text)
    assert len(identifiers) == len(set(identifiers))
    assert text.count('role="img" aria-label="') == len(re.findall("<figure[ >]", text))


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", [390, 768, 1400])
def test_nothing_overflows_and_nothing_complains(report: Path, page: Page, width: int, dark: bool):
    page.complaints.clear()
    page.requests.clear()
    page.open(report, width, dark=dark)
    page.run("document.querySelectorAll('details').forEach((details) => { details.open = true; })")
    assert page.run("document.documentElement.scrollWidth") <= width
    outside = "[...document.querySelectorAll('body *')].filter((e) => !e.closest('.scroll, svg')"
    outside += " && e.getBoundingClientRect().right > innerWidth + 0.5).map((e) => e.outerHTML.slice(0, 80))"
    assert page.run(outside) == []
    assert page.complaints == []
    assert all(address.startswith(("file:", "data:")) for address in page.requests)


def test_without_javascript_all_but_animation_and_sorting_is_there(report: Path, page: Page):
    shown = "[...document.querySelectorAll('h2')].filter((e) => e.checkVisibility()).map((e) => e.id)"
    said = "document.body.innerText.includes('JavaScript is off')"
    page.open(report)
    with_script = page.run(shown)
    assert not page.run(said)
    page.call("Emulation.setScriptExecutionDisabled", value=True)
    try:
        page.open(report)
        without = page.run(shown)
        assert page.run(said)
        assert page.run("getComputedStyle(document.querySelector('thead button'), '::after').content") == "none"
    finally:
        page.call("Emulation.setScriptExecutionDisabled", value=False)
    assert [name for name in with_script if name not in without] == ["animation"]
    assert {"words", "tables", "differences", "profiles", "motions", "maps", "effort"} <= set(without)


def test_paper_shows_every_table_and_no_controls(report: Path, page: Page):
    page.open(report)
    page.call("Emulation.setEmulatedMedia", media="print")
    try:
        tables = "[...document.querySelectorAll('table')].map((e) => e.getBoundingClientRect().height > 0)"
        assert page.run("(dispatchEvent(new Event('beforeprint')), true)")
        assert all(page.run(tables))
        assert not page.run("document.getElementById('play').checkVisibility()")
        maps = "[...document.querySelectorAll('.maps details')].map((e) => e.checkVisibility())"
        assert page.run(maps) == [True, False]
    finally:
        page.call("Emulation.setEmulatedMedia", media="")


def test_tables_are_sorted_by_their_headings(report: Path, page: Page):
    page.open(report)
    column = "[...document.querySelectorAll('table')[0].tBodies[0].rows].map((row) => row.cells[2].dataset.value)"
    sort = "document.querySelectorAll('table')[0].querySelectorAll('thead button')[2]"
    orders = []
    for _ in range(2):
        page.run(f"{sort}.click()")
        orders.append([float(value) for value in page.run(column)])
    assert orders[0] == sorted(orders[0])
    assert orders[1] == sorted(orders[0], reverse=True)
    assert len(orders[0]) == 4
    states = "[...document.querySelectorAll('table')[0].querySelectorAll('thead th')].map((th) => th.ariaSort)"
    assert page.run(states) == ["none", "none", "descending", *["none"] * 6]
    last = "document.querySelector('table').rows[document.querySelector('table').rows.length - 1].innerText"
    assert "privileged" in page.run(last)


def test_the_animation_plays_pauses_and_can_be_scrubbed(report: Path, page: Page):
    page.open(report)
    shot = "document.querySelector('#stage canvas').toDataURL()"
    place = "Number(document.getElementById('scrub').value)"
    assert page.run(place) == 0
    before = page.run(shot)
    page.run("document.getElementById('play').click()")
    page.run(f"new Promise((go) => {{ const wait = () => {place} > 5 ? go() : setTimeout(wait, 20); wait(); }})")
    page.run("document.getElementById('play').click()")
    assert page.run("document.getElementById('play').textContent") == "Play"
    assert page.run(shot) != before
    page.run(
        "(() => { const s = document.getElementById('scrub'); s.value = 250; s.dispatchEvent(new Event('input')) })()"
    )
    assert page.run("document.getElementById('clock').value") == "1.506 s"
    page.run(
        "(() => { const s = document.getElementById('scene'); s.value = 1; s.dispatchEvent(new Event('change')) })()"
    )
    assert page.run(place) == 0
    names = page.run("[...document.querySelectorAll('#stage figcaption')].map((caption) => caption.textContent)")
    assert "ppo" in names
    assert "privileged" not in names
    assert page.complaints == []
