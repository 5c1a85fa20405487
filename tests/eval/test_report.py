"""`report.html`: what it says, that it says it of the numbers, and that it works in a browser."""

import base64
import re
import shlex
from dataclasses import fields
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from outcomes import content_of, made, outcome, outcome_of

from baselines import CONTROLLERS
from baselines.servo.paper import PaperController
from beltarm_env import ArmParams
from beltarm_env.rollout import Recording, rollout
from eval.comparison.cache import Part, measure
from eval.comparison.methods import classical_methods
from eval.comparison.results import MethodOutcome
from eval.comparison.rollouts import Failure
from eval.comparison.sets import development_set
from eval.comparison.splits import Split
from eval.report import summary
from eval.report.figures import spectrum
from eval.report.publish import EVERY, animation, render, without_paths
from eval.report.recordings import Scene, loaded, record, record_scenes
from eval.report.table import Results, to_markdown
from eval.studies._frame import text_of


def test_methods_come_in_the_order_of_their_cost_on_the_main_split_everywhere():
    costs = {"pid": (100.0, 900.0), "lqg": (300.0, 500.0), "flat": (200.0, 700.0)}
    methods = []
    for k, split in enumerate(("nominal", "randomized")):
        methods += [outcome("privileged", "privileged", 1.0, split), outcome("net", "learned", 600.0, split, seeds=3)]
        methods += [outcome(name, "classical", both[k], split) for name, both in costs.items()]
    content = content_of(made(*methods, failures=[Failure("bad", "nominal", "it <broke>")]))
    shown, order = render(content), ["lqg", "net", "flat", "pid", "privileged"]
    assert "<b>bad</b> on nominal: it &lt;broke&gt;" in shown
    assert "- bad on nominal: it <broke>\n" in text_of("comparison", summary, content)
    tables = shown.split("<table>")[1:]
    assert len(tables) == 7
    for table in tables:
        assert re.findall('<th scope="row" data-value="(.*?)"', table) == order
    forest = shown.split('<h2 id="differences">')[1].split("</section>")[0]
    labels = [re.findall(r">(lqg|net|flat|pid)</text>", picture) for picture in forest.split("<svg")[1:]]
    assert labels == [["net", "flat", "pid"], ["lqg", "net", "flat"]]
    markdown = to_markdown(Results(content).across_splits("cost"))
    assert [line.split("|")[1].strip(" *") for line in markdown.splitlines()[2:]] == order


def test_every_medium_marks_the_same():
    methods = [outcome("pid", "classical", 100.0), outcome("net", "learned", 100.0, spread=4.0)]
    methods += [outcome("bad", "classical", 400.0), outcome("privileged", "privileged", 1.0)]
    comparison = made(*methods)
    marks, content = comparison.marks["nominal"]["cost"], content_of(comparison)
    assert sorted(marks.values()) == ["best", "tie"] and not {"bad", "privileged"} & {*marks}
    table, shown = to_markdown(Results(content).across_splits("cost")), render(content)
    lines = {line.split("|")[1].strip(" *"): line for line in table.splitlines()[2:]}
    for name in ("pid", "net", "bad"):
        wanted = (marks.get(name) == "best", marks.get(name) == "tie")
        assert ("**" in lines[name], "<ins>" in lines[name]) == wanted
        row = shown.split(f'<th scope="row" data-value="{name}">')[1].split("</tr>")[0]
        assert ("<strong>" in row, "<u>" in row) == wanted


@pytest.mark.parametrize("folder", ["/", "~/", "~me/", "/home/me and you/"])
def test_paths_do_not_reach_the_page(folder: str):
    command = shlex.join(["python", "eval/compare.py", "--out", f"{folder}a b/out", f"--add={folder}a/mine.py:Mine"])
    assert without_paths(command) == "python eval/compare.py --out …/out --add=…/mine.py:Mine"
    assert without_paths("python eval/compare.py --policy runs/ppo/best").endswith(" runs/ppo/best")


def ringing(hertz: float, amplitude: float, lateral: float) -> Recording:
    """A tip that moves as a sine after the move, on top of an offset and a drift."""
    time, zeros = 0.0015 * np.arange(1, 1201), np.zeros((1200, 1, 2))
    motion = 0.003 + 0.001 * time + amplitude * np.sin(2 * np.pi * hertz * time)
    error = np.stack([motion, lateral * np.cos(2 * np.pi * hertz * time)], axis=1)[:, None]
    arm, move = ArmParams().row()[None], np.array([[0.0, 1.0, 0.6, 0.15]])
    states, finished = np.zeros((1200, 1, 4)), np.ones(1, np.bool_)
    return Recording(states, zeros[:, :, 0], error, zeros, np.zeros(1), finished, arm, move)


@given(st.floats(4.0, 20.0), st.floats(0.001, 0.05), st.floats(0.0, 0.05))
def test_the_spectrum_of_a_sine_is_a_peak_of_its_height(hertz: float, amplitude: float, lateral: float):
    frequencies, amplitudes = spectrum(ringing(hertz, amplitude, lateral))
    assert amplitudes.max() == pytest.approx(1000 * np.hypot(amplitude, lateral), rel=0.05)
    assert frequencies[amplitudes.argmax()] == pytest.approx(hertz, abs=0.15)


def test_the_animation_has_the_motion_itself():
    motion = rollout(CONTROLLERS["paper"](), 1, **SPLITS_SHOWN["nominal"].arguments(slice(3, 4)))
    (scene,) = animation([Scene("median", "nominal", 3, {"paper": motion})], {"paper": "#0072B2"})["scenes"]
    frames = np.frombuffer(base64.b64decode(scene["methods"][0]["frames"]), "<f4").reshape(-1, 5)
    assert frames.shape == (1200 // EVERY, 5)
    joint, torsion, radial, lateral, torque = frames[-1]
    expected = [motion.state[-1, 0, 0] / 88, motion.state[-1, 0, 2], motion.torque[-1, 0]]
    assert [joint, torsion, torque] == pytest.approx(expected, rel=1e-6)
    reference = np.frombuffer(base64.b64decode(scene["reference"]), "<f4")
    reach = 2 * scene["link"] * np.cos(joint - torsion) + scene["hand"]
    rest = 2 * scene["link"] * np.cos(reference[-1]) + scene["hand"]
    error = 1000 * (reach * np.cos(torsion) - rest), 1000 * reach * np.sin(torsion)
    assert [radial, lateral] == pytest.approx(error, abs=1e-3)


SPLITS_SHOWN = {name: development_set().splits[name].shortened(2) for name in ("nominal", "sensing", "structural")}


def measured(name: str, split: Split) -> MethodOutcome:
    (method,) = [known for known in classical_methods() if known.name == name]
    return outcome_of(method, split.name, measure(Part(method, split, 8)), (40.0, 2000.0))


def test_scenes_are_of_chosen_scenarios_and_what_was_measured():
    paper, zvd = (measured(name, SPLITS_SHOWN["nominal"]) for name in ("paper", "zvd"))
    scenes, traces, failures = record_scenes(made(paper, zvd), SPLITS_SHOWN, 1)
    costs = zvd.metrics["cost"][0].copy()
    assert (scenes[1].title, scenes[1].scenario) == ("the worst run of zvd on all splits", costs.argmax())
    assert not failures and [scene.split for scene in traces] == ["nominal"]
    for scene in [*scenes, *traces]:
        assert set(scene.motions) == {"paper", "zvd"}
        assert scene.motions["zvd"].cost[0] == costs[scene.scenario]
    zvd.metrics["cost"][0, :] *= 1 + 1e-12
    scenes, _, failures = record_scenes(made(paper, zvd), SPLITS_SHOWN, 1)
    assert all(set(scene.motions) == {"paper"} for scene in scenes)
    assert {failure.method for failure in failures} == {"zvd"}
    assert re.search(r"it cost \d+.*, and costs \d+.* when run again", failures[0].message)


def test_motions_are_those_of_each_episode_by_itself():
    outcomes = [measured(name, split) for name in ("paper", "adrc") for split in SPLITS_SHOWN.values()]
    chosen = [Scene("", name, k) for name, k in product(SPLITS_SHOWN, (1, 6))]
    scenes, failures = record(chosen, made(*outcomes), SPLITS_SHOWN, ["adrc", "paper"], 1)
    assert not failures and all(list(scene.motions) == ["paper", "adrc"] for scene in scenes)
    for scene, name in product(scenes, ("paper", "adrc")):
        alone = rollout(CONTROLLERS[name](), 1, **SPLITS_SHOWN[scene.split].arguments(np.array([scene.scenario])))
        alone = alone.of_move(loaded(alone.num_moves))
        for field in fields(Recording):
            assert np.array_equal(getattr(scene.motions[name], field.name), getattr(alone, field.name)), field.name


class Trembles(PaperController):
    """Its torques depend on how many arms there are, in the last digit; it does not drive seven."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        if len(observation) == 7:
            raise ValueError("not seven")
        action, state = super().predict(observation, state, episode_start, deterministic)
        return action * np.float32(1 + 1e-6 * (len(observation) > 7)), state


@pytest.mark.parametrize("count", [4, 7])
def test_an_episode_is_drawn_as_it_was_measured_in_its_batch(count: int, monkeypatch: pytest.MonkeyPatch):
    """Eight arms were measured together. Alone, or with fewer, they move otherwise, or the controller fails."""
    monkeypatch.setitem(CONTROLLERS, "paper", Trembles)
    outcome, chosen = measured("paper", SPLITS_SHOWN["nominal"]), [Scene("", "nominal", k) for k in range(count)]
    scenes, failures = record(chosen, made(outcome), SPLITS_SHOWN, ["paper"], 1)
    assert not failures
    assert [scene.motions["paper"].cost[0] for scene in scenes] == list(outcome.metrics["cost"][0, :count])
    assert rollout(Trembles(), 1, **SPLITS_SHOWN["nominal"].arguments(slice(1))).cost != outcome.metrics["cost"][0, 0]
