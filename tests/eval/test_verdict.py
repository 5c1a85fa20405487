"""The verdict of a comparison: what the sentences say, and that they say it of the numbers."""

from __future__ import annotations

import io
import re

import numpy as np
import pytest
from outcomes import ORIGIN, made, outcome, outcome_of
from rich.console import Console

import eval.report.verdict
from beltarm_env.metrics import NOT_ARRIVED, OF_ARRIVED, SHOWN
from eval.comparison.failures import Failure
from eval.comparison.methods import Method
from eval.comparison.pairs import LEFT
from eval.comparison.results import PAIRED_METRICS, Comparison, MethodOutcome, make_comparison
from eval.comparison.schema import check, to_json
from eval.comparison.sets import SetLabel
from eval.comparison.statistics import Estimate, Paired
from eval.report.markdown import paired_table, primary_table, tail_table
from eval.report.readme import answer, tables, updated
from eval.report.tables import main_table, metric_tables
from eval.report.terminal import print_results
from eval.report.verdict import Duel, duels


def verdict(comparison: Comparison) -> tuple[str, ...]:
    return eval.report.verdict.verdict(comparison).sentences


def over(costs: dict[str, tuple[float, float]]) -> Comparison:
    """Comparison of a classical and a learned method on some splits, by their costs."""
    found: list[MethodOutcome] = []
    for split, (classical, learned) in costs.items():
        found += [outcome("pid", "classical", classical, split), outcome("net", "learned", learned, split)]
    return made(*found)


def test_a_learned_method_that_is_better_and_worse():
    first, second, third, fourth = verdict(over({"nominal": (100.0, 60.0), "payload": (100.0, 250.0)}))
    assert first == (
        "On nominal, scenario by scenario, the best learned method, net, costs 40% less than the best classical "
        "controller, pid (averages: 60 against 100; mean of all runs 60 against 100)."
    )
    assert second == "On 1 of 2 splits (nominal) net costs less. On 1 of 2 splits (payload) net costs more."
    assert third == (
        "After the move the arm's end still swings by 60.00 mm with net and 100.00 mm with pid: better, as on 1 of 2 "
        "splits, worse on payload."
    )
    assert fourth.startswith("Over the whole episode its error is 60.00 mm with net")
    assert verdict(over({"nominal": (100.0, 60.0), "payload": (100.0, 50.0)}))[2].endswith("as on all 2 splits.")


def test_costs_of_several_times_as_much():
    first, *_ = verdict(over({"nominal": (100.0, 350.0)}))
    assert "costs 3.5 times as much as the best classical controller, pid" in first


def test_the_protocol_says_who_is_compared():
    """Whoever is best on these scenarios: choosing on them would favour whom it chooses."""
    classical = outcome("adaptive", "classical", 100.0), outcome("lucky", "classical", 90.0)
    found = made(*classical, outcome("student", "learned", 80.0), outcome("net", "learned", 50.0))
    duel = duels(found)["nominal"]
    assert (duel.challenger.method.name, duel.classical.method.name) == ("student", "adaptive")
    first, *_, last = verdict(found)
    assert "the learned method, student, costs 20% less than the classical controller, adaptive (averages: 80" in first
    assert last == (
        "On nominal, scenario by scenario, net costs 44% less than lucky (averages: 50 against 90; mean of all runs 50 "
        "against 90)."
    )


def test_an_added_controller_has_a_sentence_of_its_own():
    known = outcome("pid", "classical", 100.0), outcome("net", "learned", 60.0)
    last = verdict(made(*known, outcome("Mine", "added", 200.0)))[-1]
    assert last.startswith("On nominal, scenario by scenario, Mine costs 2.0 times as much as pid")


def test_the_duels_are_in_the_results_and_in_the_summary():
    found = eval.report.verdict.verdict(over({"nominal": (100.0, 60.0), "payload": (100.0, 250.0)}))
    rows = {(row["metric"], row["split"]): row for row in found.rows()}
    assert {metric for metric, _ in rows} == set(PAIRED_METRICS) and len(rows) == 6
    row = rows["cost", "nominal"]
    assert (row["challenger"], row["classical"], row["result"]) == ("net", "pid", "better")
    assert row["iqm"] == pytest.approx(-40) and row["relative"] == pytest.approx(-0.4) and row["mean_high"] < 0
    lines = primary_table(found).splitlines()[2:]
    assert len(lines) == 6 and lines[0].startswith("| cost | nominal | **better** | -40") and "-40 %" in lines[0]
    assert "**worse**" in lines[1]


def test_the_main_split_decides_who_is_compared():
    """On every split the same two methods, though others are better there."""
    costs = {"randomized": {"pid": 100.0, "lqg": 90.0, "net": 80.0}, "nominal": {"pid": 50.0, "lqg": 90.0, "net": 70.0}}
    found = made(
        *(
            outcome(name, "learned" if name == "net" else "classical", cost, split)
            for split, of_split in costs.items()
            for name, cost in of_split.items()
        )
    )
    assert {duel.classical.method.name for duel in duels(found).values()} == {"lqg"}
    assert verdict(found)[1] == "On all 2 splits net costs less."


def test_a_difference_below_three_percent_is_a_practical_tie():
    first, *_ = verdict(over({"nominal": (100.0, 98.0)}))
    assert first.endswith("against 100): a practical tie.")


def test_a_tie_is_called_one():
    close = made(outcome("pid", "classical", 100.0), outcome("net", "learned", 100.0, spread=5.0))
    first, second, _ = verdict(close)
    assert first.startswith("On nominal, no difference in cost is shown between the best learned method, net, and the")
    assert second.endswith(": no difference shown.")


def test_better_takes_the_mean_too():
    """A method that is better on most arms, and loses far more on a few, is not called better."""
    costs = np.full(24, 90.0)
    costs[:3] = 1500.0
    few_lost = made(outcome("pid", "classical", 100.0), outcome("net", "learned", costs))
    duel = duels(few_lost)["nominal"]
    assert duel.middle.better and duel.mean.iqm > 0 and duel.result == "open"
    assert "no difference in cost is shown" in verdict(few_lost)[0]


@pytest.mark.parametrize(
    ("middle", "p", "low", "high", "result"),
    [
        (-1.0, 0.04, -2.0, -1e-9, "better"),
        (-1.0, 0.04, -2.0, 0.0, "open"),
        (-1.0, 0.06, -2.0, -1.0, "open"),
        (-1.0, 0.04, 1.0, 2.0, "open"),
        (1.0, 0.04, 1e-9, 2.0, "worse"),
        (1.0, 0.04, 0.0, 2.0, "open"),
        (1.0, 0.06, 1.0, 2.0, "open"),
        (1.0, 0.04, -2.0, -1.0, "open"),
    ],
)
def test_both_averages_decide(middle: float, p: float, low: float, high: float, result: str):
    nothing = Estimate(0.0, 0.0, 0.0)
    compared = Paired(Estimate(middle, middle, middle), nothing, p, p_holm=p)
    net, pid = outcome("net", "learned", 60.0), outcome("pid", "classical", 100.0)
    duel = Duel(net, pid, "cost", compared, Estimate(0.5 * (low + high), low, high))
    assert duel.result == result
    assert duel.relative == pytest.approx(middle / 100)


def test_the_correction_is_for_all_splits():
    rng = np.random.default_rng(3)
    splits = ("nominal", *(f"split {k}" for k in range(11)))
    found = []
    for split in splits:
        found.append(outcome("pid", "classical", 100.0, split))
        found.append(outcome("net", "learned", 100.0 * (1 + 0.05 * rng.standard_normal(24)), split))
    fought = duels(made(*found))
    smallest = min(duel.middle.p for duel in fought.values())
    assert min(duel.middle.p_holm for duel in fought.values()) == min(1.0, smallest * len(splits))


def test_the_best_of_several_learned_methods_stands_for_them():
    rivals = [outcome(name, "learned", cost) for name, cost in {"weak": 300.0, "good": 80.0}.items()]
    comparison = made(outcome("pid", "classical", 100.0), *rivals)
    assert [rival.method.name for rival in comparison.challengers("nominal")] == ["good", "weak"]
    assert "the best learned method, good, costs 20% less" in verdict(comparison)[0]


def test_without_a_learned_method_or_a_classical_one():
    first, second = verdict(made(outcome("pid", "classical", 100.0), outcome("lqg", "classical", 80.0)))
    assert first == "Learned against classical is not decided here: no learned method took part."
    assert "nominal: lqg (80)" in second
    assert "No classical controller took part" in verdict(made(outcome("net", "learned", 60.0)))[0]
    failed = made(outcome("pid", "classical", 100.0), failures=[Failure("net", "nominal", "it broke")])
    assert "a learned method could not be run" in verdict(failed)[0]
    failed = made(outcome("pid", "classical", 100.0), failures=[Failure("rigid", "nominal", "it broke")])
    assert "no learned method took part" in verdict(failed)[0]


def test_an_added_controller_stands_in_where_nothing_was_learned():
    found = verdict(made(outcome("pid", "classical", 100.0), outcome("Mine", "added", 60.0)))
    assert "the best added controller, Mine, costs 40% less" in found[0]


# On the terminal


def printed(comparison: Comparison, *, verbose: bool = False) -> list[str]:
    console = Console(width=80, record=True, file=io.StringIO())
    print_results(comparison, verdict(comparison), console, verbose=verbose)
    return console.export_text().splitlines()


def many() -> Comparison:
    names = ("paper", "rigid", "zvd", "smooth", "flat", "adrc", "lqg", "robust", "preview", "mpc", "adaptive")
    splits = ("nominal", "ideal", "randomized", "payload", "stiffness", "friction", "drive", "sensing", "structural")
    found = []
    for split in splits:
        found += [outcome(name, "classical", 1000.0 - 70 * k, split) for k, name in enumerate(names)]
        found += [outcome("ppo", "learned", 330.0, split, 5), outcome("student", "learned", 260.0, split, 5)]
        found += [outcome("privileged", "privileged", 150.0, split)]
    return made(*found)


@pytest.mark.slow
def test_the_terminal_shows_the_main_split_best_first_and_the_verdict():
    lines = printed(many())
    assert len(lines) <= 40 and max(map(len, lines)) <= 80
    assert lines[0].startswith("randomized: arms and drives from the training ranges; 24 scenarios")
    methods = [line.split()[0] for line in lines[5:19]]
    assert methods[:3] == ["student", "adaptive", "ppo"] and methods[-1] == "privileged"
    assert [line for line in lines if "lowest cost" in line] == [lines[5]]
    text = " ".join(" ".join(lines).split())
    assert all(" ".join(sentence.split()) in text for sentence in verdict(many()))
    assert "24 of 500 scenarios show less than all." in text
    assert "payload" not in lines[0] and len(printed(many(), verbose=True)) > 100


def test_a_long_name_is_cut_and_no_number():
    names = ("paper", "a-controller-with-a-long-name")
    lines = printed(made(*(outcome(name, "classical", 1234.0, spread=400.0) for name in names)))
    assert max(map(len, lines)) <= 80
    rows = [line for line in lines if line.startswith((" paper", " a-cont"))]
    assert [len(re.findall(r"\d+\.?\d*", row)) for row in rows] == [6, 6]  # the worst 5 % of so few is not told


# In the summary


def test_the_summary_has_mean_and_tail():
    costs = np.full(40, 90.0)
    costs[:3] = 1500.0
    left = outcome("net", "learned", costs)
    left.metrics[LEFT][0, 5] = 1.0
    others = outcome("pid", "classical", np.full(40, 100.0)), outcome("privileged", "privileged", np.full(40, 10.0))
    table = tail_table(made(others[0], left, others[1]))
    values = np.sort(left.metrics["cost"].ravel())
    assert table.splitlines()[2:] == [
        "| pid | 100 / 110 |",
        f"| net | {values.mean():.0f} / {values[-2:].mean():.0f}; 1 left |",
        "| *privileged* | *10 / 11* |",
    ]


def test_the_worst_of_few_scenarios_is_not_shown():
    """The worst 5 % of 39 scenarios would be one or two runs of each seed."""
    few = made(outcome("pid", "classical", np.full(39, 100.0)), outcome("net", "learned", np.full(39, 90.0), seeds=5))
    assert [line.split(" / ")[1] for line in tail_table(few).splitlines()[2:]] == ["– |", "– |"]
    cells = {line.method: line.cells for line in main_table(few).lines}
    column = main_table(few).columns.index("worst 5 %")
    assert [of_method[column].text for of_method in cells.values()] == ["–", "–"]


# Arms that do not arrive


def still(away: float, seeds: int = 1) -> MethodOutcome:
    """A controller that does nothing: no vibration, no torque, and a share of its scenarios never reached."""
    lazy = outcome("Zero", "added", 5000.0, seeds=seeds)
    for name in {*OF_ARRIVED} & {*SHOWN}:
        lazy.metrics[name][:] = 0.0
    lazy.metrics[NOT_ARRIVED][-1, : round(away * 24)] = 1.0
    return outcome_of(Method("Zero", "added", ("zero.py:Zero",) * seeds, ""), "nominal", lazy.metrics, (1.0, 1.0))


def test_doing_nothing_is_not_better_at_anything():
    pid = outcome("pid", "classical", 100.0)
    found = made(pid, still(1.0), outcome("lqg", "classical", 120.0))
    said = eval.report.verdict.verdict(found)
    assert "better" not in " ".join(said.sentences) and "Zero does not arrive in 24 of 24 runs" in said.sentences[-1]
    assert {row["metric"] for row in said.rows()} == {"cost", "tip_rms_mm"}
    assert found.marks["nominal"]["residual_pp_mm"]["pid"] == "best"
    assert all("Zero" not in marks or name != "residual_pp_mm" for name, marks in found.marks["nominal"].items())
    content = to_json(found, said.sentences, said.rows())
    check(content, "results.json")
    (row,) = [row for row in content["rows"] if row["method"] == "Zero"]
    assert row["metrics"][NOT_ARRIVED]["iqm"] == 1 and not {*OF_ARRIVED} & {*row["metrics"]}
    (pair,) = [pair for pair in content["paired"] if pair["method"] == "Zero"]
    assert {*pair["metrics"]} == {"cost", "tip_rms_mm"}
    (profile,) = [one for one in content["profiles"] if one["metric"] == "residual_pp_mm"]
    assert profile["methods"]["Zero"][-1] == 0 and profile["methods"]["pid"][-1] == 1
    shown = next(table for table in metric_tables(found) if "residual" in table.title)
    assert {line.method: line.cells[0].value for line in shown.lines}["Zero"] is None
    for text in (paired_table(found, "nominal"), tables(content), "\n".join(printed(found, verbose=True))):
        assert "Zero" in text and "nan" not in text


@pytest.mark.parametrize(("away", "compared"), [(0.1, 22), (0.5, 12)])
def test_vibration_is_compared_where_both_arrive(away: float, compared: int):
    """In the other scenarios Zero has no vibration at all; with fewer than 20 of them nothing is decided."""
    lazy = still(away)
    lazy.metrics["residual_pp_mm"][:] = np.where(lazy.metrics[NOT_ARRIVED] > 0, 0.0, 300.0)
    lazy = outcome_of(lazy.method, "nominal", lazy.metrics, (1.0, 1.0))
    found = made(outcome("pid", "classical", 100.0), lazy)
    assert lazy.estimates["residual_pp_mm"].iqm == 300
    pair = found.against_best["nominal"]["Zero"]["residual_pp_mm"]
    assert pair.scenarios == compared and pair.difference.low > 150
    assert pair.verdict == ("worse" if compared >= 20 else "too few scenarios")
    assert found.marks["nominal"]["residual_pp_mm"] == {"pid": "best"}
    assert ("residual_pp_mm" in {row["metric"] for row in eval.report.verdict.verdict(found).rows()}) == (
        compared >= 20
    )


def test_a_scenario_counts_where_all_training_seeds_arrive():
    two = still(1.0, seeds=2)  # one of its seeds never arrives
    assert np.isnan(two.estimates["residual_pp_mm"].iqm) and two.not_arrived == 0.5


# Too few scenarios


def test_four_scenarios_are_no_verdict():
    costs = np.full(4, 100.0)
    found = made(outcome("pid", "classical", costs), outcome("net", "learned", 0.5 * costs))
    said = eval.report.verdict.verdict(found)
    assert said.rows() == [] and len(said.sentences) == 1 and "--episodes 20" in said.sentences[0]
    pair = found.against_best["nominal"]["net"]["cost"]
    assert (pair.p, pair.p_holm, pair.survives) == (1.0, 1.0, False)
    assert not any(found.marks["nominal"].values())
    check(to_json(found, said.sentences, said.rows()), "results.json")


# Methods that the protocol does not know


def test_only_what_the_protocol_knows_was_frozen_before():
    shipped = outcome("adaptive", "classical", 100.0)
    for name, told in (("test", True), ("development", False), ("seed 7", False)):
        label = SetLabel(name, "0" * 64)
        known, found = (make_comparison([shipped, *own], [], label, ORIGIN) for own in ([], [still(0.0)]))
        assert known.note == label.note
        assert ("Zero" in found.note and "--scenarios development" in found.note) == told
        assert ("Zero" in answer(to_json(found)).split("\n\n")[-1]) == told


# In the README


@pytest.mark.slow
def test_the_answer_of_the_readme():
    """Two sentences, and five methods best first: the four best, and the controller that all began with."""
    comparison = many()
    said = eval.report.verdict.verdict(comparison)
    text, table, note = answer(to_json(comparison, said.sentences, said.rows())).split("\n\n")
    assert text == (
        "**Scenario by scenario, the learned correction, `student`, has a cost 13% lower than the best classical "
        "controller, `adaptive`.** The vibration after the move falls from 300.00 mm to 260.00 mm. Of 9 kinds of "
        "scenarios the cost is lower on 9."
    )
    assert comparison.scenario_set.note in note
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()]
    assert lines[0] == [
        "method",
        "cost",
        "error of the arm's end, RMS (mm)",
        "vibration after the move, peak to peak (mm)",
    ]
    names = ["student (learned)", "adaptive (classical)", "ppo (learned)", "mpc (classical)", "paper (classical)"]
    assert [line[0] for line in lines[2:]] == names
    assert lines[2][1] == "260"


@pytest.mark.parametrize(
    ("costs", "words"),
    [
        (
            (100.0, 150.0),
            "has a cost 50% higher than the best classical controller, `pid`.** The vibration",
        ),
        ((100.0, 100.0), "**No difference in cost is shown between the learned correction, `net`, and the best"),
    ],
)
def test_the_answer_when_learning_loses(costs: tuple[float, float], words: str):
    found = over({"nominal": costs})
    said = eval.report.verdict.verdict(found)
    assert words in answer(to_json(found, said.sentences, said.rows()))


def test_the_tables_of_the_readme_are_sorted_by_the_main_split():
    first, second = [part for part in tables(to_json(many())).split("\n\n") if part.startswith("|")]
    for table in (first, second):
        methods = [line.split("|")[1].strip() for line in table.splitlines()[2:]]
        assert methods[:3] == ["student (5 seeds)", "adaptive", "ppo (5 seeds)"] and methods[-1] == "*privileged*"
        assert "[" not in table
    assert first.splitlines()[0].split(" | ")[1:4] == ["nominal", "ideal", "randomized"]


def test_parts_are_written_between_their_markers():
    page = "a\n<!-- x: begin -->\nold\n<!-- x: end -->\nb"
    assert updated(page, {"x": "new"}) == "a\n<!-- x: begin -->\n\nnew\n\n<!-- x: end -->\nb"
    with pytest.raises(ValueError, match=r"README\.md has no <!-- y: begin --> and <!-- y: end -->"):
        updated(page, {"y": "new"})
