"""The least attainable cost: `python baselines/oracle.py` plans with the true arm and stores the torques.

See `baselines.yardsticks.oracle` for what is planned, replayed and stored.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

from baselines.tools.command import one_line_errors
from baselines.tools.files import require_writable, write_text
from baselines.tools.provenance import command_line
from baselines.yardsticks.oracle import FILE, RANDOMIZATION, Scenario, solve
from beltarm_env import __version__


@dataclass(frozen=True)
class Config:
    """Plan with the true arm, replay in the environment, store."""

    scenario: tuple[str, ...] = tuple(f"{kind}:{5_000_000 + k}" for kind in RANDOMIZATION for k in range(5))
    """Scenarios as KIND:SEED; KIND is nominal or train (arms from the training ranges)."""
    out: Path = FILE
    """File to write."""


def run(config: Config) -> None:
    """Solve all scenarios, print what came out and write the file.

    Raises:
        ValueError: If a scenario is not allowed.
        OSError: If the file cannot be written.
    """
    scenarios = [Scenario.parse(text) for text in config.scenario]
    require_writable(config.out.parent)
    rows = []
    for scenario in scenarios:
        rows.append(row := solve(scenario))
        print(
            f"{row['kind']}:{row['seed']}  cost {row['cost']:.1f}  tip RMS {row['tip_rms_mm']:.2f} mm  residual p-p "
            f"{row['residual_pp_mm']:.2f} mm  optimiser {row['optimiser_cost']:.1f}  {row['seconds']:.0f} s"
            + ("" if row["converged"] else "  (not converged)"),
            flush=True,
        )
    versions = {"beltarm_env": __version__, "casadi": version("casadi"), "numpy": np.__version__}
    stored = {"command": command_line(), "versions": versions, "scenarios": rows}
    write_text(config.out, json.dumps(stored, indent=1) + "\n")


def main() -> None:
    """Command line."""
    try:
        import casadi  # noqa: F401
        import tyro
    except ModuleNotFoundError as error:
        print(f"baselines/oracle.py: {error.name} is not installed; run `pip install -e '.[oracle]'`", file=sys.stderr)
        sys.exit(2)
    with one_line_errors("baselines/oracle.py"):
        run(tyro.cli(Config, description=__doc__))


if __name__ == "__main__":
    main()
