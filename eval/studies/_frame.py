"""Frame of all studies: a module measures data, a template in `docs/results/NAME` tells what they show.

A study is a module (or a folder, by its `__init__`) of `eval.studies` with these names:

    __doc__         what it shows, for `--help`; its first line for `--list`
    Options         a `StudyOptions`: its defaults are the options of the committed page
    QUICK           options of a first try, which takes seconds
    measure         measures all data; from `Options` to what `plain` turns into JSON
    tables          texts and numbers for the template, from the data alone
    pictures        if any, functions that draw figures from the data alone, by the name of the file

Data and words are apart, so that a page is rendered again in a second, and no fact stands in a program.
"""

import importlib
import json
import math
import pkgutil
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields, is_dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import jinja2
import numpy as np
from matplotlib.figure import Figure

import eval.studies
from baselines.tools.command import require_bounds, require_known
from baselines.tools.files import require_writable, write_text
from beltarm_env.metrics import heading
from eval.comparison.provenance import origin, provenance
from eval.comparison.splits import EPISODES
from eval.report.style import save_figures
from eval.report.text import cell, degrees, number, rounded

RESULTS = Path(__file__).resolve().parents[2] / "docs" / "results"
"""Committed pages, each in a folder of its name."""
DATA, TEMPLATE, PAGE = "data.json", "page.md.j2", "page.md"
Pictures = Mapping[str, Callable[[], Figure]]
_DIGITS = 7  # significant ones, of what is written
_PLACES = ("out", "jobs", "runs")  # options that change no number


Bounds = dict[str, tuple[int, int | None]]
"""Least and largest value of options that are numbers, by name."""


@dataclass(frozen=True)
class StudyOptions:
    """Options that all studies have."""

    bounds: ClassVar[Bounds] = Bounds()

    out: Path | None = None
    """Folder for data.json, page.md and the pictures. Default: results/NAME."""
    quick: bool = False
    """Only try the study, with little of everything."""


@dataclass(frozen=True)
class OptionsWithJobs(StudyOptions):
    """Options of studies that run many processes."""

    bounds = Bounds(jobs=(1, 256))

    jobs: int | None = None
    """Number of processes. Default: one per core."""


@dataclass(frozen=True)
class DevelopmentOptions(StudyOptions):
    """Options of studies on the development set."""

    bounds = Bounds(episodes=(4, EPISODES))

    splits: tuple[str, ...] = ()
    """Splits to run. Default: all."""
    episodes: int = 24
    """Scenarios per split, 4 to 200."""


def names() -> list[str]:
    """Names of all studies."""
    return sorted(module.name for module in pkgutil.iter_modules(eval.studies.__path__) if module.name[0] != "_")


def load(name: str) -> Any:
    """Import a study.

    Raises:
        ValueError: If there is none of this name.
    """
    require_known((name,), names(), "no study is called {}")
    return importlib.import_module(f"eval.studies.{name}")


def quick_ones(study: Any, given: StudyOptions) -> dict[str, Any]:
    """Options that stand for those not given, as JSON has them: with `--quick` those of a first try."""
    return plain(study.QUICK) if given.quick else {}


def run(study: Any, options: StudyOptions) -> Path:
    """Measure a study and write data, page and pictures; return their folder.

    Raises:
        ValueError: If an option is not allowed.
        OSError: If the folder cannot be written to.
    """
    require_bounds(options, **options.bounds)
    name = study.__name__.rpartition(".")[2]
    folder = options.out or Path("results") / name
    require_writable(folder)
    about, began = provenance(study.__name__), time.perf_counter()
    measured = study.measure(options)
    about |= {"seconds": round(time.perf_counter() - began, 1), "options": chosen_options(options)}
    write_data({"provenance": about, **measured}, folder)
    render(name, study, read_data(folder), folder)
    return folder


def chosen_options(options: StudyOptions) -> dict[str, Any]:
    """Options that decide what is measured, as JSON has them."""
    return plain({each.name: getattr(options, each.name) for each in fields(options) if each.name not in _PLACES})


def write_data(data: Mapping[str, Any], folder: Path) -> None:
    """Write the data of a page, an entry of its first two levels a line."""
    parts = []
    for key, value in plain(data).items():
        if isinstance(value, dict) and value:
            inner = ",\n".join(f"  {json.dumps(str(name))}: {json.dumps(entry)}" for name, entry in value.items())
            parts.append(f"{json.dumps(key)}: {{\n{inner}\n }}")
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            inner = ",\n".join(f"  {json.dumps(entry)}" for entry in value)
            parts.append(f"{json.dumps(key)}: [\n{inner}\n ]")
        else:
            parts.append(f"{json.dumps(key)}: {json.dumps(value)}")
    listed = ",\n ".join(parts)
    write_text(folder / DATA, f"{{\n {listed}\n}}\n")


def read_data(folder: Path, name: str = DATA) -> dict[str, Any]:
    """Read the data of a page.

    Raises:
        OSError: If they are not there.
        ValueError: If they are damaged.
    """
    try:
        return json.loads((folder / name).read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{folder / name} is damaged ({error}): measure it again") from None


def plain(value: Any) -> Any:
    """Data as JSON can hold them: arrays as lists, dataclasses as mappings, seven digits, null for no number."""
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if is_dataclass(value) and not isinstance(value, type):
        return plain(asdict(value))
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple | range):
        return [plain(entry) for entry in value]
    if isinstance(value, float | np.floating):
        return float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None
    if isinstance(value, np.integer | np.bool_):
        return value.item()
    return str(value) if isinstance(value, Path) else value


def render(name: str, module: Any, data: Mapping[str, Any], folder: Path) -> None:
    """Write the pictures of some data, and then the page, by the template of its name."""
    if hasattr(module, "pictures"):
        save_figures(module.pictures(data), folder, dpi=110, bbox_inches="tight")
    write_text(folder / PAGE, text_of(name, module, data))


def text_of(name: str, module: Any, data: Mapping[str, Any], template: str = TEMPLATE) -> str:
    """Text of a page, or of another template of its folder.

    A template may use `data`, `origin` and all that `tables` of the module gives. Filters are `number`, `percent`
    and `degrees`. For a metric, by its name, there are `heading`, `rounded` (a value) and `cell` (an estimate with its
    interval). `rule` is the line under a table's titles.

    Raises:
        jinja2.TemplateError: If the template uses anything else.
    """
    known = jinja2.FileSystemLoader(RESULTS / name)
    layout: dict[str, Any] = {"trim_blocks": True, "lstrip_blocks": True, "keep_trailing_newline": True}
    environment = jinja2.Environment(loader=known, undefined=jinja2.StrictUndefined, **layout)
    environment.filters |= {"number": shown, "percent": percent, "degrees": degrees}
    environment.globals |= {"heading": heading, "rounded": rounded, "cell": estimate_cell, "rule": rule}
    words = environment.get_template(template)
    return words.render(data=data, origin=origin(data["provenance"]), **module.tables(data))


def shown(value: float | None, digits: int) -> str:
    """A number of the data; a dash for none."""
    return number(math.nan if value is None else value, digits)


def percent(share: float | None, digits: int = 0) -> str:
    """A share of the data in percent; a dash for none."""
    return shown(share and 100 * share, digits)


def estimate_cell(name: str, value: Mapping[str, Any], more: int = 0) -> str:
    """An estimate of the data with its interval, as suits the metric of this name; `more` digits for differences."""
    return cell(name, SimpleNamespace(**value), more)


def rule(left: int, right: int) -> str:
    """Line under the titles of a table with some columns that are aligned to the left, then some to the right."""
    return f"|{left * '---|'}{right * '---:|'}"
