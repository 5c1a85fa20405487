"""Draw learning curves: `python eval/curves.py`, or those of your own runs with `--runs FOLDER ...`.

A folder is that of a run, of a policy, or of several (seed0, seed1, ...). Thin lines are runs; the thick line is the
median of a method's runs, the band their interquartile range. Dashed: controllers that do not learn, on the same arms.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import run_command, stop_without

try:
    import tyro
    from matplotlib.backend_bases import FigureCanvasBase

    from baselines.tools.files import require_writable
    from eval.comparison.methods import shipped_policies
    from eval.report.curves import curves_figure, find_curves, levels
    from eval.report.style import save_figure
except ModuleNotFoundError as error:
    stop_without("eval/curves.py", error)


@dataclass(frozen=True)
class Config:
    """Draw learning curves."""

    runs: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="FOLDER ...")] = ()
    """Folders of runs, of policies, or of several of either. Default: the shipped policies."""
    out: Path = Path("results/curves")
    """Folder for curves.png, or a picture by name: curves.pdf."""


def run(config: Config) -> None:
    """Find the curves and draw them."""
    picture = config.out if config.out.suffix[1:] in FigureCanvasBase.filetypes else config.out / "curves.png"
    require_writable(picture.parent)
    curves = find_curves(list(config.runs) or shipped_policies())
    save_figure(curves_figure(curves, levels(curves)), picture)
    print(f"{len(curves)} runs; written to {picture}")


def main() -> None:
    """Command line."""
    run_command(__file__, Config, run, __doc__)


if __name__ == "__main__":
    main()
