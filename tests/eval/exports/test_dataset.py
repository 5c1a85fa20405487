"""Datasets for offline learning: they hold what single environments do, and appear when they are whole."""

import os
import runpy
import sys
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from commands import ROOT, mistake, stopped

from beltarm_env.task.seeds import dataset_arms
from eval import export
from eval.comparison.methods import methods_side_by_side
from eval.exports import dataset as written

minari = pytest.importorskip("minari")
pytest.importorskip("h5py")

RUNAWAY = """
import numpy as np

class Runaway:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.ones((len(observation), 1), np.float32), None
"""
ID, COUNT = "beltarm/tests/mixed-v0", 12
SMALL = ("dataset", "--episodes", "1", "--controller", "paper")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with a dataset of three controllers, one of which leaves the workspace."""
    made = tmp_path_factory.mktemp("datasets")
    (made / "runaway.py").write_text(RUNAWAY)
    words = f"dataset --out {made} --id {ID} --episodes {COUNT} --controller paper --controller adaptive"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(written, "SCORED", 2)
        patch.setattr(written, "PIECE", 7)  # so that a piece begins in the middle of the turns
        arguments = (*words.split(), "--controller", f"{made}/runaway.py:Runaway")
        assert stopped(export.main, arguments, made) == (0, "")
    return made


@pytest.fixture
def dataset(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(folder))
    return minari.load_dataset(ID)


def metadata(dataset: Any) -> list[dict[str, Any]]:
    return list(dataset.storage.get_episode_metadata(dataset.episode_indices))


def test_episodes_are_those_of_the_recovered_environment_bit_for_bit(dataset: Any):
    nominal, every = gymnasium.make("BeltArm-v0"), zip(dataset, metadata(dataset), strict=True)
    for episode, about in [*every][::2]:
        for env, options in ((dataset.recover_environment(), None), (nominal, about["options"])):
            seen, _ = env.reset(seed=about["seed"], options=options)
            arm: Any = env.unwrapped
            assert (seen == episode.observations[0]).all()
            for k, action in enumerate(episode.actions if options is None else episode.actions[:40]):
                hidden = {name: values[k + 1] for name, values in episode.infos["not_observed"].items()}
                seen, reward, terminated, truncated, info = env.step(action)
                assert seen.tobytes() == episode.observations[k + 1].tobytes() and reward == episode.rewards[k]
                assert arm.state.astype(np.float32).tobytes() == hidden["state"].tobytes()
                assert np.float32(info["tip_error"]) == hidden["tip_error"]
                assert (terminated, truncated) == (episode.terminations[k], episode.truncations[k])
        assert len(episode) == about["total_steps"] and (episode.terminations | episode.truncations)[-1]
        assert about["cost"] == -np.sum(episode.rewards) and about["finished"] == episode.truncations[-1]


def test_infos_tell_how_every_action_came_about(dataset: Any):
    acted, ends = set(), set()
    for episode, about in zip(dataset, metadata(dataset), strict=True):
        ends.add(bool(episode.terminations[-1]))
        rows = {name: values[1:] for name, values in episode.infos["behaviour"].items()}
        own = np.where(rows["alone"], 0, rows["controller_action"])
        np.testing.assert_array_equal(np.clip(own + rows["noise"], -1, 1), episode.actions[:, 0])
        acted.add((about["disturbance"], bool(rows["noise"].any()), bool(rows["alone"].any())))
        if about["controller"] == "Runaway":
            assert (rows["controller_action"] == 1).all()
    expected = {("none", False, False), ("noise", True, False), ("stretches", True, True)}
    assert expected <= acted <= expected | {("stretches", False, False)}  # an arm may leave before the first stretch
    assert ends == {False, True}


def test_metadata(dataset: Any, monkeypatch: pytest.MonkeyPatch):
    first, known, about = dataset_arms(0).first, dataset.storage.metadata, metadata(dataset)
    assert [each["controller"] for each in about] == ["paper", "adaptive", "Runaway"] * (COUNT // 3)
    assert [each["seed"] for each in about] == list(range(first, first + COUNT))
    low, high = known["ref_min_score"], known["ref_max_score"]
    np.testing.assert_allclose(minari.get_normalized_score(dataset, np.array([low, high])), [0, 1])
    assert low < -5000 < -1000 < high < 0 and known["num_episodes_average_score"] == 2
    assert dataset.total_steps == sum(len(episode) for episode in dataset)
    assert list(known["beltarm"]["controllers"]) == ["paper", "adaptive", "Runaway"]
    assert known["beltarm"]["disturbed"] == 0.5 and list(minari.list_local_datasets()) == [ID]
    monkeypatch.delitem(gymnasium.registry, "BeltArm-v0")
    env = dataset.recover_environment(eval_env=True)
    assert env.spec.kwargs == {"randomization": "train", "moves": 1, "sensors": "encoder"}
    assert env.observation_space == dataset.observation_space and env.action_space == dataset.action_space


def test_controllers_of_one_name_are_told_apart(tmp_path: Path):
    given = [f"{tmp_path / name}.py:Runaway" for name in ("a", "b")]
    for spec in given:
        Path(spec.partition(":")[0]).write_text(RUNAWAY)
    names = [name for name, _ in methods_side_by_side(["paper", *given], [])]
    assert names == ["paper", *(f"Runaway ({spec.partition(':')[0]})" for spec in given)]


def test_an_episode_is_the_same_in_any_piece(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """And other sensors only add to the observation."""
    monkeypatch.setattr(written, "reference_scores", lambda *_: (-2.0, -1.0))
    arguments = ("--disturbed", "1", "--controller", "paper", "--episodes", "5", "--out", str(tmp_path))
    assert stopped(export.main, ("dataset", *arguments, "--id", "a-v0"), tmp_path) == (0, "")
    monkeypatch.setattr(written, "PIECE", 3)
    assert stopped(export.main, ("dataset", *arguments, "--id", "b-v0", "--sensors", "full"), tmp_path) == (0, "")
    whole, pieces = (minari.MinariDataset(tmp_path / name / "data") for name in ("a-v0", "b-v0"))
    assert metadata(whole) == metadata(pieces)
    for a, b in zip(whole, pieces, strict=True):
        assert a.actions.tobytes() == b.actions.tobytes() and a.rewards.tobytes() == b.rewards.tobytes()
        np.testing.assert_array_equal(a.observations, b.observations[:, : a.observations.shape[1]])


def test_an_episode_may_be_a_shift(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(written, "reference_scores", lambda *_: (-2.0, -1.0))
    arguments = ("--moves", "2", "--controller", "paper", "--episodes", "2", "--out", str(tmp_path), "--id", "a-v0")
    assert stopped(export.main, ("dataset", *arguments), tmp_path) == (0, "")
    dataset = minari.MinariDataset(tmp_path / "a-v0" / "data")
    env = dataset.recover_environment()
    for episode, about in zip(dataset, metadata(dataset), strict=True):
        seen, info = env.reset(seed=about["seed"])
        for action, expected in zip(episode.actions, episode.observations, strict=False):
            assert seen.tobytes() == expected.tobytes()
            seen, *_, info = env.step(action)
        assert episode.truncations[-1] and len(episode) == 2400 and 0 < info["move_cost"] < about["cost"]


def test_bad_options(tmp_path: Path):
    for option, value, words in (
        ("--id", "mixed", "'mixed'"),
        ("--id", "../mixed-v0", "'../mixed-v0'"),
        ("--episodes", "0", "got 0"),
        ("--seed", "18", "17, got 18"),
        ("--disturbed", "1.5", "1.5"),
        ("--controller", "papr", "paper"),
        ("--out", "/dev/null/data", "/dev/null/data"),
    ):
        line = mistake(export.main, (*SMALL, option, value), tmp_path)
        assert words in line and option.strip("-") in line.replace("cannot write to", "out")
        assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_without_the_package_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "h5py", None)
    assert "beltarm-env[minari]" in mistake(export.main, SMALL, tmp_path)


def test_a_dataset_is_replaced_only_if_asked_and_by_a_whole_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(written, "reference_scores", lambda *_: (-2.0, -1.0))
    monkeypatch.setattr(written, "PIECE", 1)
    arguments, data = (*SMALL, "--out", str(tmp_path), "--id", "one/two-v0"), tmp_path / "one/two-v0/data"
    pieces, file = written.pieces, data / "main_data.hdf5"

    def interrupted(*words: Any) -> Any:
        yield next(pieces(*words))
        raise KeyboardInterrupt

    def interrupt(*more: str) -> None:
        with monkeypatch.context() as patch:
            patch.setattr(written, "pieces", interrupted)
            assert stopped(export.main, (*arguments, *more), tmp_path)[0] == 130

    interrupt()
    assert os.listdir(tmp_path) == []
    assert stopped(export.main, arguments, tmp_path) == (0, "")
    first = file.stat().st_mtime_ns
    assert "--overwrite" in mistake(export.main, arguments, tmp_path)
    interrupt("--overwrite")
    assert file.stat().st_mtime_ns == first and os.listdir(tmp_path) == ["one"]
    assert stopped(export.main, (*arguments, "--overwrite"), tmp_path) == (0, "")
    assert file.stat().st_mtime_ns > first and os.listdir(tmp_path) == ["one"]
    (data / "metadata.json").unlink()
    assert "one/two-v0" in mistake(export.main, (*arguments, "--overwrite"), tmp_path)
    assert file.exists()


def test_the_example_and_the_documented_lines_run(dataset: Any, folder: Path, capsys: pytest.CaptureFixture[str]):
    example = runpy.run_path(str(ROOT / "docs/examples/behaviour_cloning.py"))
    example["main"].__globals__.update(EPOCHS=1, ARMS=1)
    example["main"]("paper", ID)
    shown = capsys.readouterr().out.splitlines()
    assert [line.split(": mean cost ")[0] for line in shown] == ["paper in the dataset", "clone of paper", "paper"]
    lines = (ROOT / "docs/guide/dataset.md").read_text(encoding="utf-8").split("```python\n")[1].split("```")[0]
    exec(lines.replace("results/datasets", str(folder)).replace("beltarm/randomized/mixed-v0", ID), {})
