"""Training runs: what is learnt is reproducible, a run that is stopped goes on as if it had not been."""

import errno
import json
import os
import pickle
import pydoc
import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from commands import stopped
from refusals import refused
from stable_baselines3.common.base_class import BaseAlgorithm
from trainings import NAMES, OWN, TINY, StopAfter, run, same_policies, tiny, weights

from agents.learners.ppo import ALONE, PpoConfig
from agents.learners.reinforcement import ModelLearner, ReinforcementConfig
from agents.policy.bundle import load_controller, read_spec
from agents.runs.checkpoint import VERSION, RunFolder
from agents.runs.command_line import main, run_in, runs_of
from agents.runs.training import News, TrainingMonitor, train, validate
from agents.tensor_file import MAX_BYTES
from baselines.engines.parallel import Channel, Interrupted
from baselines.engines.workplace import Workplace
from baselines.tools.files import sealed


def model(monitor: TrainingMonitor) -> BaseAlgorithm:
    assert isinstance(monitor.learner, ModelLearner)
    return monitor.learner.model


def costs(monitor: TrainingMonitor) -> list[tuple[int, float]]:
    return [(steps, cost) for steps, _, cost in monitor.curve]


@pytest.fixture(scope="module")
def whole_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], TrainingMonitor]:
    """Runs that nothing has interrupted, each made once, by the name of their algorithm."""
    return cache(lambda name: run(tiny(name, tmp_path_factory.mktemp("whole") / "run")))


@pytest.mark.parametrize("name", NAMES)
def test_bundles_of_all_algorithms(name: str, whole_of: Any):
    whole = whole_of(name)
    last = whole.config.out / "last"
    spec, _ = read_spec(last)
    assert spec.algorithm == name and all(path.stat().st_size < MAX_BYTES for path in last.iterdir())
    assert spec.provenance["curve"] == [list(point) for point in whole.curve]
    assert validate(load_controller(last), 4) == spec.provenance["reached"]["validation"]
    assert read_spec(whole.config.out / "best")[0].provenance["run"]["steps"] in (128, 256)


@pytest.mark.parametrize("name", NAMES)
def test_interrupted_and_resumed_is_uninterrupted(name: str, whole_of: Any, tmp_path: Path):
    """Bit for bit: networks, optimisers, curve and bundles, whatever happened to the generators in between."""
    whole, config = whole_of(name), tiny(name, tmp_path / "parts")
    each = 8 if name == "sac" else 64  # agent steps, after which a request to stop is looked at
    for before, steps in ((0, 64), (64, 192)):
        part = partial(run, replace(config, resume=before > 0), StopAfter((steps - before) // each))
        refused(Interrupted, (f"at {steps} steps", str(config.out)), part)
        np.random.seed(5)  # noqa: NPY002
        torch.manual_seed(9)
    parts = run(replace(config, resume=True))
    ours, theirs = model(whole).policy.state_dict(), model(parts).policy.state_dict()
    assert ours.keys() == theirs.keys() and all(torch.equal(ours[name], theirs[name]) for name in ours)
    for kind in [kind for kind in model(whole).get_parameters() if kind.endswith("optimizer")]:
        ours, theirs = (model(monitor).get_parameters()[kind]["state"] for monitor in (whole, parts))
        assert ours.keys() == theirs.keys() and len(ours)
        assert all(torch.equal(ours[key]["exp_avg"], theirs[key]["exp_avg"]) for key in ours)
    assert costs(whole) == costs(parts) and len(costs(whole)) == 3
    assert same_policies(whole.config.out, config.out)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[News]]:
    """Folder of a run of PPO with 8 arms and 128 agent steps, to be copied, and what it has reported."""
    folder, reports = tmp_path_factory.mktemp("finished") / "run", list[News]()
    run(tiny("ppo", folder, total_steps=128), report=reports.append)
    return folder, reports


@pytest.mark.parametrize(
    ("where", "when", "resume"),
    [
        ("agents.runs.training.RunFolder.save", None, False),  # the best policy is there, and nothing to go on from
        ("agents.runs.checkpoint.write_text", lambda at, text: at.stem == "validation" and text.count("\n") == 3, True),
        ("agents.runs.training.save_bundle", None, True),
        ("agents.runs.training.annotate", None, True),
    ],
)
def test_a_run_killed_at_any_moment_is_finished_as_if_it_had_not_been(
    where: str, when: Any, resume: bool, finished: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    (whole, _), config, original = finished, resumed(tmp_path / "run", resume=False), pydoc.locate(where)
    assert callable(original)

    def killed(*arguments: Any, **named: Any) -> Any:
        if when is None or when(*arguments):
            raise KeyboardInterrupt
        return original(*arguments, **named)

    with monkeypatch.context() as patched:
        patched.setattr(where, killed)
        refused(KeyboardInterrupt, (), lambda: run(config))
    again = run(replace(config, resume=resume))
    for kind in ("best", "last"):
        assert weights(config.out / kind) == weights(whole / kind)
        assert read_spec(config.out / kind)[0].provenance["run"]["steps"] == 128
    assert [point[::2] for point in read_spec(whole / "last")[0].provenance["curve"]] == [[*x] for x in costs(again)]
    assert len((config.out / "validation.csv").read_text().splitlines()) == 3


def test_two_runs_do_not_work_in_one_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Also not where the second would delete the first; a lock that a killed process leaves behind does not count."""
    config = tiny("ppo", tmp_path, total_steps=64)
    (tmp_path / ".lock").write_text("left behind")
    with RunFolder(tmp_path).locked(config):
        for other in (config, replace(config, overwrite=True)):
            refused(ValueError, ("another run works in", "--out"), lambda other=other: run(other))
        assert {path.name for path in tmp_path.iterdir()} == {".lock"}
    run(config)


@pytest.fixture
def copied(finished: Any, tmp_path: Path) -> Path:
    return shutil.copytree(finished[0], tmp_path / "run")


def resumed(folder: Path, **options: Any) -> ReinforcementConfig:
    return tiny("ppo", folder, **{"total_steps": 128, "resume": True, **options})


def test_a_run_is_not_mixed_with_another(copied: Path):
    before = sorted((path.name, path.stat().st_mtime_ns) for path in copied.iterdir())
    for options, words in (
        ({"resume": False}, ("--resume", "--overwrite", "--out")),
        ({"seed": 1}, ("--seed 0, not 1",)),
        ({"arms": 16}, ("--arms 8, not 16",)),
        ({"hidden": (4, 4)}, ("--hidden [8], not [4, 4]",)),
        ({"learning_rate": 1e-3}, ("--learning-rate 2e-05, not 0.001",)),
        ({"total_steps": 64}, ("has 128 agent steps already", "--total-steps")),
    ):
        refused(ValueError, words, partial(run, resumed(copied, **options)))
    refused(ValueError, ("run in", "--"), lambda: run(tiny("sac", copied, resume=True)))
    assert sorted((path.name, path.stat().st_mtime_ns) for path in copied.iterdir()) == before


def test_overwriting_deletes_the_run_and_nothing_else(copied: Path, tmp_path: Path):
    (copied / "notes.txt").write_text("mine")
    old = weights(copied / "last")
    run(resumed(copied, resume=False, overwrite=True, seed=3))
    assert (copied / "notes.txt").read_text() == "mine"
    assert weights(copied / "last") != old
    assert len((copied / "validation.csv").read_text().splitlines()) == 3
    assert json.loads((copied / "config.json").read_text())["config"]["seed"] == 3
    (tmp_path / "other/best").mkdir(parents=True)
    (tmp_path / "other/best/picture.png").touch()
    refused(ValueError, ("not the folder of a run",), lambda: run(tiny("ppo", tmp_path / "other", overwrite=True)))
    assert (tmp_path / "other/best/picture.png").exists()


def test_damaged_checkpoints_and_settings(copied: Path):
    path, settings = copied / "checkpoint.pkl", copied / "config.json"
    whole, config = path.read_bytes(), settings.read_text()
    others = b"", whole[:-1000], b"not a pickle", pickle.dumps([1, 2]), sealed(pickle.dumps([1, 2]))
    flipped = [whole[:at] + bytes([whole[at] ^ 16]) + whole[at + 1 :] for at in (100, len(whole) - 100)]
    for damaged in (*others, *flipped):
        path.write_bytes(damaged)
        refused(ValueError, ("checkpoint.pkl", "--out"), lambda: run(resumed(copied)))
    path.write_bytes(whole)
    for text in ("", "[]", '{"identity": 3}', '{"identity": {"options": 3}}'):
        settings.write_text(text)
        refused(ValueError, ("config.json", "damaged", "--out"), lambda: run(resumed(copied)))
    settings.write_text(config.replace(json.loads(config)["identity"]["base_hash"], "x"))
    refused(ValueError, ("gains of the base",), lambda: run(resumed(copied)))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda content: content.update(version=99), f"format 99, this version has {VERSION}"),
        (lambda content: content["learner"].pop("replay"), "KeyError: 'replay'"),
        (lambda content: content["learner"].update(env=3), "TypeError: "),
    ],
)
def test_checkpoints_of_another_version_are_not_given_up(change: Any, words: str, copied: Path):
    """What did not fit is said, and who can go on; nothing is changed, and nobody is told to delete."""
    content = pickle.loads((copied / "checkpoint.pkl").read_bytes())
    change(content)
    (copied / "checkpoint.pkl").write_bytes(sealed(pickle.dumps(content)))
    noted = json.loads((copied / "config.json").read_text()) | {"written_by": {"version": "9.9", "commit": "abc123"}}
    (copied / "config.json").write_text(json.dumps(noted))
    before = {path.name: path.stat().st_mtime_ns for path in copied.iterdir()}
    with pytest.raises(ValueError, match=rf"\(.*{words}.*9\.9 at commit abc123") as end:
        run(resumed(copied))
    assert "--overwrite" not in str(end.value)
    assert {path.name: path.stat().st_mtime_ns for path in copied.iterdir()} == before


def test_a_full_disk_leaves_the_last_checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    config = tiny("ppo", tmp_path, total_steps=192, validation_every=64)
    replace_file, saved = os.replace, []

    def fill_up(source: Any, target: Any) -> None:
        if Path(target).name == "checkpoint.pkl":
            saved.append(target)
            if len(saved) == 3:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        replace_file(source, target)

    monkeypatch.setattr(os, "replace", fill_up)
    refused(OSError, ("cannot save to", "No space left", "checkpoint stays", "--resume"), lambda: run(config))
    monkeypatch.undo()
    assert [path.name for path in tmp_path.glob(".*")] == [".lock"]
    assert [steps for steps, _ in costs(run(replace(config, resume=True)))] == [0, 64, 128, 192]


@pytest.mark.slow
def test_several_seeds_give_the_runs_that_they_give_alone_beside_one_that_fails(tmp_path: Path):
    many, told = tmp_path / "many", {**ALONE, **OWN["ppo"]}
    many.mkdir()
    (many / "seed1").write_text("a file")
    code, errors = stopped(lambda: main(PpoConfig, None), ("--out", "many", "--seeds", "2", *TINY), tmp_path)
    failed, others = errors.splitlines()
    assert code == 2 and "seed1: cannot write to" in failed and "1 other runs" in others
    assert weights(many / "seed0/last") == weights(run(tiny("ppo", tmp_path / "alone", **told)).config.out / "last")
    with Workplace(tiny("ppo", many, **told), many) as local:
        refused(ValueError, ("seed0 already holds a run",), lambda: runs_of(tiny("ppo", many, **told, seeds=2), local))
        (many / "seed1").unlink()
        going_on = runs_of(tiny("ppo", many, **told, seeds=2, resume=True), local)
    assert [each.resume for each in going_on.values()] == [True, False], "one that was waiting begins"


def test_a_run_whose_process_died_goes_on_when_it_is_begun_again(finished: Any, tmp_path: Path):
    """With the very options that it was begun with, which are not those of resuming; what is half written goes."""
    config = tiny("ppo", tmp_path / "run", total_steps=128)
    refused(Interrupted, ("at 64 steps",), lambda: train(config, Channel(stop=StopAfter(1)), "python train/ppo.py"))
    for half in (".checkpoint-half.pkl", "best/.policy-half.safetensors", ".config-half.json"):
        (config.out / half).write_bytes(b"\x80\x05half")
        os.utime(config.out / half, (0, 0))  # as if an hour had passed
    end = run_in(config, "python train/ppo.py --resume", config.out, Channel())
    assert end.steps == 128 and [path.name for path in config.out.rglob(".*")] == [".lock"]
    assert weights(tmp_path / "run/last") == weights(finished[0] / "last")
    run_in(replace(config, total_steps=192), "longer", config.out, Channel())
    assert read_spec(tmp_path / "run/last")[0].provenance["command"] == "python train/ppo.py && longer", "what made it"


def test_progress_is_reported(finished: Any, tmp_path: Path):
    baseless: list[News] = []
    run(tiny("ppo", tmp_path, total_steps=64, validation_every=64, base="none"), report=baseless.append)
    for (folder, reports), steps, rings in ((finished, [0, 128], True), ((tmp_path, baseless), [0, 64], False)):
        validated = [news for news in reports if news.cost is not None]
        assert [news.steps for news in validated] == steps
        assert all("cost" in news.scores or "of the base" in news.scores for news in validated)
        assert all(("ringing" in news.scores) == rings for news in validated)
        names = (folder / "progress.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
        assert "validation/cost_over_base" in names and "validation/residual_pp_mm" in names
        assert ("validation/residual_pp_mm_over_base" in names) == rings
