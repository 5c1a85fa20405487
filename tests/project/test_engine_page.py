"""The page on the engine: its Python runs, and the C that it shows is what comes out."""

import re
from pathlib import Path

from commands import ROOT, python

from eval.exports.program import loop_of
from eval.exports.source import sources

PAGE = (ROOT / "docs/guide/engine.md").read_text(encoding="utf-8")
README = ROOT / "beltarm_env/engine/translation/README.md"


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


def test_the_readme_of_the_translator(tmp_path: Path):
    (program,) = blocks("python", README.read_text(encoding="utf-8"))
    assert blocks("c")[0] in output_of(program, tmp_path)


def test_the_table_has_every_variable():
    engine = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "beltarm_env/engine").glob("*.py"))
    read = set(re.findall(r'environ(?:\.get\(|\[)"(BELTARM_\w+)"', engine))
    assert read == set(re.findall(r"^\| `(BELTARM_\w+)` \|", PAGE, re.MULTILINE))
