"""Tools: files written whole or not at all, JSON of others, progress on a terminal, provenance."""

from __future__ import annotations

import errno
import io
import math
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from refusals import refused
from rich.console import Console

from baselines.gains import tuned
from baselines.registry import TUNABLE
from baselines.tools.files import read_sealed, require_writable, write_atomically, write_text
from baselines.tools.progress import progress_count, progress_over, progress_rows
from baselines.tools.schema import FLAG, INTEGER, NUMBER, TEXT, check, in_a_line, list_of, mapping_of, object_of, parse
from eval.comparison import scenarios
from eval.comparison.schema import read_results

ROOT = Path(__file__).parents[2]


def fail(code: int) -> Callable[..., Any]:
    def call(*_: Any, **__: Any) -> None:
        raise OSError(code, os.strerror(code))

    return call


class TestWriting:
    @pytest.mark.parametrize(
        ("module", "function", "code"),
        [(tempfile, "mkstemp", errno.EACCES), (os, "replace", errno.ENOSPC), (os, "chmod", errno.EPERM)],
        ids=["create", "rename", "permissions"],
    )
    def test_a_file_that_cannot_be_written_stays_as_it_was(
        self, module: Any, function: str, code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ):
        path = tmp_path / "results.json"
        path.write_text("old")
        monkeypatch.setattr(module, function, fail(code))
        with pytest.raises(OSError) as caught:
            write_text(path, "new")
        assert caught.value.errno == code and str(path) in str(caught.value)
        assert [file.read_text() for file in tmp_path.iterdir()] == ["old"]

    @pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "No space left"), KeyboardInterrupt()], ids=repr)
    def test_half_written_files_are_removed_and_the_error_names_the_file(self, tmp_path: Path, error: BaseException):
        path = tmp_path / "results.json"
        path.write_text("old")

        def write(temporary: Path) -> None:
            temporary.write_text("half of")
            raise error

        words = r"No space left.*/results\.json'$" if isinstance(error, OSError) else None
        with pytest.raises(type(error), match=words):
            write_atomically(path, write)
        assert path.read_text() == "old"
        assert os.listdir(tmp_path) == ["results.json"]

    def test_written_files_are_whole_and_readable(self, tmp_path: Path):
        """What a killed process left is removed, not what another process may still be writing."""
        path = tmp_path / "a" / "b" / "results.json"
        write_text(path, "first")
        for name in (".results-old.json", ".results-fresh.json", ".other-old.json"):
            (path.parent / name).touch()
            if "old" in name:
                os.utime(path.parent / name, (0, 0))
        write_text(path, "gain ×2")
        assert path.read_text(encoding="utf-8") == "gain ×2"
        assert set(os.listdir(path.parent)) == {"results.json", ".results-fresh.json", ".other-old.json"}
        assert path.stat().st_mode & 0o777 == 0o644

    def test_a_folder_has_to_be_writable(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        require_writable(tmp_path / "results")
        assert os.listdir(tmp_path / "results") == []
        (tmp_path / "file").write_text("mine")
        with pytest.raises(OSError, match="file"):
            require_writable(tmp_path / "file")
        assert (tmp_path / "file").read_text() == "mine"
        monkeypatch.setattr(tempfile, "mkstemp", fail(errno.EROFS))
        with pytest.raises(OSError, match=rf"{tmp_path}.*{os.strerror(errno.EROFS)}"):
            require_writable(tmp_path)
        assert sorted(os.listdir(tmp_path)) == ["file", "results"]


READERS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "results": ("results.json", read_results),
    "scenarios": ("scenarios.json", scenarios.load),
    "gains": ("gains.json", lambda path: tuned("zv", TUNABLE["zv"].gains, path)),
    "sealed": ("any", read_sealed),
}


@pytest.mark.parametrize("kind", ["pipe", "device"])
@pytest.mark.parametrize("reader", READERS)
def test_what_is_no_regular_file_is_refused(reader: str, kind: str, tmp_path: Path):
    """A pipe would be waited for, and a device has no end."""
    name, read = READERS[reader]
    path = tmp_path / name
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
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

    def test_in_a_line(self):
        values = " two\n\t words ", "bell\a", [1, None], "a" * 20, "a" * 10**6
        shown = "two words", "bell?", "[1, None]", "a" * 20, "a" * 17 + "..."
        assert tuple(in_a_line(value, 20) for value in values) == shown


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
        check({**GOOD, "price": LARGEST, "chapters": [], "marks": {}}, "the book", BOOK)
        for name in GOOD:
            book = {other: value for other, value in GOOD.items() if other != name}
            if name in ("pages", "more"):
                check(book, "the book", BOOK)
            else:
                refused(ValueError, ("the book", name), lambda book=book: check(book, "the book", BOOK))

    @pytest.mark.parametrize(
        ("change", "words"),
        [
            ({"title": 3}, "title .* '3'"),
            ({"pages": 3.5}, "pages .* '3.5'"),
            ({"pages": True}, "pages .* 'True'"),
            ({"price": math.nan}, "price .* 'nan'"),
            ({"price": True}, "price .* 'True'"),
            ({"price": "1"}, "price .* '1'"),
            ({"price": 10**309}, r"price .* '10*\.\.\.'"),
            ({"lent": 0}, "lent .* '0'"),
            ({"kind": "song"}, "kind .* paper, film.* 'song'"),
            ({"chapters": {}}, "chapters .* '{}'"),
            ({"chapters": [{"name": "first"}, {}]}, r"chapters\[1\]: name"),
            ({"chapters": [3]}, r"chapters\[0\] .* '3'"),
            ({"marks": {"a\nb": "x"}}, r"marks: 'a\\nb' .* 'x'"),
        ],
    )
    def test_what_does_not_fit(self, change: dict[str, Any], words: str):
        with pytest.raises(ValueError, match=f"^the book: {words}") as caught:
            check({**GOOD, **change}, "the book", BOOK)
        assert "\n" not in str(caught.value)


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Console:
    monkeypatch.setenv("TERM", "xterm")
    return Console(file=io.StringIO(), force_terminal=True, width=80)


def written(console: Console) -> str:
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


class TestProgress:
    def test_a_refusal_comes_without_a_display(self, terminal: Console):
        with (
            pytest.raises(ValueError, match="no"),
            progress_rows(["a"], 2, terminal),
            progress_count("pairs", terminal),
        ):
            raise ValueError("no")
        assert written(terminal) == ""

    def test_displays_begin_with_the_first_news_and_are_removed(self, terminal: Console):
        with progress_rows(["a", "b"], 2, terminal) as rows:
            rows.show("a", 1, "half")
            assert " 50 %" in written(terminal) and "half" in written(terminal)
        with progress_count("pairs", terminal) as show:
            assert "pairs" not in written(terminal)
            show(0, 3)
            assert "pairs" in written(terminal)
        for _ in progress_over("things", "abcd", terminal):
            assert "things" in written(terminal), "from the first one on"
        assert written(terminal).endswith("\x1b[2K")
        console = Console(file=io.StringIO())
        assert list(progress_over("things", "a", console)) == ["a"] and written(console) == "", "not on a terminal"


ASK = """
from pathlib import Path
from baselines.tools import provenance
print(provenance.commit())
try:
    print(provenance.last_commit_of(Path(provenance.__file__)))
except ValueError:
    print("refused")
"""


def git(folder: Path, *words: str) -> str:
    settings = "-c user.name=A -c user.email=a@b.c -c commit.gpgsign=false -c init.defaultBranch=main".split()
    ran = subprocess.run(["git", *settings, *words], cwd=folder, capture_output=True, text=True, check=True)
    return ran.stdout.strip()


def sources_in(folder: Path) -> Path:
    """Copy what tells of provenance into a folder."""
    for name in ("beltarm_env/__init__.py", "beltarm_env/sources.py", "beltarm_env/timing.py", "baselines/tools"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, folder / name)
    (folder / "baselines/__init__.py").touch()
    (folder / ".gitignore").write_text("__pycache__/\n")
    return folder


def repository(folder: Path) -> Path:
    """Make a repository with one commit of all that is in the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "theirs.txt").touch()
    git(folder, "init")
    git(folder, "add", ".")
    git(folder, "commit", "-m", "all")
    return folder


def provenance_of(sources: Path, **environment: str) -> list[str]:
    """Commit of the sources, and last commit of a file of theirs."""
    known, code = {**os.environ, "PYTHONPATH": str(sources), **environment}, [sys.executable, "-c", ASK]
    ran = subprocess.run(code, env=known, cwd=sources.parent, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    return ran.stdout.splitlines()


@pytest.mark.parametrize(("place", "committed"), [("third_party/arm", True), (".", True), (".", False)])
def test_sources_in_a_repository_of_another_project(tmp_path: Path, place: str, committed: bool):
    theirs = tmp_path / "theirs"
    if not committed:
        repository(theirs)
    sources = sources_in(theirs / place)
    if committed:
        repository(theirs)
    # At the top of a repository that has them in its commit, they are that commit's.
    own = committed and place == "."
    head = git(theirs, "rev-parse", "HEAD")
    commit, last = provenance_of(sources)
    assert (head.startswith(commit), last == head) == (own, own)
    assert own or (commit, last) == ("unknown", "refused")


def test_without_a_repository_nothing_is_known_and_that_of_a_hook_is_not_asked(tmp_path: Path):
    theirs, sources = repository(tmp_path / "theirs"), sources_in(tmp_path / "arm")
    hook = {"GIT_DIR": str(theirs / ".git")}
    assert provenance_of(sources) == provenance_of(sources, **hook) == ["unknown", "refused"]
    own = git(repository(sources), "rev-parse", "HEAD")
    commit, last = provenance_of(sources, **hook)
    assert own.startswith(commit) and last == own


def test_checkouts_say_their_commit_and_whether_they_differ(tmp_path: Path):
    checkout = repository(sources_in(tmp_path / "with a space/arm"))
    git(checkout, "worktree", "add", "--detach", "../another tree")
    for tree in (checkout, tmp_path / "with a space/another tree"):
        head = git(tree, "rev-parse", "HEAD")
        commit, last = provenance_of(tree)
        assert head.startswith(commit) and last == head
        with (tree / "baselines/tools/provenance.py").open("a") as file:
            file.write("# edited\n")
        assert provenance_of(tree) == [f"{commit}-dirty", "refused"]
