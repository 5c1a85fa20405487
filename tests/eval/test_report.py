"""`report.html`: what it says, that it says it of the numbers, and that it works in a browser."""

from __future__ import annotations

import base64
import re
import shlex
from dataclasses import fields
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from outcomes import made, outcome, outcome_of

from baselines import CONTROLLERS
from baselines.models.modes import held_mode
from baselines.servo.paper import PaperController
from beltarm_env import ArmParams
from beltarm_env.arm import FIELDS
from beltarm_env.metrics import NOT_ARRIVED, SHOWN, TORQUES, heading
from beltarm_env.rollout import Recording, rollout
from eval.comparison.failures import Failure
from eval.comparison.methods import Method, classical_methods
from eval.comparison.pairs import LEFT, SENSITIVE, Pair, measure
from eval.comparison.results import Comparison, MethodOutcome
from eval.comparison.schema import to_json
from eval.comparison.sets import development_set
from eval.comparison.splits import SPLITS, Split
from eval.report import svg, traces
from eval.report.animation import EVERY, animation, encode
from eval.report.arm import arm_drawing
from eval.report.figures import forests, profile_panels
from eval.report.frame import best_first, frame_of, frame_of_rows, lines, part
from eval.report.maps import robustness_maps
from eval.report.markdown import markdown
from eval.report.motions import scene_panels, spectrum
from eval.report.page import LARGEST, render, without_paths
from eval.report.scenes import Map, Recordings, Scene, record_scenes
from eval.report.style import COLOURS
from eval.report.tables import effort_table, main_table, metric_tables, torque_table
from eval.report.traces import Shown, motions, seed_note, shown_seed
from eval.report.verdict import verdict

ROOT = Path(__file__).resolve().parents[2]
# The page


def test_a_method_that_failed_is_named():
    assert render(made(outcome("net", "learned", 60.0), outcome("privileged", "privileged", 1.0)), [], Recordings([]))
    failed = made(outcome("pid", "classical", 100.0), failures=[Failure("net", "nominal", "it <broke>")])
    page = render(failed, [], Recordings([]))
    assert "<b>net</b> on nominal: it &lt;broke&gt;" in page


def test_scenarios_drawn_afresh_are_called_so():
    comparison = made(outcome("pid", "classical", 100.0))
    note = "Scenarios drawn afresh from seed 7, by the rules of the test set, but not the test set."
    assert f"<strong>{note}</strong>" in render(comparison, [], Recordings([]))
    assert markdown(comparison, verdict(comparison), [], "").splitlines()[2] == f"**{note}**"
    assert to_json(comparison)["scenario_set"]["name"] == "seed 7"


WORDS = (
    "cost",
    "scenario, split",
    "residual vibration",
    "residual",
    "training seed",
    "belief",
    "fail, left",
    "arrived",
    "privileged",
)


def test_the_page_begins_with_the_arm_and_the_words_that_it_uses():
    page = render(made(outcome("pid", "classical", 100.0)), ["It is so."], Recordings([]))
    places = [page.index(part) for part in ('<figure class="arm">', "It is so.", '<h2 id="words">', "<table>")]
    assert places == sorted(places)
    words = page.split('<h2 id="words">')[1].split("</dl>")[0]
    assert tuple(re.findall("<dt>(.*?)</dt>", words)) == WORDS
    assert all(len(re.sub("<.*?>", "", text).split()) < 45 for text in words.split("<dt>")[1:])
    assert heading("residual_pp_mm") in words


def mixed() -> Comparison:
    """Methods in no order, on two splits that disagree about it."""
    costs = {"pid": (100.0, 900.0), "lqg": (300.0, 500.0), "flat": (200.0, 700.0)}
    of_splits = list(enumerate(("nominal", "randomized")))
    classical = [outcome(name, "classical", of[k], split) for k, split in of_splits for name, of in costs.items()]
    net = [outcome("net", "learned", 600.0, split, seeds=3) for _, split in of_splits]
    ideal = [outcome("privileged", "privileged", 1.0, split) for _, split in of_splits]
    return made(*ideal, *classical, *net)


def test_methods_come_in_the_order_of_their_cost_on_the_main_split_everywhere():
    page = render(mixed(), [], Recordings([]))
    tables = page.split("<table>")[1:]
    assert len(tables) == 6
    for table in tables:
        assert re.findall('<th scope="row" data-value="(.*?)"', table) == ["lqg", "net", "flat", "pid", "privileged"]
    forest = page.split('<h2 id="differences">')[1].split("</section>")[0]
    labels = [re.findall(r">(lqg|net|flat|pid)</text>", picture) for picture in forest.split("<svg")[1:]]
    assert labels == [["net", "flat", "pid"], ["lqg", "net", "flat"]]


def test_mean_tail_and_failures_stand_beside_the_interquartile_mean():
    costs = np.full((1, 40), 100.0)
    costs[0, 3:5] = 1300.0
    found = outcome("pid", "classical", costs / np.linspace(0.9, 1.1, 40))
    found.metrics["failure_share"][0, 3:8] = found.metrics[LEFT][0, 3] = found.metrics[NOT_ARRIVED][0, 3:5] = 1.0
    comparison = made(found, outcome("calm", "classical", np.full(40, 90.0)))
    cells = {line.method: line.cells for line in metric_tables(comparison)[0].ranked}
    assert cells["pid"][0].text == "100"
    assert cells["pid"][0].details == ("[100, 100]", "160 / 1300", "12% fail, 1 left, 5% not arrived")
    assert len(cells["calm"][0].details) == 2
    table = main_table(comparison)
    assert table.columns[:6] == ["cost", "mean", "worst 5 %", "fail", "left", "not arrived"]
    assert [cell.text for cell in table.ranked[0].cells[:6]] == ["100", "160", "1300", "12%", "1", "5%"]
    shown = render(comparison, [], Recordings([]))
    assert "<small>160 / 1300</small>" in shown and "<small>12% fail, 1 left, 5% not arrived</small>" in shown


def test_a_colour_is_one_method_and_so_is_a_line_style():
    names = ["net", "pid", "lqg", "flat", "adrc", "zvd"]
    comparison = best_first(made(*(outcome(name, "classical", 100.0 + k) for k, name in enumerate(names))))
    colours: dict[str, str] = dict(zip(names, COLOURS, strict=True))
    assert len({str(svg.line(colours, name)["ls"]) for name in names}) == len({colours[name] for name in names}) == 6
    of_method: dict[str, set[str]] = {}
    for picture in [*profile_panels(comparison, colours), *forests(comparison, colours)]:
        for name, drawn in re.findall(r"<title>(\w+)</title>.*?stroke: (var\(--c\d\))", picture.svg, re.S):
            of_method.setdefault(name, set()).add(drawn)
    assert of_method == {name: {f"var(--c{k})"} for k, name in enumerate(names)}


def test_the_page_itself_has_no_colour_that_a_method_has():
    css = (ROOT / "eval/report/report.css").read_text()
    greys = re.findall(r"--(?!c\d)\w+: #(..)(..)(..)", css)
    assert len(greys) >= 12
    assert all(max(int(part, 16) for part in grey) - min(int(part, 16) for part in grey) <= 8 for grey in greys)
    script = (ROOT / "eval/report/animation.js").read_text()
    assert not re.search(r'colour\("--c|"--c\d', script)


# The drawing of the arm


def test_the_drawing_is_the_arm():
    arm = ArmParams()
    found = arm_drawing()

    def bar(name: str) -> np.ndarray:
        numbers = re.search(rf'id="arm-{name}"[^>]* d="M([\d.]+) ([\d.]+)L([\d.]+) ([\d.]+)"', found)
        assert numbers
        return np.array(numbers.groups(), float).reshape(2, 2)

    one, two, hand = bar("link-1"), bar("link-2"), bar("hand")
    assert (one[1] == two[0]).all() and (two[1] == hand[0]).all()
    lengths = [np.linalg.norm(ends[1] - ends[0]) for ends in (one, two, hand)]
    assert lengths[1:] == pytest.approx([lengths[0], lengths[0] * arm.hand_length / arm.link_length], rel=1e-3)
    assert one[0][1] == two[1][1] == hand[1][1]
    large, small = sorted({float(radius) for radius in re.findall(r"A([\d.]+) ", found)}, reverse=True)
    assert large == 2 * small
    words = " ".join(re.findall("<text.*?>(.*?)</text>", found))
    drive = ("motor", "harmonic drive, 88 : 1", "encoder")
    assert all(name in words for name in (*drive, "link 1", "belt", "link 2", "payload", "hand", "the arm&#39;s end"))


def test_the_drawing_in_the_documents_is_that_of_the_report():
    drawing = (ROOT / "docs/arm.svg").read_text(encoding="utf-8")
    assert drawing == arm_drawing()
    assert drawing in render(made(outcome("pid", "classical", 100.0)), [], Recordings([]))


# Tables


def test_torques_have_a_table_on_the_main_split():
    splits = ("nominal", "randomized")
    pid = [outcome("pid", "classical", 100.0, split) for split in splits]
    table = torque_table(made(*pid, *(outcome("privileged", "privileged", 1.0, split) for split in splits)))
    assert table.title == "Torques on randomized"
    assert table.columns == [heading(name) for name in TORQUES]
    assert [line.method for line in table.lines] == ["pid", "privileged"]
    assert all(len(line.cells) == len(TORQUES) for line in table.lines)


def test_marks_of_the_best_and_of_ties():
    cost = metric_tables(
        made(
            outcome("pid", "classical", 100.0),
            outcome("net", "learned", 100.0, spread=4.0),
            outcome("bad", "classical", 400.0),
            outcome("privileged", "privileged", 1.0),
        )
    )[0]
    marks = {row.method: row.cells[0].mark for row in cost.ranked}
    assert sorted([marks["pid"], marks["net"]]) == ["best", "tie"]
    assert marks["bad"] == ""
    assert [row.method for row in cost.unranked] == ["privileged"]
    assert cost.unranked[0].cells[0].mark == ""


def test_the_summary_and_the_page_mark_the_same():
    comparison = made(
        outcome("pid", "classical", 100.0),
        outcome("net", "learned", 100.0, spread=4.0),
        outcome("bad", "classical", 400.0),
        outcome("privileged", "privileged", 1.0),
    )
    text, page = markdown(comparison, verdict(comparison), ["a.png"], "0" * 64), render(comparison, [], Recordings([]))
    marks = comparison.marks["nominal"]["cost"]
    assert sorted(marks.values()) == ["best", "tie"]
    for line in [line for line in text.splitlines() if line.startswith(("| pid | ", "| net | ", "| bad | "))][:3]:
        name = line.split(" | ")[0].removeprefix("| ")
        assert ("**" in line, "<ins>" in line) == (marks.get(name) == "best", marks.get(name) == "tie")
        row = page.split(f'<th scope="row" data-value="{name}">')[1].split("</tr>")[0]
        assert ("<strong>" in row, "<u>" in row) == (marks.get(name) == "best", marks.get(name) == "tie")


def test_a_method_that_failed_on_a_split_has_a_cell_there():
    cost = metric_tables(
        made(outcome("pid", "classical", 1.0), outcome("a", "classical", 2.0, "payload"), failures=[])
    )[0]
    assert [[cell.text for cell in row.cells] for row in cost.ranked] == [["1", "failed"], ["failed", "2"]]


def test_a_comparison_and_its_results_file_have_one_table():
    comparison = made(
        outcome("privileged", "privileged", 1.0),
        outcome("pid", "classical", 100.0),
        outcome("net", "learned", 60.0, seeds=3),
        outcome("net", "learned", 90.0, "payload", seeds=3),
    )
    found, of_file = frame_of(comparison), frame_of_rows(to_json(comparison)["rows"])
    assert found.drop(columns="mark").equals(of_file.drop(columns="mark"))
    assert set(of_file["mark"]) == {""}
    assert len(found) == 4 * len(SHOWN)
    costs = part(found, metric=["cost"])
    assert dict(zip(costs["method"], costs["mark"], strict=True))["privileged"] == ""
    shown = lines(costs, "split", lambda row: f"{row.iqm:.0f} {row.mark}", "failed")
    assert [(line.method, line.seeds, line.cells) for line in shown] == [
        ("pid", 1, ["100 ", "failed"]),
        ("net", 3, ["60 best", "90 best"]),
        ("privileged", 1, ["1 ", "failed"]),
    ]


def test_what_is_slower_than_the_control_period_is_marked():
    (row,) = effort_table(made(outcome("pid", "classical", 1.0))).ranked
    assert [cell.mark for cell in row.cells[-3:-1]] == ["", "late"]
    assert row.cells[-2].details == ("late: 133% of the period",)


def test_samples_and_sensitivity_stand_beside_the_effort():
    (method,) = [known for known in classical_methods() if known.name == "zvd"]
    metrics = outcome("zvd", "classical", 1.0).metrics | {SENSITIVE: np.eye(1, 24)}
    table = effort_table(made(outcome_of(method, "nominal", metrics, (40.0, 50.0)), outcome("pid", "classical", 2.0)))
    (known, unknown) = table.ranked
    steps = method.training["simulator_steps"][0] / 1e6
    assert [cell.text for cell in known.cells[:3]] == ["–", f"{steps:.1f}", f"{steps:.1f}"]
    assert (known.cells[-1].text, unknown.cells[-1].text) == ("4.2", "–")


@given(st.lists(st.text("abcXYZ019_ '", min_size=1, max_size=8), min_size=1, max_size=5))
def test_paths_do_not_reach_the_page(parts: list[str]):
    path = "/".join(parts)
    for folder in ("/", "~/", "~me/", "/home/me and you/"):
        command = shlex.join(["python", "eval/compare.py", "--out", folder + path, f"--add={folder}{path}.py:Mine"])
        expected = f"python eval/compare.py --out …/{parts[-1]} --add=…/{parts[-1]}.py:Mine"
        assert without_paths(command) == expected
    assert (
        without_paths("python eval/compare.py --policy runs/ppo/best")
        == "python eval/compare.py --policy runs/ppo/best"
    )


# Motions


def ringing(hertz: float, amplitude: float, lateral: float) -> Recording:
    """A tip that moves as a sine after the move, on top of an offset and a drift."""
    time = 0.0015 * np.arange(1, 1201)
    motion = 0.003 + 0.001 * time + amplitude * np.sin(2 * np.pi * hertz * time)
    error = np.stack([motion, lateral * np.cos(2 * np.pi * hertz * time)], axis=1)[:, None]
    params = np.array([[getattr(ArmParams(), name) for name in FIELDS]])
    move = np.array([[0.0, 1.0, 0.6, 0.15]])
    zeros = np.zeros((1200, 1, 2))
    return Recording(
        np.zeros((1200, 1, 4)), zeros[:, :, 0], error, zeros, np.zeros(1), np.ones(1, np.bool_), params, move
    )


@given(st.floats(4.0, 20.0), st.floats(0.001, 0.05), st.floats(0.0, 0.05))
def test_the_spectrum_of_a_sine_is_a_peak_of_its_height(hertz: float, amplitude: float, lateral: float):
    frequencies, amplitudes = spectrum(ringing(hertz, amplitude, lateral))
    assert amplitudes.max() == pytest.approx(1000 * np.hypot(amplitude, lateral), rel=0.05)
    assert frequencies[amplitudes.argmax()] == pytest.approx(hertz, abs=0.15)


def test_an_arm_left_alone_rings_at_the_frequency_that_is_marked():
    """The motor of the nominal arm held by friction, the belt released from a torsion."""

    class Nothing:
        def predict(self, observation: Any, *_: Any, **__: Any) -> tuple[Any, None]:
            return np.zeros((len(observation), 1), np.float32), None

    goal = np.radians(20.0)
    options: dict[str, Any] = {"move": {"start": 0.0, "goal": goal, "duration": 0.6, "ramp_time": 0.15}}
    options["state"] = [88 * goal, 0.0, 0.02, 0.0]
    found = rollout(Nothing(), 1, options=options)
    frequencies, amplitudes = spectrum(found)
    expected = 1 / held_mode(goal, ArmParams().plant()).period
    assert frequencies[amplitudes.argmax()] == pytest.approx(expected, rel=0.03)


def test_the_animation_has_the_motion_itself():
    methods = {method.name: method for method in classical_methods()}
    motion = development_set().splits["nominal"].run(methods["paper"].controller(0, []), 3)
    content = animation([Scene("median", "nominal", 3, {"paper": motion})], {"paper": "#0072B2"})
    (scene,) = content["scenes"]
    raw = base64.b64decode(scene["methods"][0]["frames"])
    frames = np.frombuffer(raw, "<f4").reshape(-1, 5)
    assert frames.shape == (1200 // EVERY, 5)
    joint, torsion, radial, lateral, torque = frames[-1]
    last = motion.state[-1, 0]
    assert [joint, torsion] == pytest.approx([last[0] / 88, last[2]], rel=1e-6)
    assert torque == pytest.approx(motion.torque[-1, 0], rel=1e-6)
    reference = np.frombuffer(base64.b64decode(scene["reference"]), "<f4")
    reach = 2 * scene["link"] * np.cos(joint - torsion) + scene["hand"]
    rest = 2 * scene["link"] * np.cos(reference[-1]) + scene["hand"]
    error = 1000 * (reach * np.cos(torsion) - rest), 1000 * reach * np.sin(torsion)
    assert [radial, lateral] == pytest.approx(error, abs=1e-3)


@given(st.lists(st.floats(width=32, allow_nan=False, allow_infinity=False), min_size=1))
def test_encoded_numbers_come_back(values: list[float]):
    assert np.frombuffer(base64.b64decode(encode(np.array(values))), "<f4").tolist() == values


def test_maps_are_one_where_both_methods_are_the_same():
    pid = outcome("paper", "classical", 1.0)
    twin = Method("twin", "added", ("baselines.servo.paper:PaperController",), "")
    comparison = made(pid, MethodOutcome(twin, "nominal", pid.metrics, pid.estimates, (1.0, 1.0)))
    maps, failures = robustness_maps(comparison)
    assert len(maps) == 2 and not failures
    for found in maps:
        assert np.array([found.ratio, found.means]) == pytest.approx(np.ones((2, len(found.y), len(found.x))))
    assert robustness_maps(made(pid)) == ([], [])


def test_maps_are_of_every_classical_controller_best_first(monkeypatch: pytest.MonkeyPatch):
    cells: dict[str, float] = {"pid": 1.0, "lqg": 2.0, "net": 3.0}

    def costs(of: MethodOutcome) -> tuple[np.ndarray, np.ndarray]:
        if of.method.name not in cells:
            raise RuntimeError("no such arm")
        return np.full((2, 5, 5), cells[of.method.name]), np.full((2, 3, 5), cells[of.method.name])

    monkeypatch.setattr("eval.report.maps._costs", costs)
    classical = [outcome(name, "classical", cost) for name, cost in {"pid": 100.0, "lqg": 50.0, "bad": 1.0}.items()]
    maps, failures = robustness_maps(made(*classical, outcome("net", "learned", 60.0)))
    assert [(found.classical, found.ratio[0][0]) for found in maps] == [("lqg", 1.5)] * 2 + [("pid", 3.0)] * 2
    (failure,) = failures
    assert (failure.method, failure.split) == ("bad", "maps")
    assert re.fullmatch(r"RuntimeError: no such arm \(test_report\.py:\d+\)", failure.message)


def measured(name: str, split: Split) -> MethodOutcome:
    (method,) = [known for known in classical_methods() if known.name == name]
    return outcome_of(method, split.name, measure(Pair(method, split, 8)), (40.0, 2000.0))


def test_scenes_are_of_chosen_scenarios_and_what_was_measured():
    splits = {"nominal": development_set().splits["nominal"]}
    outcomes = [measured(name, splits["nominal"]) for name in ("paper", "zvd")]
    scenes, failures = record_scenes(made(*outcomes), splits)
    assert not failures
    costs = outcomes[1].metrics["cost"][0]
    assert [(scene.title, scene.scenario) for scene in scenes][1] == (
        "the worst run of zvd on all splits",
        costs.argmax(),
    )
    for scene in scenes:
        assert set(scene.motions) == {"paper", "zvd"}
        assert scene.motions["zvd"].cost[0] == costs[scene.scenario]


class Trembles(PaperController):
    """Its torques depend on how many arms there are, in the last digit; it does not drive seven."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        if len(observation) == 7:
            raise ValueError("not seven")
        action, state = super().predict(observation, state, episode_start, deterministic)
        return action * np.float32(1 + 1e-6 * (len(observation) > 7)), state


def test_an_episode_that_is_another_one_alone_is_drawn_as_it_was_measured(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(CONTROLLERS, "paper", Trembles)
    splits = {"nominal": development_set().splits["nominal"]}
    found = measured("paper", splits["nominal"])
    scenes, failures = record_scenes(made(found), splits)
    assert scenes and not failures
    for scene in scenes:
        assert scene.motions["paper"].cost[0] == found.metrics["cost"][0, scene.scenario]
        assert splits["nominal"].run(Trembles(), scene.scenario).cost[0] != scene.motions["paper"].cost[0]


def test_motions_are_those_of_each_episode_by_itself(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(traces, "_measured", None)  # none is run by itself
    splits = {name: development_set().splits[name] for name in ("nominal", "drive", "sensing", "structural")}
    outcomes = [measured(name, split) for name in ("paper", "adrc") for split in splits.values()]
    shown = [Shown(splits[name], k) for name, k in product(splits, (1, 6))]
    found, failures = motions(made(*outcomes), shown, ["adrc", "paper"])
    assert not failures
    for (split, k), recordings in zip(shown, found, strict=True):
        assert list(recordings) == ["paper", "adrc"]
        for name, recording in recordings.items():
            alone = split.run(CONTROLLERS[name](), k)
            for field in fields(Recording):
                assert np.array_equal(getattr(recording, field.name), getattr(alone, field.name)), field.name


@pytest.mark.parametrize("count", [4, 7])
def test_motions_that_are_others_side_by_side_or_fail_there_are_recorded_one_by_one(
    count: int, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setitem(CONTROLLERS, "paper", Trembles)
    split = development_set().splits["nominal"]
    outcome = measured("paper", split)
    found, failures = motions(made(outcome), [Shown(split, k) for k in range(count)], ["paper"])
    assert not failures
    assert [one["paper"].cost[0] for one in found] == list(outcome.metrics["cost"][0, :count])


def test_a_method_that_did_not_run_on_a_split_is_not_recorded_there():
    splits = {name: development_set().splits[name] for name in ("nominal", "drive")}
    outcomes = [measured("paper", splits["nominal"]), measured("paper", splits["drive"])]
    outcomes.append(measured("adrc", splits["drive"]))
    found, failures = motions(made(*outcomes), [Shown(split, 0) for split in splits.values()], ["adrc", "paper"])
    assert not failures
    assert [list(one) for one in found] == [["paper"], ["paper", "adrc"]]


def test_what_is_not_what_was_measured_is_not_drawn():
    splits = {"nominal": development_set().splits["nominal"]}
    paper, zvd = (measured(name, splits["nominal"]) for name in ("paper", "zvd"))
    zvd.metrics["cost"][0, :] *= 1 + 1e-12
    scenes, failures = record_scenes(made(paper, zvd), splits)
    assert all(set(scene.motions) == {"paper"} for scene in scenes)
    assert {failure.method for failure in failures} == {"zvd"}
    assert re.search(r"it cost \d+.*, and costs \d+.* when run again: it is not drawn", failures[0].message)


def test_the_seed_of_median_cost_stands_for_a_learned_method():
    costs = np.array([[300.0], [100.0], [200.0], [900.0], [50.0]])
    comparison = made(outcome("pid", "classical", 100.0), outcome("net", "learned", costs, seeds=5))
    assert (shown_seed(comparison, "net"), shown_seed(comparison, "pid")) == (2, 0)
    note = "A learned method is shown by the training seed of median cost on nominal: net by seed 2 of 0 to 4."
    assert seed_note(comparison, ["pid", "net"]) == note
    assert note in markdown(comparison, verdict(comparison), [], "")
    assert seed_note(comparison, ["pid"]) == ""


def test_methods_without_a_colour_are_numbered_and_named():
    names = [f"pid{k}" for k in range(9)]
    methods = [outcome(name, "classical", 100.0 + 10 * k) for k, name in enumerate(names)]
    page = render(made(*methods, outcome("net", "learned", 60.0)), [], Recordings([]))
    profiles = page.split('<h2 id="profiles">')[1].split("</section>")[0]
    numbers = dict(re.findall(r"<li><b>(\d)</b> (\w+)</li>", profiles))
    assert numbers == {str(k): f"pid{k}" for k in range(1, 9)}
    drawn = re.findall(r"<text[^>]*>(\d)</text>", profiles)
    assert sorted(drawn)[: len(numbers)] and set(numbers) <= set(drawn)
    assert all(f"<title>{name}</title>" in profiles for name in [*names, "net"])


def test_the_torque_is_shown_at_the_start_and_at_rest():
    motion = ringing(5.0, 0.001, 0.0)
    motion.torque[:50, 0], motion.torque[600:, 0] = 0.2, 0.01
    panels = scene_panels(Scene("median", "nominal", 3, {"pid": motion}), 0, {"pid": COLOURS[0]})
    said = {picture.title: re.findall('aria-label="(.*?)"', picture.svg)[0] for picture in panels}
    assert "pid 0.2." in said["torque, first 0.15 s"]
    assert "pid 0.01." in said["torque after the move"]


@pytest.mark.slow
def test_the_page_of_a_whole_comparison_stays_small():
    names = [f"method{k}" for k in range(13)]
    outcomes = [outcome(name, "classical", 100.0 + k, split) for split in SPLITS for k, name in enumerate(names)]
    outcomes += [outcome("net", "learned", 90.0, split) for split in SPLITS]
    rng = np.random.default_rng(0)

    def jittery() -> Recording:
        motion = ringing(5.0, 0.01, 0.005)
        motion.torque[:] = 0.1 * rng.standard_normal(motion.torque.shape)
        return motion

    shown = ["net", *names[: len(COLOURS) - 1]]
    scenes = [Scene("chosen", "nominal", k, {name: jittery() for name in shown}) for k in range(4)]
    cells = np.full((5, 5), 0.9).tolist()
    maps = [Map("stiffness", "payload", [1.0] * 5, [1.0] * 5, cells, cells, "net", name, 8, 1) for name in names * 2]
    assert len(render(made(*outcomes), [], Recordings(scenes, maps)).encode()) < LARGEST


def test_maps_are_shown():
    found = Map("stiffness", "payload", [0.5, 1.0], [0.0], [[0.5, 2.0]], [[0.7, 1.4]], "net", "pid", 8, 1)
    comparison = made(outcome("pid", "classical", 100.0), outcome("net", "learned", 60.0))
    page = render(comparison, [], Recordings([], [found]))
    assert "Robustness maps" in page
    assert "8 arms per cell" in page
    assert "net against pid" in page
    shown = page.split('<h2 id="maps">')[1].split("</section>")[0]
    assert {"0.50", "2.00", "0.70", "1.40"} <= set(re.findall(r">([\d.]+)</text>", shown))
