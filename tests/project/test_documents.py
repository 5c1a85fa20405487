"""Documents that show code: the recipe of CONTRIBUTING.md, to the letter in a copy, and the page on the engine."""

import re
import shutil
from pathlib import Path

import pytest
from commands import PACKAGES, ROOT, python

from eval.exports.program import loop_of
from eval.exports.source import sources

PAGE = (ROOT / "docs/guide/engine.md").read_text(encoding="utf-8")
README = ROOT / "beltarm_env/engine/translation/README.md"

STEP = re.compile(r"^(New file|In) `([^`]+)`[^\n]*\n\n```\w+\n(.*?)^```$", re.M | re.S)
CODE = """
import numpy as np
from baselines import CONTROLLERS, TUNABLE
from beltarm_env.rollout import rollout
from eval.comparison.methods import classical_methods
from baselines.loops.models import loop_at
new, shaped = (rollout(CONTROLLERS[name](), 2, seed=0).metrics() for name in ("trapezoid", "zv"))
print(new["cost"].mean() < 3000, new["residual_pp_mm"].mean() > shaped["residual_pp_mm"].mean())
print("trapezoid" in TUNABLE, "trapezoid" in [method.name for method in classical_methods()])
print(loop_at(CONTROLLERS["trapezoid"](), 20).law.a.shape == (3, 3))
"""


def edited(source: str, difference: str, name: str) -> str:
    """A file after a difference: each run of lines is there exactly once; " " stays, "-" goes, "+" comes."""
    for hunk in re.split(r"^@@.*\n", difference, flags=re.M):
        lines = hunk.splitlines(keepends=True)
        before, after = ("".join(line[1:] for line in lines if line[0] in marks) for marks in (" -", " +"))
        assert source.count(before) == 1, f"{name} has not once:\n{before}"
        source = source.replace(before, after)
    return source


@pytest.mark.slow
def test_a_controller(tmp_path: Path):
    for package in PACKAGES:
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    _, section = (ROOT / "CONTRIBUTING.md").read_text().split("### Add a controller\n", 1)
    for kind, name, text in STEP.findall(re.split(r"^##", section, flags=re.M)[0]):
        path = tmp_path / name
        assert path.exists() == (kind == "In"), name
        path.write_text(edited(path.read_text("utf-8"), text, name) if kind == "In" else text, encoding="utf-8")
    output = python("-c", CODE, cwd=tmp_path, path=(tmp_path,), BELTARM_ENGINE="plain")
    assert output.split() == ["True"] * 5


def blocks(language: str, page: str = PAGE) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)


def output_of(program: str, folder: Path) -> str:
    """What a program prints, from a file: kernels have to have a source text."""
    (folder / "program.py").write_text(program, encoding="utf-8")
    return python("program.py", cwd=folder, path=(ROOT,), BELTARM_ENGINE="")


def test_the_page_shows_what_the_translator_writes(tmp_path: Path):
    here = output_of("".join(blocks("python")) + "print(text)\n", tmp_path)
    *shown, exported = blocks("c")
    assert shown and all(block in here for block in shown)
    assert exported in sources(loop_of("lqg"))["lqg.c"]
    (equation,) = blocks("py")
    assert equation in (ROOT / "beltarm_env/physics/state.py").read_text(encoding="utf-8")


def test_the_readme_of_the_translator_and_the_table_of_variables(tmp_path: Path):
    (program,) = blocks("python", README.read_text(encoding="utf-8"))
    assert blocks("c")[0] in output_of(program, tmp_path)
    engine = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "beltarm_env/engine").glob("*.py"))
    read = set(re.findall(r'environ(?:\.get\(|\[)"(BELTARM_\w+)"', engine))
    assert read == set(re.findall(r"^\| `(BELTARM_\w+)` \|", PAGE, re.MULTILINE))
