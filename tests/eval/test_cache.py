"""Parts that a comparison keeps and does not run again, which methods it runs, and what it does about mistakes."""

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from bundles import SPEC, new_weights
from commands import mistake, stopped
from safetensors.numpy import save

from agents.policy.bundle import POLICIES, save_bundle
from baselines import CONTROLLERS, DOMINATED
from baselines.engines.parallel import SideBySide
from baselines.servo.paper import PaperController
from baselines.tools.files import sealed
from beltarm_env import BeltArmVectorEnv
from beltarm_env.observation import index
from beltarm_env.task.moves import MOVE_FIELDS
from eval import compare
from eval.comparison import cache, provenance
from eval.comparison.cache import Metrics, Part, measure, parts_of, read_kept, run_parts, sensitive
from eval.comparison.carrying import carry
from eval.comparison.methods import classical_methods, learned_methods, privileged_method, shipped_policies
from eval.comparison.rollouts import Failure
from eval.comparison.run import OwnMethods, choose_methods
from eval.comparison.schema import read_results
from eval.comparison.sets import development_set, fresh_set
from eval.comparison.splits import EDITION, VERSION
from eval.report import publish

ALONE = SideBySide(jobs=1)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """No pictures, report and digest, where a test looks at none of them: they take longer than a few episodes."""
    monkeypatch.setattr(provenance, "inputs_digest", lambda *_: "0" * 64)
    monkeypatch.setattr(publish, "plots", lambda *_: {})
    monkeypatch.setattr(publish, "render", lambda *_: "")


def part(method: str = "paper", episodes: int = 4, split: str = "nominal") -> Part:
    known = {known.name: known for known in [*classical_methods(), privileged_method()]}
    known["learned"] = learned_methods(shipped_policies()[:2])[0]
    return Part(known[method], development_set().splits[split], episodes)


def assert_same(results: Sequence[Metrics | Failure], expected: Sequence[Metrics | Failure]) -> None:
    for result, other in zip(results, expected, strict=True):
        assert isinstance(result, dict) and isinstance(other, dict) and set(result) == set(other)
        for name, table in other.items():
            assert result[name].tobytes() == table.tobytes(), name


@pytest.mark.parametrize("method", ["paper", "privileged", "learned"])
def test_splits_and_training_seeds_together_are_each_by_itself_bit_for_bit(method: str):
    several = [part(method, k, split) for k, split in ((4, "randomized"), (3, "nominal"))]
    assert_same(cache.measure_together(several), [measure(single) for single in several])


def test_parts_of_many_scenarios_are_the_batch_bit_for_bit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    whole = part(episodes=9)
    monkeypatch.setattr(cache, "EPISODES", 4)
    cut = parts_of(whole.method, whole.split, 9)
    assert [(each.first, each.count) for each in cut] == [(0, 4), (4, 4), (8, 1)]
    results = [result for result in run_parts(cut, tmp_path, ALONE) if isinstance(result, dict)]
    joined = {name: np.concatenate([result[name] for result in results], 1) for name in results[0]}
    assert_same([joined], [measure(whole)])


class Picky(PaperController):
    """Fails on arms that start where the first of a split does."""

    start = 0.0

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        if np.any(observation[:, index("start")] == self.start):
            raise ValueError("not this arm")
        return super().predict(observation, state, episode_start, deterministic)


def test_a_controller_that_fails_on_a_split_does_so_there_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    several = [part(split=split) for split in ("nominal", "drive", "payload")]
    expected = [measure(several[0]), measure(several[2])]
    start = dict(zip(MOVE_FIELDS, several[1].split.moves[0], strict=True))
    first = BeltArmVectorEnv(1).reset(options={"move": start})[0]
    monkeypatch.setattr(Picky, "start", first[0, index("start")])
    monkeypatch.setitem(CONTROLLERS, "paper", Picky)
    done: list[tuple[int, int]] = []
    nominal, drive, payload = run_parts(several, tmp_path, ALONE, lambda *news: done.append(news))
    assert isinstance(drive, Failure) and drive.split == "drive" and "ValueError: not this arm" in drive.message
    assert_same([nominal, payload], expected)
    assert done == [(0, 3), (1, 3), (2, 3), (3, 3)]
    assert [read_kept(single, tmp_path) is not None for single in several] == [True, False, True]


def test_keys_depend_on_everything_that_the_numbers_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    same = part("zvd")
    others = [
        *(part("zv"), part("zvd", 5), part("zvd", split="payload")),
        replace(same, split=replace(same.split, delays=same.split.delays + 1)),
        replace(same, split=replace(same.split, of="test")),
        replace(same, method=replace(same.method, identity="other gains")),
    ]
    files = {each.file(tmp_path) for each in [same, part("zvd"), *others]}
    assert len(files) == 1 + len(others)
    for name in ("sources_digest", "version", "sha256_of"):  # code, packages, kept gains
        with monkeypatch.context() as patched:
            cache._code.cache_clear()
            patched.setattr(cache, name, lambda *_: "other")
            files.add(same.file(tmp_path))
    cache._code.cache_clear()
    assert len(files) == 4 + len(others)
    build = [lambda: part("zvd").method, lambda: part("ei").method.with_guard(), privileged_method]
    before = [make().identity for make in build]
    monkeypatch.setattr("eval.comparison.methods.read_file", lambda: {"zvd": {"gains": {"angle": 1.0}}})
    assert not {make().identity for make in build} & set(before)


def test_damaged_parts_are_run_again(tmp_path: Path):
    """With any bit changed, cut off anywhere, or with other numbers that somebody wrote."""
    (measured,), path = run_parts([part()], tmp_path, ALONE), part().file(tmp_path)
    sound = path.read_bytes()
    damaged = [b"", b"half", sound[:-200]]
    for place in range(0, len(sound), 29):
        damaged.append(sound[:place] + bytes([sound[place] ^ 1 << place % 8]) + sound[place + 1 :])
    for data in damaged:
        path.write_bytes(data)
        assert read_kept(part(), tmp_path) is None and not path.exists()
    assert isinstance(measured, dict)
    cost = measured["cost"]
    foreign = [save({**measured, "cost": other}) for other in (cost[:, 1:], cost.astype(np.int8), np.nan * cost)]
    for data in (b"no safetensors", *foreign):
        path.write_bytes(sealed(data))
        assert read_kept(part(), tmp_path) is None and not path.exists()
    path.write_bytes(save({**measured, "cost": 0.5 * measured["cost"]}))
    assert_same(run_parts([part()], tmp_path, ALONE), [measured])


def test_outdated_parts_are_taken_away_and_none_of_unknown_or_changed_files_is_kept(tmp_path: Path):
    old, unknown = (replace(part(), method=replace(part().method, identity=name)) for name in ("before", None))
    kept = (part(episodes=5), replace(part(), split=fresh_set(0).splits["nominal"]), part())
    for each in (old, *kept, unknown):
        assert isinstance(run_parts([each], tmp_path, ALONE)[0], dict)
    mine = shutil.copytree(POLICIES / "ppo" / "seed0", tmp_path / "mine")
    changed = replace(part(), method=learned_methods([f"me={mine}"])[0])
    shutil.copytree(POLICIES / "student" / "seed0", mine, dirs_exist_ok=True)
    (refused,) = run_parts([changed], tmp_path, ALONE)
    assert isinstance(refused, Failure) and "changed" in refused.message
    assert {path.name for path in (tmp_path / "parts").iterdir()} == {each.file(tmp_path).name for each in kept}


OWN = """
import os, pathlib, numpy as np
from baselines.servo.paper import PaperController
class Mine(PaperController):
    def predict(self, observation, *rest, **named):
        action, state = super().predict(observation, *rest, **named)
        return SPOILT if len(observation) == 6 else action, state
"""
NOISE = "action * np.float32(np.random.default_rng().uniform(0.9, 1))"
LOG = "[action, pathlib.Path(__file__).with_name('log').write_bytes(os.urandom(9))][0]"


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(("spoilt", "why"), [(NOISE, "when run again"), (LOG, "changed")])
def test_a_controller_that_is_not_repeatable_has_no_row_and_erases_none(spoilt: str, why: str, tmp_path: Path):
    words = "--add mine.py:Mine --methods paper --splits nominal --episodes 6 --jobs 1 --out".split()
    for text, folder, status in (("action", "a", 0), (spoilt, "a", 2), (spoilt, "b", 1)):
        (tmp_path / "mine.py").write_text(OWN.replace("SPOILT", text))
        code, errors = stopped(compare.main, (*words, folder), tmp_path)
        assert code == status and (why in errors) == bool(code)
        rows = read_results(tmp_path / folder / "results.json")["rows"]
        assert [row["method"] for row in rows] == ["paper", "Mine"][: 1 + (folder == "a")]
    assert bool([*(tmp_path / "b" / "parts").glob("*Mine*")]) == (why != "changed")


def test_an_interrupted_run_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    several, ran = [part(split=name) for name in ("nominal", "sensing", "structural")], list[str]()

    def counted(each: Part) -> Metrics:
        if len(ran) == 2:
            raise KeyboardInterrupt
        ran.append(each.split.name)
        return measure(each)

    monkeypatch.setattr(cache, "measure", counted)
    with pytest.raises(KeyboardInterrupt, match="2 of 3 parts"):
        run_parts(several, tmp_path, ALONE)
    ran.pop()
    run_parts(several, tmp_path, ALONE)
    assert len(ran) == len(set(ran)) == 2 and cache.kept_count(several, tmp_path) == 3


RAISES = """
class Raises:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        if len(observation) == 7:
            raise RuntimeError("no such\\nnumber of arms")
        return observation[:, :1] * 0, 0
"""


def test_a_failure_can_be_shown_with_its_whole_traceback(tmp_path: Path):
    (tmp_path / "mine.py").write_text(RAISES)
    options = ("--methods", "Raises", "--splits", "nominal", "--episodes", "7", "--jobs", "1", "--traceback")
    code, errors = stopped(compare.main, ("--add", "mine.py:Raises", *options, "--out", "out"), tmp_path)
    assert code == 2 and f'File "{tmp_path}/mine.py", line 5, in predict\n    raise RuntimeError' in errors
    assert errors.splitlines()[-1].startswith("eval/compare.py: no method could be run: Raises on nominal")


def test_dominated_methods_run_where_they_are_named():
    for name, better in DOMINATED.items():
        assert better in {*CONTROLLERS} - {*DOMINATED}
        assert [method.name for method in choose_methods((name, "paper"))] == ["paper", name]
    assert not {*DOMINATED} & {method.name for method in choose_methods(())}


def test_policies_are_grouped_by_method(tmp_path: Path):
    """`--methods` chooses among the project's own; what `--add` and `--policy` give runs with them."""
    folders: list[Path | str] = [tmp_path / name for name in ("a", "b", "c=d")]
    for folder, base in zip(folders, ("paper", "preview", "paper"), strict=True):
        spec = replace(SPEC, base=base, provenance={"run": {"steps": 5}})
        save_bundle(Path(folder), spec, new_weights(spec))
    methods = learned_methods([*folders, *(f"tried={folder}" for folder in folders[::2])])
    found = [(method.name, method.base, len(method.sources)) for method in methods]
    assert found == [("my-ppo", "paper", 2), ("my-ppo-preview", "preview", 1), ("tried", "paper", 2)]
    assert methods[0].training == {"simulator_steps": [20, 20], "wall_clock_s": [0.0, 0.0]}
    (tmp_path / "mine.py").write_text(RAISES)
    added = (f"{tmp_path}/mine.py:Raises",)
    for chosen, guard, names in (
        (("adaptive",), False, ["adaptive", "my-ppo", "Raises"]),
        (("lqg", "privileged"), True, ["lqg", "lqg+guard", "my-ppo", "my-ppo+guard", "Raises", "privileged"]),
    ):
        methods = choose_methods(chosen, OwnMethods(folders[:1], added), guard=guard)
        assert [method.name for method in methods] == names
    methods = choose_methods(["lqg"], OwnMethods([POLICIES / "ppo" / "seed4"]), seeds=1)
    assert [method.name for method in methods] == ["lqg", "ppo"]


@pytest.mark.usefixtures("undrawn")
def test_a_narrower_run_does_not_replace_what_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def words(methods: str, splits: str, episodes: int, *more: str) -> tuple[str, ...]:
        chosen = ("--methods", *methods.split(), "--splits", *splits.split(), "--episodes", str(episodes))
        return (*chosen, "--jobs", "1", "--out", "out", *more)

    fresh, out, scenarios = ("--scenario-seed", "3"), tmp_path / "out", fresh_set(3)
    assert stopped(compare.main, words("paper zvd", "nominal randomized", 6, *fresh), tmp_path) == (0, "")
    results = read_results(out / "results.json")
    assert results["scenario_set"] == scenarios.label._asdict() and scenarios.label.name == "seed 3"
    assert results["provenance"]["split_seeds"]["nominal"] == scenarios.splits["nominal"].seed
    assert {path.name[:9] for path in (out / "parts").iterdir()} == {"seed-3.no", "seed-3.ra"}
    before = {path: path.read_bytes() for path in out.glob("*.*")}
    for narrower, lost in (
        (words("paper", "nominal randomized", 6, *fresh), "(zvd)"),
        (words("paper zvd", "randomized", 6, *fresh), "(nominal)"),
        (words("paper zvd", "nominal randomized", 4, *fresh), "(6 scenarios per split)"),
        (words("paper zvd", "nominal randomized", 6), f"'seed 3' ({scenarios.label.sha256[:12]}), this run is of"),
    ):
        assert lost in mistake(compare.main, narrower, tmp_path)
    assert {path: path.read_bytes() for path in out.glob("*.*")} == before
    for more, kept in (((), 4), (("--fresh",), 0)):
        wider = words("paper zvd rigid", "nominal randomized", 6, *fresh, *more)
        assert stopped(compare.main, wider, tmp_path) == (0, "")
        assert read_results(out / "results.json")["provenance"]["pairs_kept_before"] == kept
        with monkeypatch.context() as patch:
            patch.setattr("eval.comparison.run.run_parts", Mock(side_effect=KeyboardInterrupt("goes on")))
            assert ("without --fresh" in stopped(compare.main, wider, tmp_path)[1]) == bool(more)


def test_mistakes_are_one_line(tmp_path: Path):
    shutil.copytree(POLICIES / "student" / "seed0", tmp_path / "mine")
    (tmp_path / "paper.py").write_text("class paper:\n    def predict(self, *_, **__):\n        return 1, None\n")
    unlike = {"edition": EDITION, "version": VERSION, "scenario_set": {"name": "development", "sha256": "0000"}}
    contents = {"old": {"edition": EDITION, "version": VERSION + 1}, "first": {"version": 1}, "unlike": unlike}
    for name, text in {**{name: json.dumps(content) for name, content in contents.items()}, "damaged": "{"}.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "results.json").write_text(text)
    for arguments, named in (
        (("--policy", "runs/model.zip"), "runs/model.zip"),
        (("--episodes", "2"), "--episodes"),
        (("--episodes", "501"), "--scenario-seed"),
        (("--episodes", "100001", "--scenario-seed", "1"), "--episodes"),
        (("--jobs", "0"), "--jobs"),
        (("--out", "/dev/null/x"), "/dev/null/x"),
        (("--methods", "papr"), "did you mean 'paper'?"),
        (("--splits", "frictoin"), "did you mean 'friction'?"),
        (("--methods", "privileged"), "--methods"),
        (("--add", "nowhere.py:Mine"), "nowhere.py"),
        (("--add", "paper.py:paper"), "its class"),
        (("--add", "paper.py:Wrong"), "'Wrong'"),
        (("--policy", "student=mine"), "'student'"),
        (("--policy", str(POLICIES / "ppo" / "seed0")), "two seeds of ppo"),
        (("--verify", ".", "--methods", "paper"), "--methods"),
        (("--time-limit", "0"), "--time-limit"),
        (("--scenario-seed", "-1"), "--scenario-seed"),
        (("--scenario-seed", "1", "--scenarios", "development"), "--scenarios development"),
        (("--out", "old", "--methods", "paper"), f"version {VERSION + 1}"),
        (("--out", "first", "--methods", "paper"), "edition 1"),
        (("--out", "unlike", "--methods", "paper"), "'development'"),
        (("--out", "damaged", "--methods", "paper"), "damaged/results.json"),
    ):
        assert named in mistake(compare.main, arguments, tmp_path)


def test_a_full_disk_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(cache, "write_arrays", Mock(side_effect=OSError(28, "No space left on device")))
    arguments = ("--methods", "paper", "--splits", "nominal", "--episodes", "4", "--jobs", "1", "--out", "out")
    assert "No space left on device" in mistake(compare.main, arguments, tmp_path)


def test_an_episode_is_sensitive_from_a_hundredth_of_its_cost_on(tmp_path: Path):
    costs = np.array([100.0, 100.0, 100.0, 300.0])
    assert sensitive(costs, np.array([100.9, 101.1, 98.9, 300.0])).tolist() == [0, 1, 1, 0]
    plain, perturbed = measure(part()), replace(part(), perturbed=True)
    cache.keep(part(), tmp_path, plain)
    assert read_kept(perturbed, tmp_path) is None
    more = measure(perturbed)
    assert more.pop(cache.SENSITIVE).tolist() == [[0.0] * 4]
    assert all(np.array_equal(more[name], plain[name]) for name in plain)


def test_a_folder_is_carried_to_machines_that_lack_it(tmp_path: Path):
    (tmp_path / "own").mkdir()
    (tmp_path / "own/file").write_bytes(b"content")
    carried = carry(tmp_path / "own", [tmp_path / "own/file"])
    assert carried.here() == tmp_path / "own"
    (tmp_path / "own/file").write_bytes(b"another")
    assert (carried.here() / "file").read_bytes() == b"content"
    assert carried.here() == carried.here() != tmp_path / "own"
