"""The programs of docs/guide/export.md, as on the page: Python is run, C is compiled against an exported controller."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from baselines import CONTROLLERS
from eval.deploy.building import FLAGS, here
from eval.deploy.controllers import exportable, loop_of
from eval.deploy.package import write
from eval.deploy.page import coverage

ROOT = Path(__file__).resolve().parents[2]
EXTRAS = ("fmpy", "onnx")


def programs(language: str) -> list[str]:
    """Blocks of a language on the page."""
    page = (ROOT / "docs/guide/export.md").read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)


@pytest.fixture(autouse=True)
def compiler() -> tuple[str, ...]:
    try:
        return here().compiler
    except ValueError as error:
        pytest.skip(str(error))


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(programs("python"))))
def test_python_on_the_page_runs(number: int, tmp_path: Path):
    program = programs("python")[number]
    for extra in EXTRAS:
        if f"import {extra}" in program or f"from {extra}" in program:
            if find_spec(extra) is None:
                pytest.skip(f"{extra} is not installed")
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", program]
    result = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr


def test_the_main_loop_on_the_page_compiles(compiler: tuple[str, ...], tmp_path: Path):
    (program,) = programs("c")
    write(tmp_path / "adaptive", loop_of("adaptive"))
    (tmp_path / "main.c").write_text(program, encoding="utf-8")
    command = [*compiler, *FLAGS, "-I", str(tmp_path / "adaptive"), "-c", "main.c"]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    header = (tmp_path / "adaptive/adaptive.h").read_text(encoding="utf-8")
    watched = ("memory_guard_row", "memory_own_notes_tracks_surprise")
    page = (ROOT / "docs/guide/export.md").read_text(encoding="utf-8")
    assert all(name in header and name in page for name in watched)


def test_the_level_is_where_the_page_says():
    from baselines.guard.guard import LEVEL

    assert f"memory_guard_row[{LEVEL}]" in (ROOT / "docs/guide/export.md").read_text(encoding="utf-8")


def test_the_table_says_which_controllers_it_lacks():
    page = (ROOT / "docs/results/embedded/summary.md").read_text(encoding="utf-8")
    shown = re.findall(r"^\| `(\w+)` \| [\d ]+ of [\d ]+ \|", page, re.MULTILINE)
    assert shown and coverage(shown) in page
    for name in CONTROLLERS:
        assert (name in shown) != (f"`{name}`" in coverage(shown)), name
    with pytest.raises(ValueError, match="mpc"):
        loop_of("mpc")
    assert "measured" not in coverage(exportable())
