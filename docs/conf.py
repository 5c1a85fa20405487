"""The documentation site, built by `make docs`: every page of docs/, and what only a site can show.

The pages are written for a forge's Markdown too. What differs here is done by the hooks at the end: formulas between
$` and `$, and links to files that are no pages.
"""

from __future__ import annotations

import inspect
import re
import sys
import tomllib
from os.path import normpath
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.errors import ConfigError
from sphinxcontrib.katex import katex_version

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
sys.path[:0] = [str(ROOT), str(DOCS)]

from beltarm_env import BeltArmEnv, __version__
from beltarm_env.metrics import METRICS, heading
from eval.comparison.splits import EPISODES, SPLITS
from eval.exports.hub import CITATION, bibtex
from eval.report.text import markdown_table

REPOSITORY = (
    tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"].get("urls", {}).get("Source")
)
"""Address of the repository, where `project.urls` has one: links to source files lead there, and are text without."""

project, author, release = "beltarm", CITATION["authors"][0]["name"], __version__
copyright = author
extensions = [
    "matplotlib.sphinxext.plot_directive",
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_gallery.gen_gallery",
    "sphinxcontrib.katex",
]
exclude_patterns = ["_build", "_static", "tutorials"]
default_role = "py:obj"
highlight_language = "none"

html_theme = "furo"
html_title = "beltarm"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sphinx = False
html_copy_source = False

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath", "substitution"]
myst_fence_as_directive = ["math"]
myst_heading_anchors = 4
katex_css_path = "katex/katex.min.css"

autodoc_typehints = "none"
autodoc_member_order = "bysource"
napoleon_numpy_docstring = False

plot_pre_code = "from pictures import motion"
plot_formats = [("png", 110)]
plot_include_source = plot_html_show_formats = plot_html_show_source_link = False
plot_rcparams = {"font.size": 10}

sphinx_gallery_conf = {
    "examples_dirs": "tutorials",
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$",
    "within_subsection_order": "FileNameSortKey",
    "write_computation_times": False,
    "show_memory": False,
    "show_signature": False,
    "download_all_examples": False,
    "capture_repr": (),
    "reset_modules": ("pictures.lay_out_figures",),
}


def table_of_splits() -> str:
    """Describe the splits of the comparison, as `eval/comparison/splits.py` has them."""
    return markdown_table(
        ("split", f"its {EPISODES} scenarios"), [(f"`{n}`", s.description) for n, s in SPLITS.items()], "ll"
    )


def table_of_metrics() -> str:
    """Name the metrics that tables show, with units and the names that they have in results."""
    shown = [(heading(name), f"`{name}`") for name, metric in METRICS.items() if not metric.detail]
    return markdown_table(("in tables", "in `results.json` and `Recording.metrics()`"), shown, "ll")


myst_substitutions = {
    "environment": inspect.cleandoc(BeltArmEnv.__doc__ or ""),
    "splits": table_of_splits(),
    "metrics": table_of_metrics(),
    "citation": f"```bibtex\n{bibtex()}\n```",
}

PAGES = {
    "README.md": "index",
    "CONTRIBUTING.md": "contributing",
    "SECURITY.md": "security",
    "CHANGELOG.md": "changelog",
    "CITATION.cff": "citing",
    "docs/tutorials": "gallery/index",
    **{f"docs/tutorials/{path.name}": f"gallery/{path.stem}" for path in (DOCS / "tutorials").glob("*.py")},
}
"""Files outside docs/ that a page of the site includes, and what the gallery shows."""


def adapt_page(app: Sphinx, doctree: nodes.document) -> None:
    """Make of a page in a forge's Markdown one of the site: its formulas, and its links to what is no page."""
    for formula in doctree.findall(nodes.math):
        text = formula.astext().strip("`")
        formula.children = [nodes.Text(text)]
    for link in list(
        doctree.findall(lambda node: isinstance(node, (addnodes.pending_xref, addnodes.download_reference)))
    ):
        if link.get("reftype") == "myst":
            adapt_link(link, Path(app.env.doc2path(link["refdoc"])).parent)


def adapt_link(link: nodes.Element, folder: Path) -> None:
    """Show a page by its title where a link names the file; leave docs/ for the repository, or not at all."""
    shown = link.astext()
    if link.get("refdomain") == "doc":
        link["refexplicit"] = not re.fullmatch(r"[\w./-]+\.md", shown)
        return
    target, _, anchor = link["reftarget"].partition("#")
    found = next((path for path in (Path(normpath(folder / target)), ROOT / target) if target and path.exists()), None)
    name = found.relative_to(ROOT).as_posix() if found else ""
    if found is None or (name not in PAGES and found.is_relative_to(DOCS) and found.is_file()):
        return  # an unknown target, of which the build warns, or a file to be shipped
    if name in PAGES:
        wanted = {"refdomain": "doc", "reftype": "myst", "reftarget": PAGES[name], "reftargetid": anchor or None}
        new = addnodes.pending_xref("", *link.children, refdoc=link["refdoc"], **wanted)
        new["refexplicit"] = shown != name
    elif REPOSITORY:
        new = nodes.reference("", "", *link.children, refuri=f"{REPOSITORY}/blob/main/{name}")
    else:
        new = nodes.inline("", "", *link.children)
    link.replace_self(new)


def adapt_docstring(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Leave out what is below Markdown headings, which another page includes, and colons that stand for no type."""
    start = next((k for k, line in enumerate(lines) if line.startswith("## ")), len(lines))
    del lines[start:]
    if what == "module":  # what its docstring indents, such as formulas, is shown as it is written
        blocks = [k for k in range(2, len(lines)) if lines[k].startswith("    ") and lines[k - 1 : k] == [""]]
        for k in reversed([k for k in blocks if not lines[k - 2].startswith(" ")]):
            lines[k:k] = ["::", ""]
    values = [0] if what in ("attribute", "data", "property") else []
    values += [k + 1 for k, line in enumerate(lines) if line.strip() == "Returns:"]
    for k in values:
        lines[k] = lines[k].replace(": ", " – ", 1)


def check_katex(app: Sphinx, config: Any) -> None:
    """Check that style and fonts of formulas are of the same version as their script."""
    if f'content:"{katex_version}"' not in (DOCS / "_static" / katex_css_path).read_text(encoding="utf-8"):
        raise ConfigError(f"docs/_static/katex is not KaTeX {katex_version}, which sphinxcontrib-katex has: renew it")


def setup(app: Sphinx) -> None:
    """Connect the hooks; links come before the collection of files to ship, docstrings before Napoleon."""
    app.connect("config-inited", check_katex)
    app.connect("doctree-read", adapt_page, priority=100)
    app.connect("autodoc-process-docstring", adapt_docstring, priority=100)
