"""Splits and sets of scenarios: what they are drawn from, what is kept, and that a changed physics is noticed."""

import json
import re
import subprocess
import tracemalloc
from dataclasses import replace
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import ROOT, mistake
from refusals import refused

from baselines.servo.paper import PaperController
from baselines.tools.provenance import last_commit_of
from beltarm_env import ArmParams
from beltarm_env.arm import DRIVE_EFFECTS, FIELDS
from beltarm_env.rollout import rollout
from beltarm_env.task.ranges import PRESLIDING, SHIFT_RANGES, TRAIN_RANGES
from beltarm_env.task.seeds import DEVELOPMENT, MAX_FRESH_SEED, SeedRange, arms_chosen_by, fresh_arms
from eval import compare
from eval import scenarios as command
from eval.comparison import sets as scenarios
from eval.comparison.cache import LEFT, Part, measure, require_these_arms
from eval.comparison.methods import classical_methods
from eval.comparison.sets import ScenarioSet, choose_set, development_set, fresh_set, load
from eval.comparison.splits import EPISODES, MOVES, SPLITS, VERSION, Split, digest_of, draw

SHIFTED = ("payload", "stiffness", "friction", "drive", "presliding")
SETTINGS = {"sensing": {"encoder_counts": 1000}, "structural": {"model": "lagrangian"}}
SHIFTS = ["shift", *SHIFTED, *SETTINGS]


@pytest.fixture(scope="module")
def splits() -> dict[str, Split]:
    return development_set().splits


def test_every_split_has_its_scenarios_and_they_fill_their_ranges(splits: dict[str, Split]):
    assert list(splits) == ["nominal", "randomized", *SHIFTS] == list(SPLITS)
    for name, split in splits.items():
        assert len(split.table) == len(split.moves) == len(split.delays) == EPISODES == 200
        of_shift = {"moves": MOVES, "randomization": SPLITS[name].ranges} if name in SHIFTS else {}
        assert split.settings == {**SETTINGS.get(name, {}), **of_shift}
        ideal = not split.table[:, [FIELDS.index(effect) for effect in DRIVE_EFFECTS]].any()
        assert ideal == (name == "nominal")
        for field, column in zip(FIELDS, split.table.T, strict=True):
            low, high = SPLITS[name].ranges.get(field, (getattr(ArmParams(), field),) * 2)
            assert np.all((column >= low) & (column <= high)), field
            assert np.ptp(column) > 0.95 * (high - low) or low == high, field


def test_what_is_shifted_is_beyond_training():
    for name in SHIFTED:
        assert SPLITS[name].ranges.keys() == SHIFT_RANGES.keys()
        pairs = [(pair, SHIFT_RANGES[field]) for field, pair in SPLITS[name].ranges.items()]
        shifts = [(own, train) for own, train in pairs if own != train]
        assert shifts and all(own[0] >= train[1] or own[1] <= train[0] for own, train in shifts)


def test_delays_are_continuous_and_each_scenario_has_its_own(splits: dict[str, Split]):
    delays = splits["sensing"].delays
    assert 1 <= delays.min() < 1.02 and 1.98 < delays.max() <= 2 and len(np.unique(delays)) == EPISODES
    assert [name for name, split in splits.items() if split.delays.any()] == ["sensing"]
    assert splits["sensing"].arguments(slice(3, 5))["delay"].tolist() == delays[3:5].tolist()
    assert "delay" not in splits["randomized"].arguments(slice(2))


@pytest.mark.parametrize(
    ("name", "randomization"), [("nominal", "off"), ("randomized", {**TRAIN_RANGES, **PRESLIDING})]
)
def test_scenarios_are_episodes_of_the_environment(name: str, randomization: Any, splits: dict[str, Split]):
    count = 12
    seeded = rollout(PaperController(), count, seed=splits[name].seed, randomization=randomization)
    stored = rollout(PaperController(), count, **splits[name].arguments(slice(count)))
    for field in ("state", "torque", "tip_error", "cost", "params", "moves"):
        assert np.array_equal(getattr(stored, field), getattr(seeded, field))


def test_scenarios_of_shifts_are_those_that_the_environment_draws_on_the_way(splits: dict[str, Split]):
    rows = np.array([5, 2, 111])
    for split in (splits["shift"], splits["structural"]):
        run = rollout(PaperController(), 3, **split.arguments(rows))
        assert run.num_moves == MOVES
        assert np.array_equal(run.params, split.tables[:, rows].reshape(run.params.shape))
        assert np.array_equal(run.moves, split.all_moves[:, rows].reshape(run.moves.shape))
    masses = splits["shift"].tables[:, :, FIELDS.index("payload_mass")]
    assert not masses[1::2].any() and masses[::2].min() >= 0.05 and len(np.unique(masses[::2])) == masses[::2].size


def test_a_scenario_of_a_shift_is_averaged_over_its_moves(splits: dict[str, Split]):
    paper, split = next(method for method in classical_methods() if method.name == "paper"), splits["shift"]
    measured, run = measure(Part(paper, split, 2)), rollout(PaperController(), 2, **split.arguments(slice(2)))
    for name in ("cost", "still_s"):
        assert measured[name][0] == pytest.approx(run.metrics()[name].reshape(MOVES, 2).mean(axis=0))
    assert not measured[LEFT].any()
    assert measure(Part(paper, split.part(slice(1, 2)), 1))["cost"][0, 0] == measured["cost"][0, 1]
    short = split.shortened(2)
    assert short.digest != split.digest and short.settings["moves"] == len(short.tables) == 2
    first = run.cost.reshape(MOVES, 2)[:2].mean(axis=0)
    assert measure(Part(paper, short, 2))["cost"][0] == pytest.approx(first, rel=1e-12)
    assert splits["nominal"].shortened(2) is splits["nominal"]


def test_a_shift_that_an_arm_leaves_is_of_the_scenario_as_far_as_it_went(splits: dict[str, Split]):
    class Pushing:
        def predict(self, observation: Any, *_: Any, **__: Any) -> Any:
            return np.ones((len(observation), 1), np.float32), None

    split, rows = splits["shift"].shortened(3), np.array([4, 9])
    run = rollout(Pushing(), 2, **split.arguments(rows))
    assert not run.finished.any() and not np.array_equal(run.params, split.tables[:, rows].reshape(run.params.shape))
    require_these_arms(run, split, rows)
    refused(ValueError, ("not those of the scenarios",), lambda: require_these_arms(run, split, rows[::-1]))


def test_no_two_splits_of_any_sets_share_an_arm_or_a_move():
    """By their seeds, and by what is drawn; the test set's are left alone."""
    sets = [(development_set(), DEVELOPMENT), *((fresh_set(k), fresh_arms(k)) for k in (0, 1, MAX_FRESH_SEED))]
    for split, other in combinations([split for each, _ in sets for split in each.splits.values()], 2):
        assert abs(split.seed - other.seed) >= EPISODES
        assert not np.intersect1d(split.moves[:, 0], other.moves[:, 0]).size
    for each, seeds in sets:
        for split in each.splits.values():
            assert seeds.first <= split.seed <= split.seed + EPISODES <= seeds.first + seeds.size
    assert len({each.label.sha256 for each, _ in sets}) == len(sets)


def test_the_development_set_is_run_until_the_test_set_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    refused(ValueError, ("10000", "9999"), lambda: draw("structural", "x", SeedRange(0, 9999)))
    monkeypatch.setattr(scenarios, "FILE", tmp_path / "scenarios.json")
    assert (choose_set().label.name, choose_set(seed=3).label.name) == ("development", "seed 3")
    assert "scenarios.json" in mistake(compare.main, ("--scenarios", "test"), tmp_path)
    for name, seed in (("development", 3), ("best", None), (None, -1), (None, MAX_FRESH_SEED + 1)):
        refused(ValueError, ("--scenario",), lambda seed=seed, name=name: choose_set(name, seed))


MADE_UP = "00c0ffee" + "0" * 32


@pytest.fixture(scope="module")
def frozen(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A test set of a few scenarios, as another protocol's commit would choose them."""
    path = tmp_path_factory.mktemp("frozen") / "scenarios.json"
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(scenarios, "draw_set", few_drawn)
        patched.setattr(scenarios, "last_commit_of", lambda _: MADE_UP)
        scenarios.freeze_test_set(path)
    return path


@cache
def few_drawn(name: str, seeds: SeedRange) -> ScenarioSet:
    return scenarios.make_set(name, {split: draw(split, name, seeds).part(slice(4)) for split in SPLITS})


def test_a_test_set_is_read_as_written_and_frozen_once(frozen: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    read, drawn = load(frozen), few_drawn("test", arms_chosen_by(MADE_UP))
    monkeypatch.setattr(scenarios, "FILE", frozen)
    assert choose_set().label == choose_set("test").label == read.label == drawn.label
    assert "scenarios.json" in mistake(command.main, ("--freeze-test",), tmp_path)
    assert scenarios.text_of(scenarios.content_of(read, MADE_UP)) == frozen.read_text(encoding="utf-8")


PROTOCOL = (ROOT / "docs" / "benchmark" / "protocol.md").read_text(encoding="utf-8")
CHANGES = "## Changes made after the results"


def git(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)


def test_the_protocol_is_that_of_the_commit_which_chose_the_seeds():
    """But for what its last section lists."""
    commit = json.loads(scenarios.FILE.read_text())["protocol"]
    then = git("show", f"{commit}:docs/benchmark/protocol.md")
    if then.returncode:
        pytest.skip("the history is not here")
    assert PROTOCOL.split(CHANGES)[0] == then.stdout.split(CHANGES)[0]
    assert not git("ls-tree", commit, "eval/comparison/scenarios.json").stdout
    assert len(last_commit_of(ROOT / "LICENSE")) == 40


def test_protocol_lists_commits_that_are_there():
    named = sorted(set(re.findall(r"\b(?=[0-9a-f]*\d)[0-9a-f]{7,8}\b", PROTOCOL.split(CHANGES)[1])))
    results = json.loads((ROOT / "docs/results/comparison/results.json").read_text(encoding="utf-8"))
    assert results["provenance"]["commit"] in named
    if git("rev-parse", "--is-shallow-repository").stdout.strip() != "false":
        pytest.skip("the history is not there")
    assert not [commit for commit in named if git("merge-base", "--is-ancestor", commit, "HEAD").returncode]


def rehashed(content: dict[str, Any], **changes: Any) -> dict[str, Any]:
    rest = {key: value for key, value in {**content, **changes}.items() if key != "sha256"}
    return {**rest, "sha256": digest_of(rest)}


def counted(content: dict[str, Any], count: object) -> dict[str, Any]:
    content["splits"]["randomized"]["count"] = count
    return content


def test_damaged_files_are_refused(frozen: Path, tmp_path: Path):
    for damage, message in (
        (lambda c: {**c, "format": "x"}, "no file of beltarm-scenarios"),
        (lambda c: rehashed(c, version=VERSION + 1), f"has version {VERSION + 1}"),
        (lambda c: [c], "no file of beltarm-scenarios"),
        (lambda c: counted(c, 3), "SHA-256 does not match"),
        (lambda c: rehashed(counted(c, 3)), "SHA-256 of randomized does not match"),
        (lambda c: rehashed(c, protocol="1" * 40), "not the one that the protocol's commit"),
        (lambda c: rehashed(c, protocol="abc"), "hash of a commit has 40 hexadecimal digits"),
        (lambda c: rehashed({key: c[key] for key in ("format", "version")}), "KeyError"),
        (lambda c: rehashed(counted(c, 100_000 * "x")), "number of scenarios"),
        (lambda c: json.dumps(c)[:1000], "cannot be read"),
    ):
        path, content = tmp_path / "scenarios.json", damage(json.loads(frozen.read_text()))
        path.write_text(content if isinstance(content, str) else json.dumps(content))
        tracemalloc.start()
        try:
            with pytest.raises(ValueError, match=message) as caught:
                load(path)
            assert tracemalloc.get_traced_memory()[1] < max(20 * path.stat().st_size, 1e6)
        finally:
            tracemalloc.stop()
        assert "restore scenarios.json" in str(caught.value) and "\n" not in str(caught.value)


def test_a_changed_physics_is_noticed():
    known = choose_set("test")
    split = known.splits["nominal"]
    changes: list[dict[str, Any]] = [{"settings": {"model": "lagrangian"}}, {"settings": {"encoder_counts": 3999}}]
    for field in ("coulomb_friction", "belt_stiffness"):
        changes.append({"tables": split.tables * np.where(np.array(FIELDS) == field, 1 + 1e-4, 1)})
    for change in changes:
        with pytest.raises(ValueError, match=r"arms move otherwise.*raise VERSION in eval/comparison/splits.py"):
            scenarios.require_same_physics(ScenarioSet(known.label, {"nominal": replace(split, **change)}))
    scenarios.require_same_physics(fresh_set(0).only(["nominal", "sensing"]))  # which is checked by the test set
    scenarios.require_same_physics(choose_set("test").only(["sensing"], moves=2))
