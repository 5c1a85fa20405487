"""Write a controller or policy as C for a drive's processor: `python eval/export.py adaptive --out DIR`.

The C99 is translated from the very kernels that comparisons run, and checked against them on development scenarios, bit
for bit. `python eval/export.py arm --out DIR` writes the arm itself, as an FMU for other simulators.
docs/guide/export.md tells how to use them.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import tyro

from baselines.tools.command import require_bounds, run_command
from beltarm_env import ArmParams
from eval.comparison.sets import development_set
from eval.comparison.splits import main_split
from eval.deploy.building import here
from eval.deploy.check import compare
from eval.deploy.controllers import controller_of, loop_of
from eval.deploy.package import require_free, write, write_arm
from eval.deploy.sizes import footprint, processors_for

ARM = "arm"


@dataclass(frozen=True)
class Config:
    """Write a controller or policy as C for a drive's processor, or the arm as an FMU."""

    source: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="CONTROLLER|POLICY|arm")]
    """Name of a classical controller, folder of a policy, or `arm`."""
    out: Path
    """Folder to write: a new or empty one, or one of an earlier export."""
    name: str = ""
    """What functions and files are called, instead of like the controller: for several exports in one program."""
    guard: bool = True
    """Leave out the guard between controller and motor."""
    plan_samples: int = 1
    """Samples over which a plan is spread that `adaptive` makes anew while the arm moves, 1 to 19. For processors on
    which it takes longer than a sample. 1 is what was compared; more is another controller, if only a little."""
    onnx: bool = False
    """Write the policy's network as policy.onnx as well. Needs the extra onnx."""
    check: bool = True
    """Write the sources alone, without compiling them and comparing them with Python."""
    episodes: int = 4
    """Development scenarios that they are compared on, 1 to 200."""


def export(config: Config) -> None:
    """Write the folder, and check what is in it.

    Raises:
        ValueError: If an option is not allowed, something cannot be translated, there is no compiler, or program and
            controller differ.
        OSError: If the folder cannot be written to.
    """
    require_bounds(config, episodes=(1, 200), plan_samples=(1, 19))
    require_free(config.out)
    if config.source == ARM:
        if config.name:
            raise ValueError(f"--name is for controllers: an FMU is called beltarm; leave out --name {config.name}")
        platforms = write_arm(config.out, ArmParams())
        print(f"written to {config.out}: beltarm.fmu, for {', '.join(platforms)}")
        return
    if config.check:
        here()  # before the work, not after it
    loop = loop_of(config.source, config.guard, config.plan_samples)
    loop = replace(loop, name=config.name) if config.name else loop
    more = {}
    if config.onnx:
        from agents.policy.onnx_model import onnx_model

        more["policy.onnx"] = onnx_model(Path(config.source)).SerializeToString()
    write(config.out, loop, more)
    print(f"written to {config.out}: {loop.name}.h, {loop.name}.c and what goes with them")
    if config.check:
        scenarios = development_set()
        split = scenarios.splits[main_split(list(scenarios.splits))]
        found = compare(config.out, loop, controller_of(config.source, config.guard), split, config.episodes)
        print(found.words())
        for core in processors_for(loop):
            if taken := footprint(config.out, loop.name, core):
                kilobytes = [f"{size / 1024:.0f} kB of {kind}" for size, kind in zip(taken, taken._fields, strict=True)]
                print(f"{core}: {', '.join(kilobytes)}")
        if found.equal < found.samples and config.plan_samples == 1:
            differing = found.samples - found.equal
            raise ValueError(f"program and controller differ in {differing} of {found.samples} samples")


def main() -> None:
    """Command line."""
    run_command(__file__, Config, export, __doc__)


if __name__ == "__main__":
    main()
