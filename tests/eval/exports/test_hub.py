"""Policies for the Hugging Face Hub: the folder that is written, its card and scores, and what loading one does."""

import hashlib
import json
import os
import pickle
import re
import runpy
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
from bundles import SPEC, Exploit, new_weights
from commands import ROOT, mistake, stopped

from agents.policy import bundle
from agents.policy.bundle import CARD, POLICIES, POLICY_FILE, read_spec
from beltarm_env.rollout import rollout
from eval import export
from eval.comparison.sets import choose_set
from eval.exports import hub
from eval.exports.hub import CONFIG, FILM, MODEL, PUBLISHED, bibtex
from eval.exports.scores import Scores, markdown, scores_of
from eval.report.table import Results

huggingface_hub = pytest.importorskip("huggingface_hub")

EXAMPLE = ROOT / "docs/examples/from_the_hub.py"
POLICY = POLICIES / "ppo/seed1"
EPISODES, MOVES = 4, 2


def published() -> dict[str, Any]:
    return json.loads(PUBLISHED.read_text(encoding="utf-8"))


def written(path: Path, episodes: int = EPISODES, **changes: Any) -> Path:
    """The published results, as if of few scenarios, so that a policy is soon run on them."""
    content = {**published(), **changes}
    for row in content["rows"]:
        row |= {"episodes": episodes, "moves": min(row["moves"], MOVES)}
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def share(*arguments: str, folder: Path) -> None:
    assert stopped(export.main, ("hub", *arguments), folder) == (0, "")


def refusal(*arguments: str, folder: Path) -> str:
    return mistake(export.main, ("hub", *arguments), folder)


@pytest.fixture
def own(tmp_path: Path) -> Path:
    bundle.save_bundle(tmp_path / "own", SPEC, new_weights())
    return tmp_path / "own"


def test_folder_of_a_policy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    pytest.importorskip("onnx")
    shipped = [read_spec(folder)[1]["sha256"] for folder in sorted(POLICIES.glob("*/*"))]
    few = written(tmp_path / "few.json", provenance={**published()["provenance"], "policies": shipped})
    monkeypatch.setattr(hub, "PUBLISHED", few)
    share(str(POLICY), "--repo-id", "some-lab/arm.1", "--onnx", folder=tmp_path)
    folder = tmp_path / "results/hub/arm.1"
    assert {path.name for path in folder.iterdir()} == {POLICY_FILE, CARD, CONFIG, MODEL, ".gitattributes"}
    assert "hf upload some-lab/arm.1 results/hub/arm.1\n" in capsys.readouterr().out
    assert (folder / POLICY_FILE).read_bytes() == (POLICY / POLICY_FILE).read_bytes()
    scenarios = choose_set("test").splits["shift"].shortened(MOVES).arguments(slice(EPISODES))
    run = rollout(bundle.load_controller(folder), EPISODES, **scenarios)
    reward = -run.cost.reshape(MOVES, EPISODES).sum(axis=0)
    mean_reward = f"{np.mean(reward):.2f} +/- {np.std(reward):.2f}"
    card = huggingface_hub.ModelCard.load(folder / CARD)
    assert (card.data.license, card.data.library_name) == ("mit", "stable-baselines3")
    assert {"deep-reinforcement-learning", "reinforcement-learning", "BeltArm-v0", "ppo"} <= {*card.data.tags}
    first = card.data.eval_results[0]
    assert (first.metric_type, first.metric_value, first.dataset_config) == ("mean_reward", mean_reward, "shift")
    assert all(words in card.text for words in (mean_reward, "| payload_mass | 0.05 | 0.5 |", bibtex()))
    assert "is not shown to cost less" in card.text and "`structural`" in card.text.split("## Scores")[0]
    config = json.loads((folder / CONFIG).read_text())
    assert config["sha256"] == read_spec(POLICY)[1]["sha256"] and config["policy"] == POLICY_FILE


def test_a_policy_of_ones_own(own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    arguments, out = (str(own), "--out", "out", "--license", "cc0-1.0", "--repo-id", "lab/arm"), tmp_path / "out"
    share(*arguments, folder=tmp_path)
    card = huggingface_hub.ModelCard.load(out / CARD)
    assert card.data.license == "cc0-1.0" and card.data.eval_results is None and "## Scores" not in card.text
    with monkeypatch.context() as patched:
        asked = SimpleNamespace(snapshot_download=lambda repo_id, allow_patterns: str(out))
        patched.setitem(sys.modules, "huggingface_hub", asked)
        shown: dict[str, Any] = {}
        exec(card.text.split("```python\n")[1].split("```")[0], shown)
    assert len(shown["run"].cost) == 10
    content = published()
    row = next(row for row in content["rows"] if (row["method"], row["split"]) == ("ppo", "nominal"))
    rows = [{**row, "method": name, "seeds": 1} for name in ("my-ppo+guard", "my-ppo")]
    provenance = {**content["provenance"], "policies": 2 * [read_spec(own)[1]["sha256"]]}
    path = written(tmp_path / "own.json", rows=rows, paired=[], provenance=provenance)
    (out / "left.txt").touch()
    assert "--overwrite" in refusal(*arguments, "--results", str(path), folder=tmp_path)
    share(*arguments, "--results", str(path), "--overwrite", folder=tmp_path)
    card = huggingface_hub.ModelCard.load(out / CARD)
    assert card.data.eval_results[1].metric_value == row["metrics"]["cost"]["iqm"] and "`my-ppo`" in card.text
    assert "no classical controller" in card.text and not (out / "left.txt").exists()


def test_the_card_claims_no_more_than_the_verdict():
    content = published()
    verdict = {row["split"]: row for row in content["primary"] if row["metric"] == "cost"}
    for pair in content["paired"]:
        pair["metrics"]["cost"]["p_holm"] = 0.06 if (pair["method"], pair["split"]) == ("ppo", "friction") else 0.01
    said = {name: markdown(Scores(Results(content), "", name, np.zeros(1))) for name in ("student", "ppo")}
    lost, lost_of_ppo = (text.split("## Scores")[0] for text in said.values())
    for split, row in verdict.items():
        words = row["result"].replace("open", "no difference shown")
        assert re.search(rf"\| {split} \|.*: {words} \|", said["student"])
        assert (f"`{split}`" in lost) == (row["result"] == "open" or abs(row["relative"]) < 0.03)
    costs = {(row["method"], row["split"]): row["metrics"]["cost"]["iqm"] for row in content["rows"]}
    gains = {pair["split"]: pair["metrics"]["cost"]["iqm"] for pair in content["paired"] if pair["method"] == "ppo"}
    tied = abs(gains["shift"]) < 0.03 * costs["adaptive", "shift"]
    assert "`friction`" in lost_of_ppo and ("`shift`" in lost_of_ppo) == tied


def test_the_reward_is_of_no_more_scenarios_than_a_set_has(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("eval.exports.scores.rollout", ran := MagicMock())
    scores_of(POLICY, published()["provenance"]["policies"][0], written(tmp_path / "many.json", 300))
    assert ran.call_args.args[1] == len(ran.call_args.kwargs["seed"]) == 200


def test_other_sensors_and_a_film(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    pytest.importorskip("imageio_ffmpeg")
    monkeypatch.setattr(hub, "_SPEED", 10.0)
    share(str(bundle.ACCELEROMETER_POLICIES / "student/seed0"), "--video", folder=tmp_path)
    folder = tmp_path / "results/hub/student-BeltArm-v0"
    assert (folder / FILM).read_bytes()[4:8] == b"ftyp"
    assert json.loads((folder / CONFIG).read_text())["sensors"] == "accelerometer"


def test_refusals(own: Path, tmp_path: Path):
    provenance = published()["provenance"]
    fewer = written(tmp_path / "fewer.json", provenance={**provenance, "policies": provenance["policies"][:-1]})
    other = written(tmp_path / "other.json", scenario_set={"name": "test", "sha256": "0" * 64})
    few, policy, before = written(tmp_path / "few.json"), str(POLICY), {*tmp_path.iterdir()}
    for words, *arguments in (
        ("nowhere", "nowhere"),
        *(("--repo-id", policy, "--repo-id", name) for name in ("arm", "../arm", "lab/arm--1")),
        ("--license", policy, "--license", "MIT License"),
        ("--out", policy, "--out", str(ROOT / "LICENSE")),
        *(("--out", policy, "--overwrite", "--out", folder) for folder in (str(ROOT / "docs"), policy)),
        ("/dev/null", policy, "--out", "/dev/null/x"),
        *((path, policy, "--out", "out", "--results", path) for path in ("none.json", str(other), str(fewer))),
        (str(few), str(own), "--out", "out", "--results", str(few)),
    ):
        assert words in refusal(*arguments, folder=tmp_path)
        assert {*tmp_path.iterdir()} == before


def test_missing_packages_are_named(own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for package, extra, options in (("onnx", "onnx", ["--onnx"]), ("huggingface_hub.utils", "hub", [])):
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, package, None)
            assert f"[{extra}]" in refusal(str(own), *options, "--out", "out", folder=tmp_path)
        assert not (tmp_path / "out").exists()


def example(*arguments: str, folder: Path) -> tuple[int, str]:
    return stopped(lambda: runpy.run_path(str(EXAMPLE), run_name="__main__"), arguments, folder)


def test_nothing_beside_a_policy_is_run_or_offered(own: Path, capsys: pytest.CaptureFixture[str]):
    """A policy between files that do harm where they are loaded, or read: that never ends, or fails."""
    target = own.parent / "executed"
    for name in ("policy.pkl", "model.zip", "pytorch_model.bin", "weights-0.safetensors"):
        (own / name).write_bytes(pickle.dumps(Exploit(target)))
    for name in ("__init__.py", "torch.py", "sitecustomize.py", "conftest.py", "policy.py", "agents.py"):
        (own / name).write_text(f"open({str(target)!r}, 'w')")
    os.mkfifo(own / "weights-1.safetensors")
    (own / "weights-2.safetensors").symlink_to("/dev/zero")
    (own / "config.json").mkdir()
    assert example(str(own), folder=own) == (0, "")
    assert capsys.readouterr().out.startswith("ppo on paper: cost ")
    share(str(own), "--out", "../out", folder=own)
    offered = {path.name for path in (own.parent / "out").iterdir()}
    assert offered == {POLICY_FILE, CARD, CONFIG, ".gitattributes"} and not target.exists()


def test_the_hub_is_asked_for_the_policy_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    code, errors = example("--repo-id", "lab/arm", folder=tmp_path)
    assert code == 2 and "pip install huggingface_hub" in errors and errors.count("\n") == 1

    def snapshot_download(repo_id: str, allow_patterns: str) -> str:
        """A snapshot as the Hub's cache has it: links to files that are named by their hash."""
        assert repo_id == "lab/arm"
        path, snapshot = POLICY / allow_patterns, tmp_path / "snapshots"
        snapshot.mkdir()
        kept = shutil.copy(path, tmp_path / hashlib.sha256(path.read_bytes()).hexdigest())
        (snapshot / path.name).symlink_to(kept)
        return str(snapshot)

    monkeypatch.setitem(sys.modules, "huggingface_hub", SimpleNamespace(snapshot_download=snapshot_download))
    assert example("--repo-id", "lab/arm", folder=tmp_path) == (0, "")
