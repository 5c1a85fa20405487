"""First tries of studies, as a user runs them, with what all their folders must have."""

import re
from collections.abc import Callable, Mapping
from pathlib import Path

import matplotlib.pyplot as plt
import pytest
from commands import stopped
from matplotlib.figure import Figure

from eval import study
from eval.comparison import provenance
from eval.comparison.methods import shipped_policies
from eval.studies import _frame, steps
from eval.studies.loops import costs


def try_study(name: str, folder: Path) -> None:
    """Run `eval/study.py NAME --quick` in a folder, and check its page, its data and its pictures in `out`."""
    code, errors = stopped(study.main, (name, "--quick", "--out", "out"), folder)
    assert code == 0, errors
    out, module = folder / "out", _frame.load(name)
    data = _frame.read_data(out)
    page = (out / "page.md").read_text(encoding="utf-8")
    assert {"command", "commit", "inputs", "options", "seconds"} <= set(data["provenance"])
    assert page == _frame.text_of(name, module, data)
    assert not re.search(r"\b(nan|inf|None)\b", page)
    assert not re.search(r"^(\|.*)\n\1$|\| (\d+) \| \2 \|.*\n\|---", page, re.MULTILINE), "shown twice"
    files, pictures = {path.name for path in out.iterdir()}, getattr(module, "pictures", lambda _: ())(data)
    assert files == {"data.json", "page.md", *pictures}
    assert files >= {*re.findall(r"\]\(([\w-]+\.(?:png|csv))\)", page)}


def draw_alone(figures: Mapping[str, Callable[[], Figure]], folder: Path, **_: object) -> None:
    for name, draw in figures.items():
        plt.close(draw())
        (folder / name).touch()


def hurry(patch: pytest.MonkeyPatch) -> None:
    """Leave out what takes longest in a first try: files of pictures, the digest, most changes, steps and seeds."""
    learned = steps.ASIDE[1]._replace(make=lambda _: [*map(steps.load_controller, shipped_policies(2, "student"))])
    patch.setattr(_frame, "save_figures", draw_alone)
    patch.setattr(costs, "CHANGES", costs.CHANGES[:4])
    patch.setattr(steps, "CHAIN", (*steps.CHAIN[::3], steps.CHAIN[-1]))
    patch.setattr(steps, "ASIDE", (steps.ASIDE[0], learned))
    patch.setattr(steps, "TWO_LINKS", (steps.TWO_LINKS[0], learned, *steps.TWO_LINKS[2:]))
    patch.setattr(steps, "GUESSES", steps.GUESSES[-1:])
    patch.setattr(provenance, "inputs_digest", lambda *_: "0" * 64)
