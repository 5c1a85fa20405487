"""The verdict of a comparison: what it decides by which numbers, and that all media show it."""

import io
import re
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest
from outcomes import ORIGIN, content_of, made, outcome, outcome_of, pair_of
from rich.console import Console

import eval.report.verdict
from baselines import DOMINATED
from beltarm_env.metrics import NOT_ARRIVED, OF_ARRIVED, SHOWN
from eval.comparison.methods import PRIMARY, Method, project_names
from eval.comparison.results import PAIRED_METRICS, Comparison, MethodOutcome, make_comparison
from eval.comparison.rollouts import Failure
from eval.comparison.schema import check
from eval.comparison.sets import SetLabel
from eval.comparison.statistics import Estimate, Paired, interquartile_mean
from eval.report import summary
from eval.report.publish import print_results
from eval.report.table import Results, to_markdown
from eval.report.verdict import PairwiseTest, pairwise_tests
from eval.studies._frame import text_of


def verdict(comparison: Comparison) -> list[str]:
    return eval.report.verdict.verdict(comparison)[0]


KINDS: Any = dict.fromkeys(("net", "student", "ppo"), "learned") | {"privileged": "privileged", "Mine": "added"}


def test_the_first_sentence_is_of_the_main_split():
    for (classical, learned), words in (
        ((100.0, 60.0), ("40% less", "60 against 100")),
        ((100.0, 350.0), ("3.5 times as much", "350 against 100")),
        ((100.0, 97.3), ("2.7%", "a practical tie")),
        ((100.0, 100.0), ("no difference",)),
    ):
        first = verdict(made(outcome("pid", "classical", classical), outcome("net", "learned", learned)))[0]
        assert all(word in first for word in ("net", "pid", "nominal", *words))


def test_the_protocol_says_who_is_compared():
    costs = {"adaptive": 100.0, "lucky": 90.0, "student": 80.0, "net": 50.0}
    comparison = made(*(outcome(name, KINDS.get(name, "classical"), cost) for name, cost in costs.items()))
    test = pairwise_tests(comparison)["nominal"]
    assert (test.challenger.method.name, test.classical.method.name) == ("student", "adaptive")
    first, *_, last = verdict(comparison)
    assert "20%" in first and all(words in last for words in ("net", "lucky", "44%"))
    ranked = {name: 85.0 + 5 * (name not in PRIMARY) for name in project_names() if name not in DOMINATED}
    usual = [outcome(name, KINDS.get(name, "classical"), cost) for name, cost in ranked.items()]
    first = verdict(made(*usual))[0]
    assert "best" in first and "of this run" not in first


def test_the_main_split_decides_who_is_compared():
    costs = {"randomized": {"pid": 100.0, "lqg": 90.0, "net": 80.0}, "nominal": {"pid": 50.0, "lqg": 60.0, "net": 70.0}}
    methods = [(name, cost, split) for split, of_split in costs.items() for name, cost in of_split.items()]
    comparison = made(*(outcome(name, KINDS.get(name, "classical"), cost, split) for name, cost, split in methods))
    rows = {(row["metric"], row["split"]): row for row in content_of(comparison)["primary"]}
    assert rows.keys() == {*product(PAIRED_METRICS, costs)}
    assert {(row["challenger"], row["classical"]) for row in rows.values()} == {("net", "lqg")}
    assert (rows["cost", "randomized"]["result"], rows["cost", "nominal"]["result"]) == ("better", "worse")
    assert rows["cost", "randomized"]["iqm"] == pytest.approx(-10) and rows["cost", "randomized"]["mean_high"] < 0


def test_a_learned_method_is_compared_with_its_base_too():
    net = outcome("net", "learned", 70.0)
    net = outcome_of(replace(net.method, base="pid"), "nominal", net.metrics, (1.0, 1.0))
    found = content_of(made(outcome("pid", "classical", 100.0), outcome("lqg", "classical", 90.0), net))["paired"]
    pairs = {(pair["against"], pair["other"]) for pair in found if pair["method"] == "net"}
    assert pairs == {("best classical", "lqg"), ("base", "pid")}


def test_both_averages_decide():
    for middle, p, low, high, result, alone in (
        (-1.0, 0.04, -2.0, -1e-9, "better", ""),
        (-1.0, 0.04, -2.0, 0.0, "open", "the interquartile mean is lower"),
        (-1.0, 0.06, -2.0, -1.0, "open", "the mean is lower"),
        (-1.0, 0.06, -2.0, 0.0, "open", ""),
        (1.0, 0.04, 1e-9, 2.0, "worse", ""),
        (1.0, 0.04, -2.0, -1.0, "open", "the interquartile mean is higher and the mean is lower"),
    ):
        compared = Paired(Estimate(middle, middle, middle), Estimate(0.0, 0.0, 0.0), p, p_holm=p)
        net, pid = outcome("net", "learned", 60.0), outcome("pid", "classical", 100.0)
        test = PairwiseTest(net, pid, "cost", compared, Estimate(0.5 * (low + high), low, high), (60.0, 100.0))
        assert (test.result, test.alone) == (result, alone) and test.relative == pytest.approx(middle / 100)


def test_the_correction_is_for_all_splits():
    costs = 100 + 5 * np.random.default_rng(3).standard_normal((12, 24))
    learned = [outcome("net", "learned", row, f"split {k}") for k, row in enumerate(costs)]
    tests = pairwise_tests(made(*learned, *(outcome("pid", "classical", 100.0, f"split {k}") for k in range(12))))
    smallest = min(test.middle.p for test in tests.values())
    assert min(test.middle.p_holm for test in tests.values()) == min(1.0, 12 * smallest)


def test_methods_of_a_users_own_are_corrected_for_all_methods():
    costs = 100 + 5 * np.random.default_rng(5).standard_normal((12, 24))
    own = [outcome(f"mine{k}", "added", row) for k, row in enumerate(costs)]
    comparison = made(outcome("pid", "classical", 100.0), outcome("net", "learned", 60.0), *own)
    assert min(pair_of(comparison, each.name)["cost"].p for each in own) < 0.05
    said = [sentence for sentence in verdict(comparison) if "mine" in sentence]
    assert len(said) == 12 and all("no difference" in sentence for sentence in said)
    best = pairwise_tests(made(outcome("pid", "classical", 100.0), *own))["nominal"].middle  # chosen on these scenarios
    assert best.p_holm == min(1.0, 12 * best.p)


@pytest.mark.parametrize(("tied", "shifted", "ties"), [(98.0, 60.0, 1), (102.0, 150.0, 1), (98.0, 98.0, 2)])
def test_a_small_difference_is_a_practical_tie_on_every_split(tied: float, shifted: float, ties: int):
    costs = {"nominal": tied, "shift": shifted}
    learned = [outcome("net", "learned", cost, split) for split, cost in costs.items()]
    results = content_of(made(*learned, *(outcome("pid", "classical", 100.0, split) for split in costs)))
    assert {row["result"] for row in results["primary"]} == {"better" if tied < 100 else "worse"}
    assert ("a practical tie" in summary.headline(Results(results))) == (ties == 2)
    _, others, *_ = results["verdict"]
    assert "a practical tie" in others and [part in others for part in ("both", "(nominal)")] == [ties == 2, ties == 1]
    (table,) = re.findall("## The primary comparison.*?##", text_of("comparison", summary, results), re.DOTALL)
    assert table.count("**, a practical tie") == ties


def test_without_a_learned_method_or_a_classical_one():
    for names, failures, words in (
        (("lqg", "pid"), [], "no learned method, lqg (80)"),
        (("net",), [], "No classical controller, --methods"),
        (("pid",), [Failure("net", "nominal", "it broke")], "could not be run, pid (80)"),
        (("Mine", "pid"), [], "added controller, Mine, 20% less, of this run"),
        (("net", "pid"), [Failure("net", "payload", "it broke")], "20% less, not compared on payload"),
    ):
        outcomes = [outcome(name, KINDS.get(name, "classical"), 80.0 + 20 * k) for k, name in enumerate(names)]
        outcomes += [outcome("pid", "classical", 100.0, each.split) for each in failures if each.split != "nominal"]
        said = " ".join(verdict(made(*outcomes, failures=failures)))
        assert all(word in said for word in words.split(", "))


def printed(comparison: Comparison) -> list[str]:
    console = Console(width=80, record=True, file=io.StringIO())
    print_results(content_of(comparison), console)
    return console.export_text().splitlines()


def test_the_terminal_shows_the_main_split_best_first_and_the_verdict():
    outcomes = []
    for split in ("nominal", "randomized", "payload"):
        outcomes += [outcome(name, "classical", 1000.0 - 70 * k, split) for k, name in enumerate(("paper", "adaptive"))]
        outcomes += [outcome("ppo", "learned", 940.0, split, 5), outcome("student", "learned", 260.0, split, 5)]
        outcomes += [outcome("privileged", "privileged", 150.0, split)]
    many = made(*outcomes)
    lines = printed(many)
    assert max(map(len, lines)) <= 80 and lines[0].startswith("randomized: ")
    shown = [line.split()[0] for line in lines if re.match(r" ?\w+ +\d+", line)]
    assert shown[:5] == ["student", "adaptive", "ppo", "paper", "privileged"]
    assert all(" ".join(sentence.split()) in " ".join(" ".join(lines).split()) for sentence in verdict(many))
    long = printed(made(*(outcome(name, "classical", 1234.0, spread=400.0) for name in ("pid", 30 * "long-"))))
    rows = [line for line in long if line.startswith((" pid", " long-"))]
    assert [len(re.findall(r"\d+\.?\d*", row)) for row in rows] == [8, 8] and max(map(len, long)) <= 80


def still(away: float, seeds: int = 1, **others: Any) -> MethodOutcome:
    """A controller that does nothing, and never reaches a share of its scenarios; `others` are metrics that it has."""
    lazy = outcome("Zero", "added", 5000.0, seeds=seeds)
    for name in {*OF_ARRIVED} & {*SHOWN}:
        lazy.metrics[name][:] = 0.0
    lazy.metrics[NOT_ARRIVED][-1, : round(away * 24)] = 1.0
    for name, values in others.items():
        lazy.metrics[name][:] = values
    return outcome_of(Method("Zero", "added", ("zero.py:Zero",) * seeds, ""), "nominal", lazy.metrics, (1.0, 1.0))


def test_doing_nothing_is_not_better_at_anything():
    comparison = made(outcome("pid", "classical", 100.0), still(1.0), outcome("lqg", "classical", 120.0))
    sentences, rows = eval.report.verdict.verdict(comparison)
    assert "better" not in " ".join(sentences) and "Zero does not arrive in 100 % of its moves" in sentences[-1]
    assert {row["metric"] for row in rows} == {"cost", "still_s", "tip_rms_mm"}
    marks = comparison.marks["nominal"]
    assert marks["residual_pp_mm"]["pid"] == "best" and "Zero" not in marks["residual_pp_mm"]
    results = content_of(comparison)
    check(results, "results.json")
    (row,) = [row for row in results["rows"] if row["method"] == "Zero"]
    assert row["metrics"][NOT_ARRIVED]["iqm"] == 1 and not {*OF_ARRIVED} & {*row["metrics"]}
    (pair,) = [pair for pair in results["paired"] if pair["method"] == "Zero"]
    assert {*pair["metrics"]} == {"cost", "still_s", "tip_rms_mm"}
    shown = Results(results).across_splits("residual_pp_mm")
    assert {row.method: row.cells[0].value for row in shown.rows}["Zero"] is None
    for text in (text_of("comparison", summary, results), to_markdown(shown), "\n".join(printed(comparison))):
        assert "Zero" in text and "nan" not in text


@pytest.mark.parametrize(("away", "compared"), [(0.1, 22), (0.5, 12)])
def test_vibration_is_compared_where_both_arrive(away: float, compared: int):
    vibration = np.where(np.arange(24) < 24 - compared, 0.0, 300.0)
    lazy = still(away, residual_pp_mm=vibration, tip_rms_mm=1.0)  # as of arms that leave at once
    comparison = made(outcome("pid", "classical", 100.0), lazy)
    assert lazy.estimates["residual_pp_mm"].iqm == 300
    pair = pair_of(comparison, "Zero")["residual_pp_mm"]
    assert pair.scenarios == compared and pair.difference.low > 150
    assert pair.verdict == ("worse" if compared >= 20 else "too few scenarios")
    assert [comparison.marks["nominal"][name] for name in ("residual_pp_mm", "tip_rms_mm")] == [{"pid": "best"}] * 2
    metrics = {row["metric"] for row in content_of(comparison)["primary"]}
    assert ("residual_pp_mm" in metrics) == (compared >= 20)
    reached = f"{interquartile_mean(comparison.outcomes[0].metrics['residual_pp_mm'][:, -compared:]):.2f} mm with pid"
    assert (reached in " ".join(verdict(comparison))) == (compared >= 20)
    two = still(1.0, seeds=2)  # one of its seeds never arrives
    assert np.isnan(two.estimates["residual_pp_mm"].iqm) and two.not_arrived == 0.5
    many = made(still(0.0, 24, **{NOT_ARRIVED: np.eye(24)}), outcome("pid", "classical", 100.0))
    assert many.marks["nominal"]["residual_pp_mm"] == {"pid": "best"}, "nowhere do all seeds arrive"


def test_four_scenarios_are_no_verdict():
    costs = np.full(4, 100.0)
    comparison = made(outcome("pid", "classical", costs), outcome("net", "learned", 0.5 * costs))
    sentences, rows = eval.report.verdict.verdict(comparison)
    assert rows == [] and len(sentences) == 1 and "--episodes 20" in sentences[0]
    pair = pair_of(comparison, "net")["cost"]
    assert (pair.p, pair.p_holm, pair.survives) == (1.0, 1.0, False)
    assert not any(comparison.marks["nominal"].values())
    check(content_of(comparison), "results.json")


@pytest.mark.parametrize(("name", "noted"), [("test", True), ("development", False), ("seed 7", False)])
def test_only_what_the_protocol_knows_was_frozen_before(name: str, noted: bool):
    label, shipped = SetLabel(name, "0" * 64), outcome("adaptive", "classical", 100.0)
    assert Results(content_of(make_comparison([shipped], [], label, ORIGIN))).note == label.note
    note = Results(content_of(make_comparison([shipped, still(0.0)], [], label, ORIGIN))).note
    assert ("Zero" in note and "--scenarios development" in note) == noted
