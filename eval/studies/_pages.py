"""All measured pages: whether the code that measured them is still the same, rendered from data, measured anew."""

import importlib
import platform
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from baselines.tools.command import require_known
from baselines.tools.files import write_bytes, write_text
from baselines.tools.provenance import commit
from eval.comparison.provenance import ROOT, inputs_digest
from eval.comparison.results import MEASURES, STARTS
from eval.report import summary
from eval.studies._frame import DATA, PAGE, RESULTS, chosen_options, names, read_data, render, text_of

README = ROOT / "README.md"
"""Its blocks of numbers are those of the comparison."""
MEASURED = ROOT / "results" / "pages"
"""Where pages are measured before all of them replace the committed ones."""


@dataclass(frozen=True)
class Page:
    """A measured page, in the folder of its name."""

    name: str
    module: str  # that has `tables`, and `pictures` where they are drawn from data
    words: tuple[str, ...]  # command that measures it, without --out
    starts: tuple[str, ...] = ("measure", "Options")  # what in the module measures
    measures: str = ""  # module that measures, where it is another
    data: str = DATA
    left_out: tuple[str, ...] = ()  # files of its folder that are not committed

    @property
    def command(self) -> list[str]:
        """Command that measures it, where pages are measured."""
        return ["python", *self.words, "--out", (MEASURED / self.name).relative_to(ROOT).as_posix()]

    @property
    def committed(self) -> Path:
        """Folder of the committed page."""
        return RESULTS / self.name


_OF_COMPARISON = STARTS, MEASURES, "results.json", ("report.html", "episodes.csv")
OTHERS = (
    Page("bench", "eval.speed.bench", ("eval/bench.py",)),
    Page("comparison", "eval.report.summary", ("eval/compare.py",), *_OF_COMPARISON),
)
"""Pages of commands that are no studies."""


class State(NamedTuple):
    """How a committed page stands to today's code."""

    verdict: str  # "fresh", "older inputs", "other options", "not comparable" or "missing"
    commit: str = "–"
    seconds: float = float("inf")


def pages(wanted: Sequence[str] = ()) -> list[Page]:
    """All measured pages, or those of some names.

    Raises:
        ValueError: If there is no page of a name.
    """
    known = [Page(name, f"eval.studies.{name}", ("eval/study.py", name)) for name in names()]
    known += OTHERS
    require_known(wanted, [page.name for page in known], "no measured page is called {}")
    return [page for page in known if not wanted or page.name in wanted]


def state(page: Page, folder: Path) -> State:
    """Compare the data of a page with today's code and options."""
    try:
        about = read_data(folder, page.data)["provenance"]
    except (OSError, ValueError, KeyError):
        return State("missing")
    measured = (about["commit"], float(about["seconds"]))
    here = platform.python_version()  # digests of different minor versions differ, as their syntax trees do
    if about["python"].rpartition(".")[0] != here.rpartition(".")[0]:
        return State("not comparable", *measured)
    module = importlib.import_module(page.module)
    options = hasattr(module, "Options") and about["options"] != chosen_options(module.Options())
    if options or (page.measures and shlex.split(about["command"]) != page.command):
        return State("other options", *measured)
    same = about["inputs"] == inputs_digest(page.measures or page.module, page.starts)
    return State("fresh" if same and not about["commit"].endswith("-dirty") else "older inputs", *measured)


def check(wanted: Sequence[str] = ()) -> list[tuple[str, State]]:
    """State of all committed pages."""
    return [(page.name, state(page, page.committed)) for page in pages(wanted)]


def render_all(wanted: Sequence[str] = ()) -> Iterator[Path]:
    """Render pages from their data, one after the other."""
    for page in pages(wanted):
        if (page.committed / page.data).exists():
            data = read_data(page.committed, page.data)
            render(page.name, importlib.import_module(page.module), data, page.committed)
            yield page.committed / PAGE
            if page.name == "comparison":
                write_text(README, updated_readme(README.read_text(encoding="utf-8"), data))
                yield README


def updated_readme(readme: str, data: dict[str, Any]) -> str:
    """README with the numbers of a comparison, each of `summary.BLOCKS` between the markers of its name.

    Raises:
        ValueError: If markers are missing.
    """
    for name in summary.BLOCKS:
        begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
        block = f"{begin}\n{text_of('comparison', summary, data, f'{name}.md.j2').strip()}\n{end}"
        readme, found = re.subn(f"{begin}.*?{end}", lambda _, block=block: block, readme, count=1, flags=re.DOTALL)
        if not found:
            raise ValueError(f"README.md has no {begin} and {end} to write between")
    return readme


def measure_all(wanted: Sequence[str] = ()) -> Iterator[tuple[str, str]]:
    """Measure all pages, or those of some names, the cheapest first.

    Each is measured into `MEASURED`, and what is fresh there is not repeated. Once all are measured they replace the
    committed ones, so that these pages name one commit. Yields the name of a page, and what is done with it.

    Raises:
        ValueError: If files differ from the commit, or a measurement fails.
    """
    here = commit()
    if here.endswith("-dirty") or here == "unknown":
        raise ValueError(f"the checkout is not as its last commit ({here}): commit all changes, then measure")
    chosen = sorted(pages(wanted), key=lambda page: state(page, page.committed).seconds)
    for page in chosen:
        folder = MEASURED / page.name
        files = [folder / path.name for path in page.committed.iterdir() if path.suffix != ".j2"]
        oldest = min((path.stat().st_mtime if path.exists() else 0.0 for path in files), default=0.0)
        if state(page, folder)[:2] == ("fresh", here) and oldest >= (folder / page.data).stat().st_mtime:  # it is first
            yield page.name, "measured before"
            continue
        yield page.name, "is measured"
        if subprocess.run([sys.executable, *page.command[1:]], cwd=ROOT, check=False).returncode:
            raise ValueError(f"{page.name} could not be measured; the same command goes on from there")
    if commit() != here:
        raise ValueError(f"the checkout was at {here} when this began, and is not now: measure again")
    for page in chosen:
        written = (MEASURED / page.name / page.data).stat().st_mtime  # before all others of this measurement
        files = {path.name: path for path in (MEASURED / page.name).glob("*.*") if path.stat().st_mtime >= written}
        for name in {*files} - {*page.left_out}:
            write_bytes(page.committed / name, files[name].read_bytes())
        for path in page.committed.iterdir():
            if path.suffix != ".j2" and path.name not in files:
                path.unlink()  # a picture that is drawn no more
        yield page.name, "replaced"
