"""Tools: files written whole or not at all, JSON of others, progress on a terminal, provenance."""

import errno
import math
import os
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from refusals import refused

from baselines import gains
from baselines.tools import files, progress, provenance
from baselines.tools.schema import FLAG, INTEGER, NUMBER, TEXT, check, list_of, mapping_of, object_of, parse
from eval.comparison import sets
from eval.comparison.schema import read_results


def fail(error: BaseException) -> Callable[..., Any]:
    """Function that raises an error, having written half of a file if it is given its path."""

    def call(path: Any = None, *_: Any, **__: Any) -> None:
        if isinstance(path, Path):
            path.write_text("half of")
        raise error

    return call


class TestWriting:
    def test_a_file_that_cannot_be_written_stays_as_it_was(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        path = tmp_path / "results.json"
        path.write_text("old")
        for function in ("tempfile.mkstemp", "os.replace", "os.chmod"):
            with monkeypatch.context() as patched:
                patched.setattr(function, fail(OSError(errno.EIO, "disk broken")))
                refused(OSError, ("disk broken", str(path)), lambda: files.write_text(path, "new"))
        full = fail(OSError(errno.ENOSPC, "No space left"))
        refused(OSError, ("No space left", str(path)), lambda: files.write_atomically(path, full))
        refused(KeyboardInterrupt, (), lambda: files.write_atomically(path, fail(KeyboardInterrupt())))
        assert [file.read_text() for file in tmp_path.iterdir()] == ["old"]

    def test_written_files_are_whole_and_readable(self, tmp_path: Path):
        """What a killed process left is removed, not what another process may still be writing."""
        path = tmp_path / "a" / "b" / "results.json"
        files.write_text(path, "first")
        for name in (".results-old.json", ".results-fresh.json", ".other-old.json"):
            (path.parent / name).touch()
            if "old" in name:
                os.utime(path.parent / name, (0, 0))
        files.write_text(path, "gain ×2")
        assert path.read_text(encoding="utf-8") == "gain ×2"
        assert set(os.listdir(path.parent)) == {"results.json", ".results-fresh.json", ".other-old.json"}
        assert path.stat().st_mode & 0o777 == 0o644

    def test_a_folder_has_to_be_writable(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        files.require_writable(tmp_path / "results")
        assert os.listdir(tmp_path / "results") == []
        (tmp_path / "file").write_text("mine")
        refused(OSError, ("file",), lambda: files.require_writable(tmp_path / "file"))
        assert (tmp_path / "file").read_text() == "mine"
        monkeypatch.setattr(tempfile, "mkstemp", fail(OSError(errno.EROFS, "read-only")))
        refused(OSError, (str(tmp_path), "read-only"), lambda: files.require_writable(tmp_path))
        assert sorted(os.listdir(tmp_path)) == ["file", "results"]


def test_what_is_no_regular_file_is_refused(tmp_path: Path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "device").symlink_to("/dev/zero")
    for read in (read_results, sets.load, gains.read_file, files.read_sealed):
        for path in (tmp_path / "pipe", tmp_path / "device"):
            with pytest.raises((OSError, ValueError), match="is no regular file"):
                read(path)


LARGEST_INTEGER = 2**63 - 1
LARGEST = 1.7976931348623157e308  # float64


class TestJson:
    @given(st.integers(-LARGEST_INTEGER, LARGEST_INTEGER) | st.floats(allow_nan=False, allow_infinity=False))
    @example(LARGEST_INTEGER)
    @example(-LARGEST)
    def test_numbers_are_read_as_they_are(self, number: float):
        actual = parse(f'{{"a": [{number!r}]}}'.encode())
        assert actual == {"a": [number]} and type(actual["a"][0]) is type(number)

    def test_numbers_that_are_not_finite_or_too_large_and_what_is_no_json(self):
        for text in (str(2**63), str(-(2**63)), "1e309", "-1e309", "NaN", "Infinity", "-Infinity"):
            refused(ValueError, (text[:20],), lambda text=text: parse(f"[{text}]".encode()))
        for data in (b"", b"{", b"\xff", b'"\\ud800"', b"[1] 2"):
            with pytest.raises(ValueError):
                parse(data)


BOOK = object_of(
    ("pages",),
    title=TEXT,
    pages=INTEGER,
    price=NUMBER,
    lent=FLAG,
    kind={"enum": ["paper", "film"]},
    chapters=list_of(object_of(name=TEXT)),
    marks=mapping_of(NUMBER),
)
GOOD: dict[str, Any] = {
    **{"title": "Arms", "pages": 3, "price": 2.5, "lent": False, "kind": "film"},
    **{"chapters": [{"name": "one"}, {"name": "two"}], "marks": {"a": 1, "b": 0.5}, "more": None},
}


class TestSchema:
    def test_what_fits_and_what_lacks(self):
        for change, left_out in (({"price": LARGEST, "chapters": [], "marks": {}}, ()), ({}, ("pages", "more"))):
            check({name: v for name, v in {**GOOD, **change}.items() if name not in left_out}, "the book", BOOK)
        less = {name: value for name, value in GOOD.items() if name != "marks"}
        refused(ValueError, ("the book", "marks"), lambda: check(less, "the book", BOOK))

    @pytest.mark.parametrize(
        ("change", "words"),
        [
            ({"title": 3}, r"\.title .* string, got '3'"),
            ({"pages": True}, r"\.pages .* 'True'"),
            ({"price": math.nan}, r"\.price .* finite number, got 'nan'"),
            ({"price": 10**309}, r"\.price .* '10*\.\.\.'"),
            ({"kind": "song"}, r"\.kind .* paper, film.* 'song'"),
            ({"chapters": [{"name": "first"}, {}]}, r"\.chapters\[1\]\.name must"),
            ({"marks": {"a\nb": "x"}}, r"\.marks.*a.*b.* 'x'"),
        ],
    )
    def test_what_does_not_fit(self, change: dict[str, Any], words: str):
        with pytest.raises(ValueError, match=rf"^the book: \${words}[^\n]*\Z"):
            check({**GOOD, **change}, "the book", BOOK)


def test_without_terminal_lines_say_how_far_it_is(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    assert list(progress.progress_over("letters", "ab")) == ["a", "b"] and capsys.readouterr().err == ""
    monkeypatch.setattr(progress, "_LINE_EVERY", -1.0)
    assert list(progress.progress_over("letters", "ab")) == ["a", "b"]
    assert capsys.readouterr().err.splitlines() == ["letters: 0 of 2", "letters: 1 of 2"]


def git(folder: Path, *words: str) -> str:
    settings = "-c user.name=A -c user.email=a@b.c -c commit.gpgsign=false -c init.defaultBranch=main".split()
    return subprocess.check_output(["git", *settings, *words], cwd=folder, stderr=subprocess.PIPE, text=True).strip()


UNKNOWN = ("unknown", "refused")


@pytest.fixture
def provenance_of(monkeypatch: pytest.MonkeyPatch) -> Callable[[Path], tuple[str, str]]:
    """Commit of sources in a folder, and last commit of a file of theirs, as they are asked for there."""

    def asked(sources: Path) -> tuple[str, str]:
        monkeypatch.setattr(provenance, "_ROOT", sources)
        monkeypatch.setattr(provenance, "__file__", str(sources / "provenance.py"))
        try:
            return provenance.commit(), provenance.last_commit_of(sources / "provenance.py")
        except ValueError:
            return provenance.commit(), "refused"

    return asked


def sources_in(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "provenance.py").touch()
    return folder


def repository(folder: Path) -> Path:
    git(folder, "init")
    git(folder, "add", ".")
    git(folder, "commit", "-m", "all", "--allow-empty")
    return folder


def test_of_sources_without_a_repository_of_their_own_nothing_is_known(
    tmp_path: Path, provenance_of: Any, monkeypatch: pytest.MonkeyPatch
):
    """Neither of another project that they lie in, nor of one whose hook runs."""
    theirs, alone = tmp_path / "theirs", sources_in(tmp_path / "alone")
    assert provenance_of(alone) == UNKNOWN
    inside = sources_in(theirs / "third_party/arm")
    repository(theirs)
    assert provenance_of(inside) == UNKNOWN
    assert provenance_of(sources_in(theirs)) == UNKNOWN, "not in its commit"
    monkeypatch.setenv("GIT_DIR", str(theirs / ".git"))
    assert provenance_of(alone) == UNKNOWN


@pytest.mark.parametrize("hook", [False, True])
def test_checkouts_say_their_commit_and_whether_they_differ(
    tmp_path: Path, provenance_of: Any, hook: bool, monkeypatch: pytest.MonkeyPatch
):
    checkout = repository(sources_in(tmp_path / "with a space/arm"))
    git(checkout, "worktree", "add", "--detach", "../another tree")
    trees = checkout, tmp_path / "with a space/another tree"
    heads = [git(tree, "rev-parse", "HEAD") for tree in trees]
    if hook:
        monkeypatch.setenv("GIT_DIR", str(repository(sources_in(tmp_path / "theirs")) / ".git"))
    for tree, head in zip(trees, heads, strict=True):
        commit, last = provenance_of(tree)
        assert head.startswith(commit) and last == head
        (tree / "provenance.py").write_text("# edited")
        assert provenance_of(tree) == (f"{commit}-dirty", "refused")
