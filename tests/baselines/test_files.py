"""Files are written whole or not at all."""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from baselines.gains import tuned
from baselines.registry import TUNABLE
from baselines.tools.files import read_sealed, require_writable, write_atomically, write_text
from eval.comparison import scenarios
from eval.comparison.cache import Part, read_kept
from eval.comparison.methods import classical_methods
from eval.comparison.schema import read_results
from eval.comparison.splits import draw_arms


def fail(code: int) -> Callable[..., Any]:
    def call(*_: Any, **__: Any) -> None:
        raise OSError(code, os.strerror(code))

    return call


@pytest.mark.parametrize(
    ("module", "function", "code"),
    [(tempfile, "mkstemp", errno.EACCES), (os, "replace", errno.EROFS), (os, "chmod", errno.EPERM)],
    ids=["create", "rename", "permissions"],
)
def test_a_file_that_cannot_be_written_stays_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: Any, function: str, code: int
):
    path = tmp_path / "results.json"
    path.write_text("old")
    monkeypatch.setattr(module, function, fail(code))
    with pytest.raises(OSError) as caught:
        write_text(path, "new")
    assert caught.value.errno == code and str(path) in str(caught.value)
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["results.json"]


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "No space left on device"), KeyboardInterrupt()], ids=repr)
def test_half_written_files_are_taken_away(tmp_path: Path, error: BaseException):
    path = tmp_path / "results.json"
    path.write_text("old")

    def write(temporary: Path) -> None:
        temporary.write_text("half of")
        raise error

    with pytest.raises(type(error)):
        write_atomically(path, write)
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["results.json"]


def test_a_full_disk_names_what_did_not_fit(tmp_path: Path):
    """By its own name, not by that of a temporary file."""

    def fill(_: Path) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.raises(OSError, match=r"No space left on device: '.*/results\.json'$"):
        write_atomically(tmp_path / "results.json", fill)


def test_a_new_file_that_cannot_be_written_does_not_appear(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(os, "replace", fail(errno.ENOSPC))
    with pytest.raises(OSError):
        write_text(tmp_path / "new" / "results.json", "new")
    assert os.listdir(tmp_path / "new") == []


def test_written_files_are_whole_and_readable(tmp_path: Path):
    path = tmp_path / "a" / "b" / "results.json"
    write_text(path, "first")
    write_text(path, "gain ×2")
    assert path.read_text(encoding="utf-8") == "gain ×2"
    assert os.listdir(path.parent) == ["results.json"]
    assert path.stat().st_mode & 0o777 == 0o644


@pytest.mark.parametrize("code", [errno.EACCES, errno.EROFS, errno.ENOSPC], ids=errno.errorcode.get)
def test_unwritable_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int):
    monkeypatch.setattr(tempfile, "mkstemp", fail(code))
    words = (str(tmp_path), os.strerror(code), "choose another")
    with pytest.raises(OSError) as caught:
        require_writable(tmp_path)
    assert [word for word in words if word not in str(caught.value)] == []
    assert os.listdir(tmp_path) == []


def test_folder_that_is_a_file(tmp_path: Path):
    path = tmp_path / "results"
    path.write_text("mine")
    with pytest.raises(OSError, match=r"results.*choose another"):
        require_writable(path)
    assert path.read_text() == "mine"


def test_writable_folder_is_left_empty(tmp_path: Path):
    require_writable(tmp_path / "results")
    assert os.listdir(tmp_path / "results") == []


def test_what_a_killed_process_left_is_taken_away_later(tmp_path: Path):
    """Not what another process may still be writing."""
    names = [".results-old.json", ".results-fresh.json", ".other-old.json"]
    for name in names:
        (tmp_path / name).touch()
        if "old" in name:
            os.utime(tmp_path / name, (0, 0))
    write_text(tmp_path / "results.json", "new")
    assert set(os.listdir(tmp_path)) == {"results.json", *names[1:]}


def kept_part() -> Part:
    (method,) = [known for known in classical_methods() if known.name == "paper"]
    return Part(method, draw_arms("nominal", "seed 0", range(2)), 2)


READERS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "results": ("results.json", read_results),
    "scenarios": ("scenarios.json", scenarios.load),
    "gains": ("gains.json", lambda path: tuned("zv", TUNABLE["zv"].gains, path)),
    "part": ("", lambda path: read_kept(kept_part(), path.parent)),
    "sealed": ("any", read_sealed),
}


@pytest.mark.parametrize("kind", ["pipe", "device"])
@pytest.mark.parametrize("reader", READERS)
def test_what_is_no_regular_file_is_refused(reader: str, kind: str, tmp_path: Path):
    """A pipe would be waited for, and a device has no end."""
    name, read = READERS[reader]
    path = tmp_path / name if name else kept_part().file(tmp_path)
    path.parent.mkdir(exist_ok=True)
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    if reader == "part":
        assert read(path) is None, "it is run again"
        return
    with pytest.raises((OSError, ValueError), match="is no regular file"):
        read(path)
