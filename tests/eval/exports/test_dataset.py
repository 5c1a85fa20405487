"""Datasets for offline learning: what is written is what single environments do, and it is whole or not there."""

from __future__ import annotations

import os
import runpy
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from commands import mistake, stopped

from beltarm_env import EPISODE_STEPS, BeltArmEnv
from beltarm_env.task.seeds import DATASETS, dataset_arms
from eval.offline import contents, episodes, scores
from eval.offline.disturbance import KINDS, LARGEST, draw_disturbance
from eval.offline.episodes import in_turn
from eval.offline.scores import Scores
from eval.offline.writing import Place

minari = pytest.importorskip("minari")
pytest.importorskip("h5py")

ROOT = Path(__file__).resolve().parents[2]
RUNAWAY = '''
import numpy as np

class Runaway:
    """Full torque: the arm leaves its workspace."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.ones((len(observation), 1), np.float32), None
'''
ID, COUNT = "beltarm/tests/mixed-v0", 12


def write() -> None:
    """What `eval/dataset.py` does, within this process."""
    runpy.run_path(str(ROOT / "eval/dataset.py"), run_name="__main__")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder that Minari finds a dataset in: of three controllers, one of which leaves the workspace."""
    made = tmp_path_factory.mktemp("datasets")
    (made / "runaway.py").write_text(RUNAWAY)
    words = f"--out {made} --id {ID} --episodes {COUNT} --disturbed 0.5 --controller paper --controller adaptive"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scores, "EPISODES", 2)
        patch.setattr(episodes, "PIECE", 7)  # so that a piece begins in the middle of the turns
        arguments = (*words.split(), "--controller", f"{made}/runaway.py:Runaway")
        assert stopped(write, arguments, made) == (0, "")
    return made


@pytest.fixture
def dataset(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(folder))
    return minari.load_dataset(ID)


def told(dataset: Any) -> list[dict[str, Any]]:
    return list(dataset.storage.get_episode_metadata(dataset.episode_indices))


def test_episodes_are_those_of_the_recovered_environment_bit_for_bit(dataset: Any):
    """From the seed alone, and on a nominal environment from the options too."""
    nominal = gymnasium.make("BeltArm-v0")
    kinds = set()
    for episode, of in zip(dataset, told(dataset), strict=True):
        kinds.add((of["disturbance"], bool(episode.terminations[-1])))
        for env, options in ((dataset.recover_environment(), None), (nominal, of["options"])):
            assert env.spec is not None and env.spec.max_episode_steps == EPISODE_STEPS
            arm = env.unwrapped
            assert isinstance(arm, BeltArmEnv)
            seen, _ = env.reset(seed=of["seed"], options=options)
            replayed, states, errors, rewards, ends = [seen], [arm.state], [], [], []
            for action in episode.actions if options is None else episode.actions[:40]:
                seen, reward, terminated, truncated, info = env.step(action)
                replayed.append(seen)
                states.append(arm.state)
                errors.append(info["tip_error"])
                rewards.append(reward)
                ends.append((terminated, truncated))
            count = len(rewards)
            assert np.array(replayed).tobytes() == episode.observations[: count + 1].tobytes()
            assert np.array(rewards).tobytes() == episode.rewards[:count].tobytes()
            hidden = episode.infos["not_observed"]
            assert np.array(states, np.float32).tobytes() == hidden["state"][: count + 1].tobytes()
            assert np.array(errors, np.float32).tobytes() == hidden["tip_error"][1 : count + 1].tobytes()
            expected = np.stack([episode.terminations, episode.truncations], axis=1)[:count]
            np.testing.assert_array_equal(np.array(ends), expected)
        assert len(episode) == of["total_steps"] and any(expected[-1]) == (count == len(episode))
        assert of["cost"] == -np.sum(episode.rewards) and of["finished"] == episode.truncations[-1]
    assert {kind for kind, _ in kinds} == set(KINDS) and {left for _, left in kinds} == {False, True}


def test_infos_tell_how_every_action_came_about(dataset: Any):
    acted = set()
    for episode, of in zip(dataset, told(dataset), strict=True):
        rows = {name: values[1:] for name, values in episode.infos["behaviour"].items()}
        own = np.where(rows["alone"], 0, rows["controller_action"])
        np.testing.assert_array_equal(np.clip(own + rows["noise"], -1, 1), episode.actions[:, 0])
        acted.add((of["disturbance"], bool(rows["noise"].any()), bool(rows["alone"].any())))
        if of["controller"] == "Runaway":
            assert (rows["controller_action"] == 1).all()
    expected = {("none", False, False), ("noise", True, False), ("stretches", True, True)}
    assert expected <= acted <= expected | {("stretches", False, False)}  # an arm may leave before the first stretch


def test_controllers_take_turns_on_arms_of_the_datasets_own(dataset: Any):
    assert [of["controller"] for of in told(dataset)] == ["paper", "adaptive", "Runaway"] * (COUNT // 3)
    first = dataset_arms(0).first
    assert [of["seed"] for of in told(dataset)] == list(range(first, first + COUNT)) and first == DATASETS.first


def test_the_environment_is_recovered_where_it_is_not_registered(dataset: Any, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delitem(gymnasium.registry, "BeltArm-v0")
    for evaluating in (False, True):
        env = dataset.recover_environment(eval_env=evaluating)
        assert env.spec.kwargs == {"randomization": "train", "sensors": "encoder"}
        assert env.observation_space == dataset.observation_space and env.action_space == dataset.action_space


def test_scores_and_metadata(dataset: Any):
    known = dataset.storage.metadata
    low, high = known["ref_min_score"], known["ref_max_score"]
    np.testing.assert_allclose(minari.get_normalized_score(dataset, np.array([low, high])), [0, 1])
    assert low < -5000 < -1000 < high < 0 and known["num_episodes_average_score"] == 2
    assert dataset.total_steps == sum(len(episode) for episode in dataset)
    of = known["beltarm"]
    assert list(of["controllers"]) == ["paper", "adaptive", "Runaway"] and of["disturbed"] == 0.5
    assert list(minari.list_local_datasets()) == [ID]


def test_an_episode_is_the_same_in_any_piece(monkeypatch: pytest.MonkeyPatch):
    """And other sensors only add to the observation."""

    def run(sensors: str) -> list[episodes.Episode]:
        mixture = contents.Mixture.of(("paper",), (), 1.0, {"randomization": "train", "sensors": sensors})
        return [one for piece in mixture.episodes(DATASETS.first, 5, lambda *_: None) for one in piece]

    whole = run("encoder")
    monkeypatch.setattr(episodes, "PIECE", 3)
    for one, other in zip(whole, run("tip"), strict=True):
        assert one.seed == other.seed and one.options == other.options
        assert one.actions.tobytes() == other.actions.tobytes() and one.rewards.tobytes() == other.rewards.tobytes()
        np.testing.assert_array_equal(one.observations, other.observations[:, :-1])


def test_disturbances_are_drawn_as_asked():
    drawn = [draw_disturbance(DATASETS.first + k, 0.5) for k in range(200)]
    counts = Counter(one.kind for one in drawn)
    assert 80 < counts["none"] < 120 and 35 < counts["noise"] < 65
    for one in drawn:
        assert 0 <= one.size <= LARGEST[one.kind] and one.noise.shape == one.alone.shape == (EPISODE_STEPS,)
        assert np.abs(np.diff(one.noise)).max() < 5 * LARGEST[one.kind] or one.kind == "none"
    spread = [np.std(one.noise) / one.size for one in drawn if one.kind == "noise"]
    assert np.mean(spread) == pytest.approx(1, abs=0.1)
    assert 0.1 < np.mean([one.alone.mean() for one in drawn if one.kind == "stretches"]) < 0.4
    assert all(draw_disturbance(7, 0.0).kind == "none" for _ in range(3))


SMALL = ("--episodes", "1", "--controller", "paper")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--id", "mixed"), "--id must be like beltarm/randomized/mixed-v0, got 'mixed'"),
        (("--id", "../mixed-v0"), "--id must be like"),
        (("--episodes", "0"), "--episodes must lie within 1 and"),
        (("--seed", "18"), "--seed must lie within 0 and 17, got 18"),
        (("--disturbed", "1.5"), "--disturbed must lie within 0 and 1, got 1.5"),
        (("--controller", "papr"), "did you mean paper?"),
        (("--out", "/dev/null/data"), "cannot write to /dev/null/data"),
    ],
)
def test_bad_options(arguments: tuple[str, ...], message: str, tmp_path: Path):
    assert message in mistake(write, (*SMALL, *arguments), tmp_path)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


@pytest.mark.parametrize("package", ["minari", "h5py"])
def test_without_the_package_the_extra_is_named(package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, package, None)
    if package == "minari":
        monkeypatch.setitem(sys.modules, "minari.dataset.minari_dataset", None)
    assert mistake(write, SMALL, tmp_path).endswith("datasets need Minari: pip install 'beltarm-env[minari]'")


def test_a_dataset_is_replaced_only_if_asked_and_when_the_new_one_is_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(contents, "reference_scores", lambda **_: Scores(-2.0, -1.0, 1))
    place = Place(tmp_path, "one/two-v0")
    arguments = (*SMALL, "--out", str(tmp_path), "--id", place.id)
    monkeypatch.setattr(episodes, "PIECE", 1)

    def interrupted(*words: Any, **named: Any) -> Any:
        for piece in in_turn(*words, **named):
            yield piece
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(contents, "in_turn", interrupted)
        assert stopped(write, arguments, tmp_path)[0] == 130
    assert os.listdir(tmp_path) == []
    assert stopped(write, arguments, tmp_path) == (0, "")
    assert mistake(write, arguments, tmp_path).endswith("or replace it by --overwrite")
    file = place.path / "data" / "main_data.hdf5"
    first = file.stat().st_mtime_ns
    with monkeypatch.context() as patch:
        patch.setattr(contents, "in_turn", interrupted)
        assert stopped(write, (*arguments, "--overwrite"), tmp_path)[0] == 130
    assert file.stat().st_mtime_ns == first and os.listdir(tmp_path) == ["one"]
    assert stopped(write, (*arguments, "--overwrite"), tmp_path) == (0, "")
    assert file.stat().st_mtime_ns > first and os.listdir(tmp_path) == ["one"]
    (place.path / "data" / "metadata.json").unlink()
    assert "is there and is no dataset" in mistake(write, (*arguments, "--overwrite"), tmp_path)
    assert file.exists()


def test_the_example_and_the_documented_lines_run(dataset: Any, folder: Path, capsys: pytest.CaptureFixture[str]):
    example = runpy.run_path(str(ROOT / "docs/examples/behaviour_cloning.py"))
    example["main"].__globals__.update(EPOCHS=1, ARMS=1)
    example["main"]("paper", ID)
    shown = capsys.readouterr().out.splitlines()
    assert [line.split(": mean cost ")[0] for line in shown] == ["paper in the dataset", "clone of paper", "paper"]
    lines = (ROOT / "docs/guide/dataset.md").read_text(encoding="utf-8").split("```python\n")[1].split("```")[0]
    exec(lines.replace("results/datasets", str(folder)).replace("beltarm/randomized/mixed-v0", ID), {})
