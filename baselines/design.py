"""Design the gains that are kept because their design takes long: `python baselines/design.py`.

They are those of `robust` with its tuned weights, in `baselines/optimal/robust.json`. Run it when the tests say that
the design has changed.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines import CONTROLLERS
from baselines.optimal.kept import FILE, keep
from baselines.tools.command import run_command


@dataclass(frozen=True)
class Config:
    """Design gains and keep them."""

    out: Path = FILE
    """File of the gains."""


def run(config: Config) -> None:
    """Design gains and keep them."""
    design = CONTROLLERS["robust"]().design
    keep(design.content(), design.gains(), config.out)
    print(f"written to {config.out}")


def main() -> None:
    """Command line."""
    run_command(__file__, Config, run, __doc__)


if __name__ == "__main__":
    main()
