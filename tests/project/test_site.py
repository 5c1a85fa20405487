"""The documentation site, without tutorials' runs: pages are in a table of contents, links lead somewhere, no host."""

import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest
from commands import ROOT

pytest.importorskip("sphinx", reason="the site needs `make docs`'s packages")
pytest.importorskip("sphinxcontrib.katex", reason="the site needs `make docs`'s packages")

pytestmark = pytest.mark.slow
KEPT_OUT = {".git", ".venv", "docs", "results", "runs"}
LOADED = {"img": "src", "script": "src", "link": "href", "iframe": "src", "source": "src", "video": "src"}
"""Attributes that a browser loads by itself, by element."""


class Page(HTMLParser):
    def __init__(self, path: Path) -> None:
        super().__init__()
        self.loads: list[str] = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.loads += [value for name, value in attrs if name == LOADED.get(tag) and value and value != "#"]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the pages, built from a copy, since the gallery is written among the sources."""
    copy = tmp_path_factory.mktemp("checkout")
    for path in ROOT.iterdir():
        if path.is_file():
            shutil.copy(path, copy)
        elif path.name not in KEPT_OUT:
            (copy / path.name).symlink_to(path)
    shutil.copytree(ROOT / "docs", copy / "docs", ignore=shutil.ignore_patterns("_build", "gallery", "*.gif"))
    (copy / "docs/results/comparison/motion.gif").touch()
    command = [sys.executable, "-m", "sphinx", "--fail-on-warning", "--quiet", "-D", "plot_gallery=0"]
    command += ["-D", "plot_pre_code=motion = lambda *names: None", "docs", "site"]
    done = subprocess.run(command, cwd=copy, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return copy / "site"


def test_pages_load_nothing_from_another_host(site: Path):
    loaded = [(page, target.partition("?")[0]) for page in site.rglob("*.html") for target in Page(page).loads]
    assert len({page for page, _ in loaded}) > 50
    for page, target in loaded:
        assert (page.parent / target).is_file(), f"{page.relative_to(site)} loads {target}"
    for style in site.rglob("*.css"):
        for target in re.findall(r"(?:url\(|@import\s*)[\"']?([^\"')]+)", style.read_text(encoding="utf-8")):
            assert not re.match(r"(\w+:)?//", target), f"{style.name} loads {target}"


def test_formulas_are_formulas(site: Path):
    """The docs have them in a forge's way, between $` and `$, which must not be seen on a page."""
    physics = (site / "science/physics.html").read_text(encoding="utf-8")
    assert physics.count('<span class="math') > 100
    for path in site.rglob("*.html"):
        assert "$`" not in re.sub(r"<pre>.*?</pre>", "", path.read_text(encoding="utf-8"), flags=re.DOTALL), path.name
    assert (site / "_static/katex/fonts/KaTeX_Math-Italic.woff2").is_file()
