"""Policies for the Hugging Face Hub: the folder that is written, its card and scores, and what loading one does."""

from __future__ import annotations

import copy
import hashlib
import json
import os
import pickle
import runpy
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from bundles import SPEC, Exploit, edit, halves, new_weights
from commands import mistake, stopped
from jsonschema import Draft202012Validator

import eval.hub
from agents.policy.bundle import CARD, FELT_POLICIES, MANIFEST, POLICIES, load_controller, read_spec, save_bundle
from beltarm_env.metrics import METRICS
from beltarm_env.rollout import rollout
from eval.comparison.scenarios import choose_set
from eval.hub import PUBLISHED, main
from eval.sharing.citation import bibtex
from eval.sharing.folder import CONFIG, EXCERPT, FILM, MODEL
from eval.sharing.page import SHOWN, losses, markdown, model_index
from eval.sharing.scores import Return, Scores

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "docs/examples/from_the_hub.py"
POLICY = POLICIES / "ppo/seed1"
EPISODES = 4
BUNDLE = {MANIFEST, read_spec(POLICY)[1]["weights"]["file"]}
_TEXT, _VALUE = {"type": "string", "minLength": 1}, {"type": ["number", "string"]}


def _of(required: tuple[str, ...], **properties: Any) -> dict[str, Any]:
    return {"type": "object", "required": required, "properties": properties, "additionalProperties": False}


FRONT_MATTER = _of(
    ("license", "library_name", "pipeline_tag", "tags", "model-index"),
    license=_TEXT,
    library_name={"const": "stable-baselines3"},
    pipeline_tag={"const": "reinforcement-learning"},
    tags={"type": "array", "items": _TEXT, "uniqueItems": True},
    **{
        "model-index": {
            "type": "array",
            "minItems": 1,
            "items": _of(
                ("name", "results"),
                name=_TEXT,
                results={
                    "type": "array",
                    "items": _of(
                        ("task", "dataset", "metrics"),
                        task=_of(("type",), type={"const": "reinforcement-learning"}, name=_TEXT),
                        dataset=_of(
                            ("type", "name"), type=_TEXT, name=_TEXT, config=_TEXT, split=_TEXT, args={"type": "object"}
                        ),
                        metrics={
                            "type": "array",
                            "minItems": 1,
                            "items": _of(
                                ("type", "value"), type=_TEXT, value=_VALUE, name=_TEXT, args={"type": "object"}
                            ),
                        },
                    ),
                },
            ),
        }
    },
)
"""What the Hub asks of a card's front matter, and all that `huggingface_hub.ModelCardData` takes of a model index."""


def published() -> dict[str, Any]:
    return json.loads(PUBLISHED.read_text(encoding="utf-8"))


def written(path: Path, **changes: Any) -> Path:
    """The published results, as if of few scenarios, so that a policy is soon run on them."""
    content = {**published(), **changes}
    for row in content["rows"]:
        row["episodes"] = EPISODES
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


@pytest.fixture
def few(tmp_path: Path) -> Path:
    return written(tmp_path / "few.json")


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """A policy of a user's own."""
    save_bundle(tmp_path / "own", SPEC, new_weights())
    return tmp_path / "own"


def card_in(folder: Path) -> tuple[dict[str, Any], str]:
    return halves((folder / CARD).read_text(encoding="utf-8"))


def test_the_folder_of_a_shipped_policy(
    few: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(eval.hub, "PUBLISHED", few)
    assert stopped(main, (str(POLICY), "--repo-id", "some-lab/arm.1", "--onnx"), tmp_path) == (0, "")
    folder = tmp_path / "results/hub/arm.1"
    assert {path.name for path in folder.iterdir()} == {*BUNDLE, CARD, CONFIG, EXCERPT, MODEL, ".gitattributes"}
    assert capsys.readouterr().out.endswith("to upload it: hf upload some-lab/arm.1 results/hub/arm.1\n")
    assert all((folder / name).read_bytes() == (POLICY / name).read_bytes() for name in BUNDLE)
    assert "*.safetensors filter=lfs diff=lfs merge=lfs -text\n" in (folder / ".gitattributes").read_text()
    load_controller(folder)

    fields, body = card_in(folder)
    Draft202012Validator(FRONT_MATTER).validate(fields)
    assert {"deep-reinforcement-learning", "reinforcement-learning", "BeltArm-v0", "ppo"} <= {*fields["tags"]}
    run = rollout(
        load_controller(POLICY), EPISODES, **choose_set("test").splits["randomized"].arguments(slice(EPISODES))
    )
    first = fields["model-index"][0]["results"][0]
    mean, sign, std = first["metrics"][0].pop("value").split()
    assert first["metrics"].pop(0) == {"type": "mean_reward", "name": "mean_reward"} and sign == "+/-"
    assert (float(mean), float(std)) == pytest.approx((-np.mean(run.cost), np.std(run.cost)), abs=0.01)
    assert (
        f"{mean} +/- {std}" in body
        and "| payload_mass | 0 | 0.2 |" in body
        and "without the guard" in body
        and bibtex() in body
    )

    excerpt = json.loads((folder / EXCERPT).read_text())
    assert (excerpt["n_eval_episodes"], excerpt["mean_reward"]) == (EPISODES, pytest.approx(-np.mean(run.cost)))
    assert excerpt["results_sha256"] == hashlib.sha256(few.read_bytes()).hexdigest()
    assert excerpt["provenance"] == published()["provenance"]
    assert {row["method"] for row in excerpt["rows"]} == {"ppo", "adaptive"} and len(excerpt["rows"]) == 18
    config = json.loads((folder / CONFIG).read_text())
    assert config["content_hash"] == read_spec(POLICY)[1]["content_hash"] and config["manifest"] == MANIFEST


@pytest.mark.parametrize("method", ["ppo", "student"])
def test_scores_are_those_of_the_results(method: str):
    results = published()
    scores = Scores(results, "0" * 64, method, Return(-1.0, 0.5, EPISODES))
    entries, page = model_index(scores), markdown(scores)
    found = {entry["dataset"]["config"]: entry for entry in entries}
    rows = {row["split"]: row for row in results["rows"] if row["method"] == method}
    assert next(iter(found)) == "randomized" and {*found} == {*rows} and len(rows) == 9
    for split, row in rows.items():
        assert found[split]["dataset"]["split"] == "test"
        metrics = {metric["type"]: metric for metric in found[split]["metrics"] if metric["type"] != "mean_reward"}
        assert list(metrics) == [name for name in SHOWN if name in row["metrics"]]
        for name, metric in metrics.items():
            assert {"iqm": metric["value"], **metric["args"]} == row["metrics"][name]
            assert "over 5 training seeds" in metric["name"]
        cost = row["metrics"]["cost"]
        assert f"| {split} | {cost['iqm']:.0f} [{cost['low']:.0f}, {cost['high']:.0f}] |" in page
    assert results["provenance"]["commit"] in page and results["provenance"]["command"] in page
    assert sum("mean_reward" in str(entry) for entry in entries) == 1


def test_a_card_says_where_its_policy_loses():
    results = published()
    scores = {method: Scores(results, "", method, Return(0.0, 0.0, EPISODES)) for method in ("ppo", "student")}
    for method, of_method in scores.items():
        said = losses(method, of_method.against_best())
        assert said in markdown(of_method)
        worse = said.split("It is not shown")[0]
        for name in ("cost", "tip_rms_mm", "residual_pp_mm"):
            where = [s for s, row in of_method.against_best().items() if row["metrics"][name]["verdict"] == "worse"]
            shown = worse.partition(f"in {METRICS[name].title} on ")[2].partition(";")[0]
            assert all(f"`{split}`" in shown for split in where) or (len(where) == 9 and "all 9 splits" in shown)
            assert shown.count("`") in (0, 2 * len(where))
    assert "in cost on all 9 splits" in losses("ppo", scores["ppo"].against_best())
    best = copy.deepcopy(scores["student"].against_best())
    for row in best.values():
        for pair in row["metrics"].values():
            pair["verdict"] = "better"
    assert losses("x", best) == "`x` is worse than the best classical controller on none of 9 splits."
    assert losses("x", {}).startswith("That is not known")
    del best["payload"]["metrics"]["residual_pp_mm"]
    best["friction"]["metrics"]["residual_pp_mm"]["verdict"] = "too few scenarios"
    assert "`payload`, `friction`" in losses("x", best).replace("`friction`, `payload`", "`payload`, `friction`")
    best["drive"]["metrics"]["cost"]["verdict"] = "too few scenarios"
    assert losses("x", best).startswith("That is not known") and "`drive`" in losses("x", best)


def test_a_policy_of_ones_own(own: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Without scores, and with those of a comparison in which it was the one learned method, with and without guard."""
    arguments = (str(own), "--out", "out", "--license", "cc0-1.0")
    assert stopped(main, arguments, tmp_path) == (0, "")
    said = capsys.readouterr().out
    assert "without scores" in said and said.endswith("hf upload ORG/NAME out\n")
    fields, body = card_in(tmp_path / "out")
    assert fields["license"] == "cc0-1.0" and "model-index" not in fields and "## Scores" not in body
    assert not (tmp_path / "out" / EXCERPT).exists()

    of_one, policies = results_of_one(own)
    path = written(tmp_path / "own.json", rows=of_one, paired=[], provenance=policies)
    assert stopped(main, (*arguments, "--results", str(path), "--overwrite"), tmp_path) == (0, "")
    fields, body = card_in(tmp_path / "out")
    (entry,) = fields["model-index"][0]["results"]
    assert entry["metrics"][1]["value"] == of_one[1]["metrics"]["cost"]["iqm"]
    assert "Of `my-ppo`, this policy:" in body and "no classical controller took part" in body
    assert (tmp_path / "out" / EXCERPT).exists()


def results_of_one(policy: Path) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Rows and provenance of a comparison of one policy, behind the guard and without it."""
    content = published()
    row = next(row for row in content["rows"] if (row["method"], row["split"]) == ("ppo", "nominal"))
    rows = [{**row, "method": name, "seeds": 1} for name in ("my-ppo+guard", "my-ppo")]
    return rows, {**content["provenance"], "policies": 2 * [read_spec(policy)[1]["content_hash"]]}


def test_other_sensors_and_a_film(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    pytest.importorskip("imageio_ffmpeg")
    monkeypatch.setattr("eval.sharing.folder._SPEED", 10.0)
    felt = FELT_POLICIES / "student/seed0"
    assert stopped(main, (str(felt), "--video"), tmp_path) == (0, "")
    folder = tmp_path / "results/hub/student-BeltArm-v0"
    assert (folder / FILM).read_bytes()[4:8] == b"ftyp" and "without scores" in capsys.readouterr().out
    assert json.loads((folder / CONFIG).read_text())["sensors"] == "accelerometer"


def test_an_older_folder_is_replaced_on_demand_alone(own: Path, tmp_path: Path):
    assert stopped(main, (str(own), "--out", "out"), tmp_path) == (0, "")
    (tmp_path / "out" / "left.txt").touch()
    assert "out is there already: replace it with --overwrite" in mistake(main, (str(own), "--out", "out"), tmp_path)
    assert (tmp_path / "out" / "left.txt").exists()
    assert stopped(main, (str(own), "--out", "out", "--overwrite"), tmp_path) == (0, "")
    assert not (tmp_path / "out" / "left.txt").exists()
    for other in (own, ROOT / "docs"):  # neither a policy nor anything else is overwritten
        refusal = mistake(main, (str(own), "--out", str(other), "--overwrite"), tmp_path)
        assert "holds other files: choose another folder for --out" in refusal
    assert {path.name for path in tmp_path.iterdir()} == {"out", "own"}


def other_scenarios(path: Path) -> Path:
    return written(path, scenario_set={"name": "test", "sha256": "0" * 64})


def fewer_policies(path: Path) -> Path:
    provenance = published()["provenance"]
    return written(path, provenance={**provenance, "policies": provenance["policies"][:-1]})


REFUSALS: dict[str, tuple[tuple[str, ...], str]] = {
    "no policy": (("nowhere",), "no policy bundle at nowhere"),
    "repository without owner": ((str(POLICY), "--repo-id", "arm"), "--repo-id must be ORG/NAME"),
    "repository elsewhere": ((str(POLICY), "--repo-id", "../arm"), "got '../arm'"),
    "repository with dashes": ((str(POLICY), "--repo-id", "lab/arm--1"), "got 'lab/arm--1'"),
    "licence in words": ((str(POLICY), "--license", "MIT License"), "--license must be the Hub's abbreviation"),
    "a file as folder": ((str(POLICY), "--out", str(ROOT / "LICENSE")), "LICENSE is a file"),
    "nowhere to write": ((str(POLICY), "--out", "/dev/null/x"), "/dev/null"),
    "no results": ((str(POLICY), "--out", "out", "--results", "none.json"), "none.json cannot be read"),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_refusals(case: str, tmp_path: Path):
    arguments, words = REFUSALS[case]
    assert words in mistake(main, arguments, tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("make", "words"),
    [(other_scenarios, "other scenarios than this checkout's test set"), (fewer_policies, "lists 9 policies")],
)
def test_results_that_do_not_fit(make: Callable[[Path], Path], words: str, tmp_path: Path):
    path = make(tmp_path / "results.json")
    assert words in mistake(main, (str(POLICY), "--out", "out", "--results", str(path)), tmp_path)
    assert not (tmp_path / "out").exists()


def test_a_policy_that_took_no_part(own: Path, few: Path, tmp_path: Path):
    refusal = mistake(main, (str(own), "--out", "out", "--results", str(few)), tmp_path)
    assert "took no part in" in refusal and "--policy" in refusal


def test_missing_packages_are_named(own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "onnx", None)
    assert "'.[onnx]'" in mistake(main, (str(own), "--onnx", "--out", "out"), tmp_path)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert "'beltarm-env[video]'" in mistake(main, (str(own), "--video", "--out", "out"), tmp_path)
    assert not (tmp_path / "out").exists()


# Loading what others offer

_watched: list[tuple[str, str]] | None = None


def _watch(event: str, arguments: tuple[Any, ...]) -> None:
    if _watched is not None and event in ("open", "import", "exec", "compile", "pickle.find_class", "os.system"):
        _watched.append((event, os.fsdecode(arguments[0]) if isinstance(arguments[0], str | bytes) else ""))


sys.addaudithook(_watch)  # Python knows no way to take one back: it rests where nothing is watched


@pytest.fixture
def watched() -> Iterator[list[tuple[str, str]]]:
    """Files that Python opens and code that it begins, by name of the event."""
    global _watched
    _watched = []
    yield _watched
    _watched = None


def example(*arguments: str, folder: Path) -> tuple[int, str]:
    return stopped(lambda: runpy.run_path(str(EXAMPLE), run_name="__main__"), arguments, folder)


@pytest.fixture
def hostile(own: Path) -> Path:
    """A policy between files that do harm where they are loaded."""
    target = own.parent / "executed"
    for name in ("policy.pkl", "model.zip", "pytorch_model.bin", "weights-0.safetensors"):
        (own / name).write_bytes(pickle.dumps(Exploit(target)))
    for name in ("__init__.py", "torch.py", "sitecustomize.py", "conftest.py", "policy.py", "agents.py"):
        (own / name).write_text(f"open({str(target)!r}, 'w')")
    os.mkfifo(own / "weights-1.safetensors")
    (own / "weights-2.safetensors").symlink_to("/dev/zero")
    return own


def test_nothing_beside_a_policy_is_read_or_run(
    hostile: Path, watched: list[tuple[str, str]], capsys: pytest.CaptureFixture[str]
):
    assert example(str(hostile), folder=hostile) == (0, "")
    weights = read_spec(hostile)[1]["weights"]["file"]
    inside = {name for _, name in watched if name.startswith(str(hostile))}
    assert inside == {str(hostile / MANIFEST), str(hostile / weights)}
    assert not [event for event in watched if event[0] == "pickle.find_class" and "Path" in event[1]]
    assert not (hostile.parent / "executed").exists()
    assert capsys.readouterr().out.startswith("ppo on paper: cost ")


@pytest.mark.parametrize("name", ["../elsewhere/weights-x.safetensors", "/etc/passwd", "policy.pkl", "policy.py"])
def test_a_manifest_that_names_another_file(name: str, hostile: Path, watched: list[tuple[str, str]]):
    edit(hostile, rehash=True, weights={"file": name, "sha256": "0" * 64})
    watched.clear()
    code, errors = example(str(hostile), folder=hostile)
    assert code == 2 and "must be a file weights-XXXX.safetensors beside it" in errors
    read = {found for event, found in watched if event == "open"}
    assert str(hostile / MANIFEST) in read and not {found for found in read if found.endswith(name)}
    assert not (hostile.parent / "executed").exists()


def test_of_a_hostile_folder_the_policy_alone_is_offered(hostile: Path, tmp_path: Path):
    assert stopped(main, (str(hostile), "--out", "out"), tmp_path) == (0, "")
    weights = read_spec(hostile)[1]["weights"]["file"]
    assert {path.name for path in (tmp_path / "out").iterdir()} == {MANIFEST, weights, CARD, CONFIG, ".gitattributes"}
    assert not (tmp_path / "executed").exists()


def test_the_hub_is_asked_for_the_policy_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    code, errors = example("--repo-id", "lab/arm", folder=tmp_path)
    assert code == 2 and "pip install huggingface_hub" in errors and errors.count("\n") == 1

    def snapshot_download(repo_id: str, allow_patterns: list[str]) -> str:
        """A snapshot as the Hub's cache has it: links to files that are named by their hash."""
        snapshot = tmp_path / "snapshots"
        for path in POLICY.iterdir():
            if any(path.match(pattern) for pattern in allow_patterns):
                shutil.copy(path, tmp_path / hashlib.sha256(path.read_bytes()).hexdigest())
                snapshot.mkdir(exist_ok=True)
                (snapshot / path.name).symlink_to(tmp_path / hashlib.sha256(path.read_bytes()).hexdigest())
        assert repo_id == "lab/arm" and {path.name for path in snapshot.iterdir()} == BUNDLE
        return str(snapshot)

    monkeypatch.setitem(sys.modules, "huggingface_hub", SimpleNamespace(snapshot_download=snapshot_download))
    assert example("--repo-id", "lab/arm", folder=tmp_path) == (0, "")


def test_the_code_on_a_card_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.setattr(
        eval.hub, "PUBLISHED", written(tmp_path / "none.json", provenance={**published()["provenance"], "policies": []})
    )
    assert stopped(main, (str(POLICY), "--out", "out", "--repo-id", "lab/arm"), tmp_path) == (0, "")
    asked = SimpleNamespace(snapshot_download=lambda repo_id, allow_patterns: str(tmp_path / "out"))
    monkeypatch.setitem(sys.modules, "huggingface_hub", asked)
    capsys.readouterr()
    code = card_in(tmp_path / "out")[1].split("```python\n")[1].split("```")[0]
    exec(compile(code, "card", "exec"), {})
    assert len(capsys.readouterr().out.split()) >= 10
