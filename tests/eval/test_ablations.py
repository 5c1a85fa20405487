"""Ablations of the training, and what its loop spends its time on."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
from commands import mistake
from matplotlib.axes import Axes

from agents.learners.registry import ALGORITHMS
from baselines import PaperController
from baselines.engines.parallel import StopRequest
from baselines.tools.options import parse
from beltarm_env import EPISODE_STEPS
from eval.ablations import main
from eval.learning import ablation_runs
from eval.learning.ablation_report import COLUMNS, AblationStudy, VariantResult, as_json, draw, markdown
from eval.learning.ablation_runs import AblationRun, score
from eval.learning.ablations import AblationConfig, run_all
from eval.learning.variants import DEFAULT, FACTORS, VARIANTS, Variant

ROOT = Path(__file__).resolve().parents[2]
QUICK = ("--quick", "--only", "default", "--seeds", "1", "--arms", "4")


def ablations(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOT / "eval/ablations.py"), *arguments]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=300, check=False)


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("ablations")
    result = ablations(*QUICK, "--out", "out", cwd=folder)
    assert result.returncode == 0, result.stderr
    return folder


# What is varied


def test_names_factors_and_folders_are_unique_and_known():
    names = [variant.name for variant in VARIANTS]
    assert len({*names, *FACTORS}) == len(names) + len(FACTORS)
    assert set(FACTORS) == {variant.factor for variant in VARIANTS[1:]}
    assert VARIANTS[0] is DEFAULT and not DEFAULT.options


@pytest.mark.parametrize("variant", VARIANTS, ids=lambda variant: variant.name)
def test_a_variant_is_the_default_with_one_thing_changed(variant: Variant):
    """Its options are the script's own, allowed, and none of them is what the default has anyway."""
    kind = ALGORITHMS[variant.script].config
    config, default = parse(kind, arguments=list(variant.options)), parse(kind, arguments=[])
    config.check()
    changed = {f.name for f in fields(config) if getattr(config, f.name) != getattr(default, f.name)}
    assert len(changed) == len([word for word in variant.options if word.startswith("--")])
    assert len(changed) <= (2 if variant.factor == "base" else 1)
    assert variant.script == "student" or variant.factor in ("learner", "sight")


def test_of_some_variants_one_seed_is_enough():
    seeds: dict[str, list[int]] = {variant.name: [] for variant in VARIANTS}
    for run in AblationConfig(seeds=3).planned():
        seeds[run.variant.name].append(run.seed)
    assert seeds == {variant.name: [0] if variant.once else [0, 1, 2] for variant in VARIANTS}


@pytest.mark.parametrize("name", ["default", "rma", "ppo", "ppo-nothing", "sac", "gru-0"])
def test_every_variant_simulates_as_many_samples(name: str, tmp_path: Path):
    run = AblationRun(next(v for v in VARIANTS if v.name == name), 0, 2_000_000, tmp_path)
    script, *options = run.words
    config = parse(ALGORITHMS[Path(script).stem].config, arguments=options)
    assert config.length * config.hold == pytest.approx(2_000_000, rel=0.01)


def test_scores_are_the_same_again():
    scores = score(PaperController(), 4)
    assert scores == score(PaperController(), 4) and scores["left_percent"] == 0
    assert set(COLUMNS) <= set(scores)


def test_the_command_is_one_that_a_reader_can_type(tmp_path: Path):
    variant = next(v for v in VARIANTS if v.name == "gru-0")
    command = AblationRun(variant, 1, 96_000, tmp_path).command
    assert command == "python train/student.py --arms 10 --rounds 8 --gru-width 0 --seed 1"


# Running


@pytest.mark.slow
def test_what_a_study_leaves(done: Path):
    content = json.loads((done / "out/ablations.json").read_text())
    assert [variant["name"] for variant in content["variants"]] == ["default"]
    (run,) = content["variants"][0]["runs"]
    assert run["command"].startswith("python train/student.py --arms 2 --rounds 2 ") and run["base"] == "adaptive"
    assert run["curve"][0][0] == 0 and run["curve"][-1][0] == 2 * 2 * EPISODE_STEPS
    assert (done / "out/curves.png").read_bytes().startswith(b"\x89PNG")
    assert content["provenance"]["scored_on"] == {"arms": 4, "first_seed": 4_300_000, "randomization": "train"}
    assert set(content["references"]) == {"adaptive"}
    assert not list((done / "out").glob(".*"))


@pytest.mark.slow
def test_finished_runs_are_not_repeated(done: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(ablation_runs, "train", None)
    config = AblationConfig(runs=done / "runs/ablations", only=("default",), quick=True, seeds=1, arms=4)
    lines = list[str]()
    results = run_all(config, lines.append)
    assert lines == ["1 run, 1 finished before"]
    stored = json.loads((done / "out/ablations.json").read_text())["variants"]
    assert [result.runs for result in results] == [variant["runs"] for variant in stored]


@pytest.mark.slow
def test_an_interrupted_run_goes_on(done: Path, tmp_path: Path):
    """Without its record a run counts as interrupted: it goes on from its checkpoint, to the same result."""
    runs = tmp_path / "runs"
    shutil.copytree(done / "runs/ablations", runs)
    run = AblationRun(DEFAULT, 0, 5_000, runs, quick=True)
    before = run.finished(4)
    assert before is not None
    (run.folder / "ablation.json").unlink()
    after = run.finish(4)
    assert after["scores"] == before["scores"]
    assert [point[0] for point in after["curve"]] == [point[0] for point in before["curve"]]


def test_a_study_that_is_asked_to_stop_says_how_to_go_on(tmp_path: Path):
    config, stop = AblationConfig(runs=tmp_path, only=("default",), quick=True, arms=4), StopRequest()
    stop.made = True
    with pytest.raises(KeyboardInterrupt, match="saved, and the same command continues"):
        run_all(config, lambda _: None, stop)


@pytest.mark.slow
def test_a_folder_with_another_run_is_refused(done: Path):
    run = AblationRun(DEFAULT, 0, 10_000, done / "runs/ablations", quick=True)
    with pytest.raises(ValueError, match=r"holds `python train/student.py --arms 2 .*choose another --runs"):
        run.finished(4)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--samples", "0"), "--samples must lie within 1 and 1000000000, got 0"),
        (("--jobs", "0"), "--jobs must lie within 1 and 256, got 0"),
        (("--only", "gru-O"), "nothing to vary is called 'gru-O'; did you mean 'gru-0'?"),
        (("--out", "/dev/null/x"), "cannot write to /dev/null/x"),
    ],
)
def test_bad_options(arguments: tuple[str, ...], message: str, tmp_path: Path):
    line = mistake(main, arguments, tmp_path)
    assert line.startswith("eval/ablations.py: ") and message in line


def test_a_training_that_fails_is_named(tmp_path: Path):
    variant = Variant("bad", "limit", "bad", ("--residual-limit", "3"))
    with pytest.raises(ValueError, match=r"bad, seed 0: .*got 3.0"):
        AblationRun(variant, 0, 5_000, tmp_path, quick=True).finish(4)


# What is reported


def made_up(seeds: int = 2) -> AblationStudy:
    def run(cost: float, seed: int) -> dict[str, Any]:
        curve = [[0, 0.0, 2000.0], [500, 0.5, 2 * cost], [1000, 1.0, cost]]
        scores = {name: cost + 10 * seed for name in COLUMNS}
        own = {"seed": seed, "command": f"python train/student.py --rounds 8 --seed {seed}", "minutes": 1.0}
        return {**own, "base": "paper", "scores": scores, "curve": curve, "validation_of_base": 2000.0}

    costs = dict(zip(VARIANTS, np.linspace(300, 900, len(VARIANTS)), strict=True))
    results = [VariantResult(variant, [run(cost, seed) for seed in range(seeds)]) for variant, cost in costs.items()]
    return AblationStudy(results, {"paper": dict.fromkeys(COLUMNS, 2000.0)}, 1000, 8, 210.0)


def test_the_page():
    study = made_up()
    page = markdown(study, 5.0)
    assert all(f"## {factor.question}" in page for factor in FACTORS.values())
    against = [factor.against for factor in FACTORS.values()]
    assert page.count("(default) | – | 305 [300, 310] |") == against.count("default")
    ppo = next(result for result in study.results if result.variant.name == "ppo").score("cost_mean")
    compared = [
        line for line in page.splitlines() if line.startswith("| belief of the filter (default) | `train/ppo.py`")
    ]
    assert len(compared) == 1 and f"| {ppo.mean():.0f} [" in compared[0] and "| 1.00 |" in compared[0]
    place = next(k for k, variant in enumerate(VARIANTS) if variant.name == "nothing")
    cost = study.results[place].score("cost_mean")
    ratio = cost.mean() / 305
    assert f"| nothing | `--knowledge none` | {cost.mean():.0f} [{cost[0]:.0f}, {cost[1]:.0f}] |" in page
    assert f"| {ratio:.2f} | 1.0 |" in page
    assert "`train/sac.py`" in page and "`python train/student.py --rounds 8`" in page
    assert json.loads(as_json(study))["variants"][1]["runs"][1]["seed"] == 1


def test_the_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A panel per factor on common axes: the default and the variants, over the levels of base and best classical."""
    monkeypatch.setattr(plt, "close", lambda _: None)
    study = made_up()
    draw(study, tmp_path / "curves.png")
    figure = plt.gcf()
    panels = [axis for axis in figure.axes if isinstance(axis, Axes) and axis.get_visible()]
    assert [panel.get_title("left") for panel in panels] == [factor.question for factor in FACTORS.values()]
    assert len({(panel.get_xlim(), panel.get_ylim()) for panel in panels}) == 1
    for panel, results in zip(panels, study.factors().values(), strict=True):
        legend = panel.get_legend()
        assert legend is not None and len(legend.get_texts()) == len(results)
        assert not legend.get_window_extent().overlaps(panel.get_window_extent()), "names are beside the curves"
        levels = [float(np.asarray(line.get_ydata())[0]) for line in panel.lines if len(line.get_xdata()) == 2]  # pyright: ignore[reportArgumentType]
        assert levels == [2000.0, 210.0]
    monkeypatch.undo()
    plt.close(figure)
