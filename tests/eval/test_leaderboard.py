"""The leaderboard: what is packed, refused, run again and shown."""

from __future__ import annotations

import hashlib
import json
import shutil
import stat
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
import torch
from commands import mistake, stopped
from eval.comparison.pairs import LEFT, Nudged
from jsonschema import Draft202012Validator

from agents.policy.bundle import POLICIES
from baselines import CONTROLLERS
from beltarm_env.rollout import rollout
from eval import submit
from eval.comparison.run import choose_methods, compare
from eval.comparison.schema import write_results
from eval.comparison.sets import DEVELOPMENT_NAME, development_set
from eval.leaderboard import entries, sealed
from eval.leaderboard.archive import MAX_BYTES, archived, extract, read_archive
from eval.leaderboard.entries import SEALED, TEST, add_archive, add_result, read_entries
from eval.leaderboard.packing import pack
from eval.leaderboard.scores import QUANTITIES, first_difference, largest_difference, over_all_splits, score
from eval.leaderboard.submission import MANIFEST as SUBMISSION
from eval.leaderboard.submission import RESULTS, SCHEMA, Rules, Submission, read
from eval.leaderboard.table import NONE, table
from eval.leaderboard.verification import require_trust, rerun
from eval.report.readme import updated

ROOT = Path(__file__).resolve().parents[2]
RULES = Rules(development_set().only(["nominal", "randomized"]), 4, ("paper", "rigid"))
CLEAN = "abc1234"
CONTROLLER = """
import numpy as np
from pathlib import Path
from gains import GAIN
if (marker := Path({marker!r})).parent.exists():
    marker.touch()
class Mine:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return (GAIN * observation[:, :1]).astype(np.float32), None
"""


@dataclass(frozen=True)
class Made:
    """What a user has who submits."""

    folder: Path  # that eval/compare.py ran in
    results: Path
    marker: Path  # there as soon as the controller was imported


def compared(results: Path, policies: list[str], added: list[str], rules: Rules = RULES) -> None:
    """Compare a method of one's own as `eval/compare.py` does in the current folder, on a clean commit."""
    given = [*(f"--policy={policy}" for policy in policies), *(f"--add={spec}" for spec in added)]
    with (
        patch("sys.argv", [str(ROOT / "eval/compare.py"), *given]),
        patch("eval.comparison.results.commit", lambda: CLEAN),
    ):
        methods = choose_methods(("Mine" if added else "mine", *rules.references), policies, added, results)
        write_results(compare(methods, rules.scenarios, rules.episodes, results, 1), results)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    folder = tmp_path_factory.mktemp("user")
    torch.set_num_threads(1)
    (folder / "own").mkdir()
    (folder / "own" / "mine.py").write_text(CONTROLLER.format(marker=str(folder / "imported")))
    (folder / "own" / "gains.py").write_text("GAIN = 0.5\n")
    with pytest.MonkeyPatch.context() as context:
        context.chdir(folder)
        compared(folder / "own" / "results", [], ["own/mine.py:Mine"])
    (folder / "imported").unlink()
    return Made(folder, folder / "own" / "results", folder / "imported")


@pytest.fixture
def there(made: Made, monkeypatch: pytest.MonkeyPatch) -> Made:
    """The same, in the user's folder."""
    monkeypatch.chdir(made.folder)
    return made


@pytest.fixture(scope="module")
def submission(made: Made) -> Submission:
    with pytest.MonkeyPatch.context() as context:
        context.chdir(made.folder)
        return pack(made.results, "Ada Lovelace", RULES)


@pytest.fixture(scope="module")
def found(submission: Submission) -> dict[str, Any]:
    """What the submission scores when it is run again."""
    return rerun(submission, RULES, 1)


# Packing


def test_a_submission_holds_what_was_run_and_its_hashes(submission: Submission, made: Made):
    assert set(submission.files) == {SUBMISSION, RESULTS, "controller/mine.py", "controller/gains.py"}
    assert submission.files[RESULTS] == (made.results / RESULTS).read_bytes()
    assert submission.content["files"] == {
        name: hashlib.sha256(data).hexdigest() for name, data in submission.files.items() if name != SUBMISSION
    }
    assert (submission.method, submission.content["author"]) == ("Mine", "Ada Lovelace")
    assert submission.results["provenance"]["commit"] == CLEAN
    assert {*submission.scores} == {"Mine", *RULES.references}
    rows = {(row["method"], row["split"]): row for row in submission.results["rows"]}
    for (method, split), row in rows.items():
        scores = submission.scores[method][split]
        assert scores["iqm"] == row["metrics"]["cost"]["iqm"]
        assert scores["worst"] >= scores["mean"] > 0
        assert scores["not_settled"] == row["failures"]["not_settled"] / row["failures"]["runs"]


def test_the_same_submission_has_the_same_bytes(submission: Submission, there: Made, tmp_path: Path):
    again = pack(there.results, "Ada Lovelace", RULES)
    first, second = add_archive(submission, tmp_path / "a"), add_archive(again, tmp_path / "b")
    assert first.read_bytes() == second.read_bytes()
    assert first.name == second.name == f"Mine-{hashlib.sha256(first.read_bytes()).hexdigest()[:8]}.zip"


def test_nothing_is_executed_by_packing_and_reading(there: Made, tmp_path: Path):
    path = add_archive(pack(there.results, "Ada", RULES), tmp_path)
    read(path, RULES)
    assert not there.marker.exists()


@pytest.mark.slow
def test_a_policy_is_packed_as_data_and_verified_without_trust(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(POLICIES / "ppo" / "seed0", "best")
    shutil.copytree(POLICIES / "ppo" / "seed1", "other")
    rules = Rules(RULES.scenarios.only(["nominal"]), 2, ("paper",))
    compared(tmp_path / "results", ["mine=best", "mine=other"], [], rules)
    submission = pack(tmp_path / "results", "Ada", rules)
    assert submission.content["sources"] == ["policies/0", "policies/1"]
    assert sorted({Path(name).suffix for name in submission.files}) == [".json", ".safetensors"]
    require_trust(submission, False, "mine.zip")
    assert rerun(submission, rules, 1) == submission.scores


def test_other_files_than_those_that_ran_are_refused(there: Made, monkeypatch: pytest.MonkeyPatch):
    gains = there.folder / "own" / "gains.py"
    gains.write_text("GAIN = 0.25\n")
    with pytest.raises(ValueError, match=r"does not keep the runs of Mine on nominal .* run the same command again"):
        pack(there.results, "Ada", RULES)
    gains.write_text("GAIN = 0.5\n")
    pack(there.results, "Ada", RULES)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda r: r["provenance"].update(commit="abc-dirty"), "results of the commit 'abc-dirty': commit or undo"),
        (lambda r: r["provenance"].update(commit="unknown"), "results of the commit 'unknown'"),
        (lambda r: r["scenario_set"].update(name="seed 1"), "results of the scenarios 'seed 1': run it with"),
        (lambda r: r["provenance"].update(computing_time=True), "in which computing time counts"),
        (lambda r: r["rows"][-1].update(split="ideal"), "has no results of Mine on randomized: run all splits"),
        (lambda r: r["rows"][0].update(episodes=3), "has 3 scenarios of nominal, the leaderboard takes all 4"),
        (lambda r: r["provenance"].update(command="python eval/compare.py"), "the project's own methods alone"),
        (lambda r: r["provenance"].update(command="python '"), "a command that cannot be read"),
        (lambda r: r["provenance"].update(command="x --add gone.py:Mine"), "--add gone.py:Mine, which is no file here"),
        (lambda r: r["provenance"].update(command="x --add own.mine:Mine"), "name it as path/to/file.py:Class"),
        (
            lambda r: r["failures"].append({"method": "Mine", "split": "nominal", "message": "it fell"}),
            "'Mine' failed on 'nominal': 'it fell'",
        ),
    ],
)
def test_results_that_break_the_rules_are_not_packed(spoil: Callable[[Any], object], message: str, there: Made):
    kept = (there.results / RESULTS).read_text()
    results = json.loads(kept)
    spoil(results)
    (there.results / RESULTS).write_text(json.dumps(results))
    try:
        with pytest.raises(ValueError, match=r".+") as caught:
            pack(there.results, "Ada", RULES)
    finally:
        (there.results / RESULTS).write_text(kept)
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_results_of_the_development_set_are_refused(there: Made):
    label = RULES.scenarios.label._replace(name="test")
    rules = Rules(type(RULES.scenarios)(label, RULES.scenarios.splits), RULES.episodes)
    with pytest.raises(ValueError, match=f"'{DEVELOPMENT_NAME}', on which controllers .* run it with --scenarios test"):
        pack(there.results, "Ada", rules)


@pytest.mark.parametrize("author", ["", "[a](http://x)", "a|b", "a\nb", "<b>", "x" * 101])
def test_an_author_is_a_name(author: str, there: Made):
    with pytest.raises(ValueError, match="--author must be a name"):
        pack(there.results, author, RULES)


# Damaged, and made up


def resealed(files: dict[str, bytes]) -> None:
    """Write the hashes that files have by now, as somebody would who wants to deceive."""
    content = json.loads(files[SUBMISSION])
    content["files"] = {name: hashlib.sha256(data).hexdigest() for name, data in files.items() if name != SUBMISSION}
    files[SUBMISSION] = json.dumps(content).encode()


def edit(name: str, change: Callable[[Any], object]) -> Callable[[dict[str, bytes]], None]:
    """Change a JSON file of a submission, and all hashes with it."""

    def spoil(files: dict[str, bytes]) -> None:
        content = json.loads(files[name])
        change(content)
        files[name] = json.dumps(content).encode()
        resealed(files)

    return spoil


def put(name: str, content: bytes) -> Callable[[dict[str, bytes]], object]:
    return lambda files: files.update({name: content})


DAMAGED = {
    "controller changed": (put("controller/gains.py", b"GAIN = 9\n"), "controller/gains.py has the SHA-256"),
    "results changed": (put(RESULTS, b"{}"), "results.json has the SHA-256"),
    "file missing": (lambda f: f.pop("controller/gains.py"), "'controller/gains.py' is missing, it is named in"),
    "file more": (put("controller/more.py", b""), "'controller/more.py' is not named in submission.json"),
    "no manifest": (lambda f: f.pop(SUBMISSION), "has no submission.json"),
    "half a manifest": (lambda f: f.update({SUBMISSION: f[SUBMISSION][:50]}), "submission.json is damaged"),
    "deep manifest": (put(SUBMISSION, b"[" * 100_000), "submission.json is damaged"),
    "no text": (put(SUBMISSION, b"\xff"), "submission.json is damaged"),
    "format": (edit(SUBMISSION, lambda c: c.update(format_version=2)), "format_version: 1 was expected"),
    "author": (edit(SUBMISSION, lambda c: c.update(author="<b>")), "author: '<b>' does not match"),
    "escapes": (edit(SUBMISSION, lambda c: c.update(author="\x1b[2J")), "has characters that cannot be shown"),
    "more entries": (edit(SUBMISSION, lambda c: c.update(run="rm")), "Additional properties are not allowed"),
    "no sources": (edit(SUBMISSION, lambda c: c.pop("sources")), "sources must be there"),
    "hash": (lambda f: f.update({SUBMISSION: f[SUBMISSION].replace(b'.py": "', b'.py": "x')}), "does not match"),
    "not finite": (
        lambda f: f.update({SUBMISSION: f[SUBMISSION].replace(b'"iqm": ', b'"iqm": NaN, "was": ', 1)}),
        "submission.json",
    ),
    "negative": (
        edit(SUBMISSION, lambda c: c["scores"]["Mine"]["nominal"].update(mean=-1)),
        "mean: -1 is less than or equal to the minimum of 0",
    ),
    "better score": (
        edit(SUBMISSION, lambda c: c["scores"]["Mine"]["nominal"].update(iqm=1.0)),
        "do not agree about the cost of Mine on nominal",
    ),
    "other methods": (edit(SUBMISSION, lambda c: c["scores"].pop("rigid")), "must have scores of Mine, paper, rigid"),
    "other source": (
        edit(SUBMISSION, lambda c: c.update(sources=["controller/../../x.py:Mine"])),
        "has no 'controller/../../x.py:Mine'",
    ),
    "other class": (edit(SUBMISSION, lambda c: c.update(sources=["controller/mine.py:Other"])), "has no"),
    "kind": (edit(SUBMISSION, lambda c: c.update(kind="learned")), "do not agree about the kind of Mine"),
    "own method": (edit(SUBMISSION, lambda c: c.update(method="adaptive")), "one of the project's own methods"),
    "dirty": (edit(RESULTS, lambda c: c["provenance"].update(commit="abc-dirty")), "the commit 'abc-dirty'"),
    "edition": (edit(RESULTS, lambda c: c.update(edition=1)), "another edition or version"),
    "fewer": (edit(RESULTS, lambda c: c["rows"][0].update(episodes=3)), "has 3 scenarios"),
    "no rows": (edit(RESULTS, lambda c: c.update(rows=[])), "has no results of Mine on nominal"),
    "spoilt results": (edit(RESULTS, lambda c: c.pop("rows")), "rows must be there"),
}


@pytest.mark.parametrize("damage", DAMAGED)
def test_each_damage_is_refused_in_one_line(damage: str, submission: Submission, tmp_path: Path):
    spoil, message = DAMAGED[damage]
    files = dict(submission.files)
    spoil(files)
    path = tmp_path / "mine.zip"
    path.write_bytes(archived(files, "mine"))
    with pytest.raises(ValueError, match=r".+") as caught:
        read(path, RULES)
    assert message in str(caught.value) and "mine.zip" in str(caught.value)
    assert str(caught.value).isprintable() and len(str(caught.value)) < 500


def test_the_schema_is_a_schema(submission: Submission):
    Draft202012Validator.check_schema(SCHEMA)
    Draft202012Validator(SCHEMA).validate(submission.content)


# Archives


def zipped(path: Path, *members: tuple[str | zipfile.ZipInfo, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members:
            archive.writestr(name, content)
    return path


NAMES = ["../x.py", "a/../../x.py", "/x.py", "C:\\x.py", "C:/x.py", "a//x.py", ".git/hooks", "a/./x", "x\n.py", "é.py"]


@pytest.mark.parametrize("name", [*NAMES, "x" * 101, "a/.x.py"])
def test_a_name_that_leads_elsewhere_is_refused(name: str, tmp_path: Path):
    path = zipped(tmp_path / "mine.zip", (name, b"1"))
    with pytest.raises(ValueError, match=r"mine.zip has a file .*rename it") as caught:
        read_archive(path)
    assert "\n" not in str(caught.value)
    with pytest.raises(ValueError, match="rename it"):
        extract({name: b"1"}, tmp_path / "out")
    assert not (tmp_path / "x.py").exists() and not (tmp_path / "out").exists()


def special(kind: int) -> zipfile.ZipInfo:
    member = zipfile.ZipInfo("link")
    member.create_system, member.external_attr = 3, (kind | 0o777) << 16
    return member


@pytest.mark.parametrize("kind", [stat.S_IFLNK, stat.S_IFCHR, stat.S_IFIFO, stat.S_IFDIR])
def test_only_regular_files_are_read(kind: int, tmp_path: Path):
    with pytest.raises(ValueError, match="'link', which is no regular file"):
        read_archive(zipped(tmp_path / "mine.zip", (special(kind), b"/etc/passwd")))


@pytest.mark.parametrize("names", [["a/"], ["a", "A"], ["a", "a/b"], [f"f{k}" for k in range(201)]])
def test_folders_doubles_and_crowds_are_refused(names: list[str], tmp_path: Path):
    with pytest.raises(ValueError, match=r"mine.zip has .*(no regular file|twice|inside another|at most 200)"):
        read_archive(zipped(tmp_path / "mine.zip", *((name, b"") for name in names)))


def test_what_unpacks_to_too_much_is_refused(tmp_path: Path):
    path = zipped(tmp_path / "mine.zip", ("zeros", bytes(MAX_BYTES + 1)))
    assert path.stat().st_size < 100_000
    with pytest.raises(ValueError, match=f"has {MAX_BYTES + 1} bytes, at most {MAX_BYTES} are allowed"):
        read_archive(path)


def test_a_size_that_is_not_true_is_refused(tmp_path: Path):
    path = zipped(tmp_path / "mine.zip", ("zeros", bytes(3 * MAX_BYTES)))
    true, told = (size.to_bytes(4, "little") for size in (3 * MAX_BYTES, 10))
    path.write_bytes(path.read_bytes().replace(true, told))
    with pytest.raises(ValueError, match=r"mine.zip cannot be read \(Bad CRC"):
        read_archive(path)


@pytest.mark.parametrize("content", [b"", b"no archive", None])
def test_what_is_no_archive_is_refused(content: bytes | None, tmp_path: Path):
    if content is not None:
        (tmp_path / "mine.zip").write_bytes(content)
    with pytest.raises(ValueError, match=r"mine.zip cannot be read .*: a submission is a ZIP file"):
        read_archive(tmp_path / "mine.zip")


def test_a_cut_archive_is_refused(submission: Submission, tmp_path: Path):
    whole = archived(submission.files, "mine")
    (tmp_path / "mine.zip").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match="cannot be read"):
        read_archive(tmp_path / "mine.zip")


# Verification


def test_a_controller_is_a_strangers_code(submission: Submission):
    with pytest.raises(ValueError, match=r"its author's code with all your rights \(.*mine.py.*--trust"):
        require_trust(submission, False, "mine.zip")
    require_trust(submission, True, "mine.zip")


@pytest.mark.slow
def test_what_is_run_again_scores_the_same(submission: Submission, found: dict[str, Any], made: Made):
    assert found == submission.scores
    assert made.marker.exists()  # run again, it is executed
    made.marker.unlink()
    assert first_difference(submission.scores, found) is None
    assert largest_difference(submission.scores, found).size == 0


def test_the_first_difference_is_named(submission: Submission, found: dict[str, Any]):
    told = json.loads(json.dumps(submission.scores))
    told["Mine"]["randomized"]["worst"] *= 0.5
    told["rigid"]["randomized"]["iqm"] *= 0.99
    wrong = first_difference(told, found)
    assert wrong is not None
    assert wrong.words.startswith("Mine on randomized, mean cost of the worst 5 %: submitted ")
    assert wrong.words.endswith("100 % of it apart; at most 2 % is allowed")
    told["Mine"] = submission.scores["Mine"]
    assert (wrong := first_difference(told, found)) and wrong[:3] == ("rigid", "randomized", "iqm")
    told["rigid"]["randomized"]["iqm"] = found["rigid"]["randomized"]["iqm"] * 1.002
    assert first_difference(told, found) is None


def test_what_a_processor_rounds_is_allowed():
    """More than it rounds: first torques that differ by 1e-9 N m."""
    split, scores = RULES.scenarios.splits["randomized"], []
    for wrapped in (lambda controller: controller, Nudged):
        run = rollout(wrapped(CONTROLLERS["flat"]()), 50, **split.arguments(slice(50)))
        metrics: Any = {**run.metrics(), LEFT: 1.0 - run.finished}
        scores.append({"flat": {"randomized": score(metrics)}})
    assert 0 < largest_difference(*scores).excess < 0.5


def test_a_submission_that_fails_here_is_named(submission: Submission):
    files = {**submission.files, "controller/mine.py": b"class Mine:\n    def predict(self, *_, **__): return 1 / 0\n"}
    with pytest.raises(ValueError, match=r"does not keep the protocol .*ZeroDivisionError"):
        rerun(Submission(submission.content, submission.results, files), RULES, 1)


# The table


@pytest.fixture
def board(submission: Submission, found: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A leaderboard with one entry."""
    folder = tmp_path / "leaderboard"
    add_result(add_archive(submission, folder), TEST, RULES, found, "B. Verifier")
    return folder


def test_the_table_shows_what_was_verified(board: Path, submission: Submission):
    (entry,) = read_entries(board, RULES)
    lines = table([entry], "leaderboard").splitlines()
    (mine,) = [line for line in lines if "**Mine**" in line]
    cells = [cell.strip() for cell in mine.strip("|").split("|")]
    scores = submission.scores["Mine"]["randomized"]
    assert cells[:6] == [
        "**Mine**",
        "Ada Lovelace",
        "controller",
        *(f"{scores[q]:.0f}" for q in ("iqm", "mean", "worst")),
    ]
    assert float(cells[6]) == pytest.approx(over_all_splits(submission.scores, "Mine", "paper"), abs=0.005)
    assert cells[7].startswith("B. Verifier, 20")
    digest = hashlib.sha256(next(board.glob("*.zip")).read_bytes()).hexdigest()
    assert cells[8] == f"[`{digest[:12]}`](leaderboard/Mine-{digest[:8]}.zip)"
    assert [line for line in lines if line.startswith("| paper | this project | reference |") and " 1.00 |" in line]
    assert len({line.count("|") for line in lines}) == 1


def test_the_sealed_set_has_columns_of_its_own_once_it_was_run(board: Path, found: dict[str, Any]):
    better = {method: {split: {**s, "iqm": s["iqm"] / 2} for split, s in of.items()} for method, of in found.items()}
    archive = next(board.glob("*.zip"))
    add_result(archive, SEALED, RULES, better, "B. Verifier")
    (entry,) = read_entries(board, RULES)
    assert entry.scores() == found and entry.scores(SEALED) == better
    lines = table([entry], "leaderboard").splitlines()
    assert "sealed: IQM" in lines[0] and len({line.count("|") for line in lines}) == 1


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda r: r["test"]["scores"]["Mine"]["nominal"].update(iqm=1.0), "does not agree with its archive: Mine"),
        (lambda r: r["test"]["scores"].pop("rigid"), "has no scores of 'rigid'"),
        (lambda r: r.update(sha256="0" * 64), "is of another archive"),
        (lambda r: r["test"].update(by="<b>"), "by: '<b>' does not match"),
        (lambda r: r["test"]["scenario_set"].update(name="seed 1"), "of other scenarios than the test set"),
        (lambda r: r.update(more=1), "Additional properties"),
        (lambda r: r.pop("test"), "test must be there"),
    ],
)
def test_an_entry_that_is_not_of_its_archive_is_refused(spoil: Callable[[Any], object], message: str, board: Path):
    path = next(board.glob("*.json"))
    record = json.loads(path.read_text())
    spoil(record)
    path.write_text(json.dumps(record))
    with pytest.raises(ValueError, match=r".+") as caught:
        read_entries(board, RULES)
    assert message in str(caught.value)


def test_an_entry_without_its_archive_is_refused(board: Path):
    next(board.glob("*.zip")).unlink()
    with pytest.raises(ValueError, match="or there is none: verify it again"):
        read_entries(board, RULES)


def test_the_committed_page_is_what_the_command_writes():
    page = submit.PAGE.read_text(encoding="utf-8")
    assert page == updated(page, {"table": table(read_entries(submit.FOLDER), submit.FOLDER.name)})
    for quantity in QUANTITIES.values():
        assert f"{100 * quantity.tolerance:g} %" in page.split("## Verify")[1].split("\n## ")[0]


def test_every_committed_archive_keeps_the_rules():
    for path in submit.FOLDER.glob("*.zip"):
        read(path, entries.board_rules())


# The command


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A leaderboard of its own, with small rules, on a clean commit."""
    page = tmp_path / "leaderboard.md"
    page.write_text("# Here\n\n<!-- table: begin -->\n\n<!-- table: end -->\n")
    monkeypatch.setattr(submit, "PAGE", page)
    monkeypatch.setattr(submit, "FOLDER", tmp_path / "leaderboard")
    for module in (submit, entries):
        monkeypatch.setattr(module, "board_rules", lambda: RULES)
    monkeypatch.setattr(entries, "commit", lambda: CLEAN)
    return tmp_path


def test_from_results_to_the_table(desk: Path, made: Made, capsys: pytest.CaptureFixture[str]):
    assert stopped(submit.main, (str(made.results), "--author", "Ada"), made.folder) == (0, "")
    (archive,) = (desk / "leaderboard").glob("*")
    said = capsys.readouterr().out
    assert "controller/gains.py" in said and hashlib.sha256(archive.read_bytes()).hexdigest() in said
    verify = ("--verify", str(archive), "--jobs", "1")
    assert "say so with --trust" in mistake(submit.main, verify, desk)
    assert stopped(submit.main, ("--table",), desk) == (0, "")
    assert NONE in submit.PAGE.read_text()  # what is not verified is not shown
    assert stopped(submit.main, (*verify, "--trust", "--by", "B. Verifier"), desk) == (0, "")
    assert "comes out again, all scores the same" in capsys.readouterr().out
    page = submit.PAGE.read_text()
    assert "B. Verifier" in page and "| **Mine** | Ada | controller |" in page
    assert stopped(submit.main, ("--table",), desk) == (0, "")
    assert submit.PAGE.read_text() == page


def test_what_does_not_come_out_again_is_said_in_one_line(
    desk: Path, submission: Submission, found: dict[str, Any], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(submit, "rerun", lambda *_: found)
    files = dict(submission.files)

    def cheaper(content: dict[str, Any]) -> None:
        for row in content["rows"]:
            row["metrics"]["cost"]["iqm"] *= 0.5 if row["method"] == "Mine" else 1

    edit(RESULTS, cheaper)(files)
    edit(SUBMISSION, lambda c: [s.update(iqm=0.5 * s["iqm"]) for s in c["scores"]["Mine"].values()])(files)
    archive = desk / "mine.zip"
    archive.write_bytes(archived(files, "mine"))
    code, errors = stopped(submit.main, ("--verify", "mine.zip", "--trust", "--by", "B", "--jobs", "1"), desk)
    assert code == 1
    (line,) = errors.splitlines()
    assert "mine.zip does not come out again: Mine on nominal, interquartile mean of the cost: submitted" in line
    assert "100 % of it apart" in line
    assert not archive.with_suffix(".json").exists()


def test_the_sealed_set_is_for_those_that_were_there(
    desk: Path, submission: Submission, found: dict[str, Any], monkeypatch: pytest.MonkeyPatch
):
    archive = add_archive(submission, desk / "leaderboard")
    ask = ("--verify", str(archive), "--trust", "--by", "B", "--sealed", "--jobs", "1")
    monkeypatch.setattr(submit, "rerun", lambda *_: found)
    monkeypatch.setattr(sealed, "sealed_set", lambda: RULES.scenarios)
    monkeypatch.setattr(entries, "EPISODES", RULES.episodes)
    monkeypatch.setattr(sealed, "read", lambda: {"submissions": []})
    assert "not verified on the test set yet" in mistake(submit.main, ask, desk)
    add_result(archive, TEST, RULES, found, "B")
    assert "came after the sealed set was revealed" in mistake(submit.main, ask, desk)
    monkeypatch.setattr(sealed, "read", lambda: {"submissions": [entries.sha256_of(archive)]})
    assert stopped(submit.main, ask, desk) == (0, "")
    assert "sealed: IQM" in submit.PAGE.read_text()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "give the folder of a comparison to pack it, or --verify FILE, or --table"),
        (("results", "--table"), "give the folder of a comparison"),
        (("--table", "--trust"), "go with --verify FILE"),
        (("nowhere", "--author", "Ada"), "cannot be read"),
        (("nowhere",), "--author must be a name"),
        (("--verify", "gone.zip"), "gone.zip cannot be read"),
        (("--table", "--jobs", "0"), "--jobs must lie within 1 and 256, got 0"),
    ],
)
def test_mistakes_on_the_command_line(arguments: tuple[str, ...], message: str, desk: Path):
    assert message in mistake(submit.main, arguments, desk)


def test_a_verification_is_recorded_on_a_clean_commit(
    desk: Path, submission: Submission, monkeypatch: pytest.MonkeyPatch
):
    archive = add_archive(submission, desk / "leaderboard")
    ask = ("--verify", str(archive), "--trust", "--by", "B")
    for unclean in ("abc-dirty", "unknown"):
        monkeypatch.setattr(entries, "commit", lambda unclean=unclean: unclean)
        assert f"on a clean commit, this is {unclean}" in mistake(submit.main, ask, desk)
