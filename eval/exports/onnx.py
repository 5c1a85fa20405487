"""The network of a policy as an ONNX model, for runtimes that know nothing of this project.

docs/guide/export.md tells how to use it. Needs the extra onnx.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from agents.policy.onnx_model import write_onnx


@dataclass(frozen=True)
class Options:
    """Write the network of a policy as an ONNX model."""

    policy: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="POLICY")]
    """Folder of a policy, such as runs/ppo/best."""
    out: Path = Path("results/policy.onnx")
    """File to write or replace."""


def export(options: Options) -> None:
    """Write the model."""
    if options.out.suffix != ".onnx":
        raise ValueError(f"--out must end in .onnx, got {options.out}")
    write_onnx(options.policy, options.out)
    print(f"written to {options.out}")
