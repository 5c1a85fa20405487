"""Shared objects that are built: what names them, and what happens where they cannot be built."""

import os
import shutil
from pathlib import Path

import pytest
from refusals import refused

from beltarm_env.engine import building
from beltarm_env.engine.building import BuildError, UnavailableError, build, load

pytestmark = pytest.mark.skipif(building.compiler() is None, reason="there is no compiler of C")

TEXT = """#include <math.h>
#ifdef _WIN32
__declspec(dllexport)
#else
__attribute__((visibility("default")))
#endif
int answer(void) { return (int)fmod(142, 100); }
"""


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache, but for what Zig's compiler keeps of its libraries."""
    usual = building.cache_folder()
    assert usual is not None and building.level()  # with `_glue` in the usual cache
    monkeypatch.setenv("ZIG_GLOBAL_CACHE_DIR", str(usual / "zig"))
    monkeypatch.setenv("BELTARM_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def compiled(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    paths, really = list[Path](), building._compile
    monkeypatch.setattr(building, "_compile", lambda *given: (paths.append(given[3]), really(*given)))
    return paths


def test_an_object_is_built_once_and_lies_beside_its_text(cache: Path, compiled: list[Path]):
    path = build(TEXT, "answer")
    assert load(path).answer() == 42 and build(TEXT, "answer") == path and compiled == [path]
    assert path.with_suffix(".c").read_text() == TEXT
    assert {file.suffix for file in cache.iterdir()} <= {".c", path.suffix}, "nothing else is left"


def test_its_name_tells_all_that_it_is_made_of(cache: Path, monkeypatch: pytest.MonkeyPatch, compiled: list[Path]):
    monkeypatch.setenv("BELTARM_LEVEL", building.baseline())
    paths = [build(TEXT, "answer"), build(TEXT + "\n", "answer"), build(TEXT, "answer", options=["-DX"])]
    if building.baseline() == "x86_64":
        paths.append(build(TEXT, "answer", target="x86_64_v2"))
    assert len(set(paths)) == len(paths) and compiled == paths
    monkeypatch.setattr(building, "_ziglang_version", lambda: "another one")
    building._packaged_compiler.cache_clear()
    assert os.environ.get("BELTARM_CC") or build(TEXT, "answer") not in paths
    building._packaged_compiler.cache_clear()


def test_files_that_are_included_belong_to_the_text(cache: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setenv("BELTARM_LEVEL", building.baseline())
    monkeypatch.setattr(building, "SOURCES", tmp_path)
    paths = []
    for value in (1, 2):
        (tmp_path / "inner.h").write_text(f"enum {{ VALUE = {value} }};\n")
        (tmp_path / "outer.h").write_text('#include "inner.h"\n')
        paths.append(build(f'#include "outer.h"\n#include "inner.h"\n{TEXT.replace("100", "100 + VALUE")}', "included"))
    assert [load(path).answer() for path in paths] == [41, 40]


def test_a_damaged_object_is_built_anew(cache: Path, compiled: list[Path]):
    path = build(TEXT, "answer")
    content = path.read_bytes()
    for count, wrong in enumerate((b"", content[:100], content[: len(content) // 2], bytes(len(content))), 2):
        path.unlink()  # a file that is loaded stays as it is
        path.write_bytes(wrong)
        assert build(TEXT, "answer") == path and len(compiled) == count
    assert load(path).answer() == 42


def test_what_the_compiler_says_is_told(cache: Path):
    with pytest.raises(BuildError, match=r"wrong\.\w+\.c(.|\n)*nowhere"):
        build("int f(void) { return nowhere; }", "wrong")
    assert not list(cache.glob("*.so")) and len(list(cache.glob("wrong.*.c"))) == 1, "the text is kept to be looked at"


def test_where_there_is_no_compiler(cache: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("BELTARM_LEVEL", building.baseline())
    monkeypatch.setenv("BELTARM_CC", str(cache / "no compiler"))
    refused(BuildError, ("no",), lambda: build(TEXT, "answer"))
    monkeypatch.delenv("BELTARM_CC")
    monkeypatch.setattr(building, "_packaged_compiler", lambda: None)
    refused(UnavailableError, ("install the package ziglang, or set BELTARM_CC",), lambda: build(TEXT, "answer"))
    monkeypatch.delenv("BELTARM_LEVEL")
    monkeypatch.setattr(building, "glue", building.glue.__wrapped__)
    assert building.level() == building.baseline()


@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
def test_another_compiler(cache: Path, monkeypatch: pytest.MonkeyPatch):
    usual = build(TEXT, "answer")
    monkeypatch.setenv("BELTARM_CC", "gcc -Wall")
    path = build(TEXT, "answer")
    assert path != usual and load(path).answer() == 42


def test_the_cache_is_the_first_folder_that_can_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("BELTARM_CACHE_DIR", str(tmp_path / "one" / "two"))
    assert building.cache_folder() == tmp_path / "one" / "two"
    (tmp_path / "file").touch()
    monkeypatch.setenv("BELTARM_CACHE_DIR", str(tmp_path / "file" / "none"))
    assert building.cache_folder() == Path(building.__file__).parent / "__pycache__"
    monkeypatch.setattr(building, "_folders", lambda: [tmp_path / "file" / "none"])
    assert building.cache_folder() is None
    refused(UnavailableError, ("set BELTARM_CACHE_DIR",), lambda: build(TEXT, "answer", target=building.baseline()))
