"""What a controller takes on a small processor: flash, memory and stack, from its object."""

from __future__ import annotations

import re
import subprocess
import tempfile
from pathlib import Path
from typing import NamedTuple

from eval.deploy.building import SINGLE, Toolchain, processor
from eval.deploy.source import Loop
from eval.translation.scope import PREFIX


class Footprint(NamedTuple):
    """Bytes on a processor."""

    flash: int  # code and constants
    memory: int  # of the controller's struct
    stack: int  # of its deepest calls, a bound


PROCESSORS = {"cortex-m4": (SINGLE,), "cortex-m7": ()}
"""Processors, and the flags that each is built with: one has floats alone, the other doubles too."""


def processors_for(loop: Loop) -> list[str]:
    """Processors that a controller is for: one without doubles only if single precision does."""
    return [core for core, flags in PROCESSORS.items() if not (loop.identifies and SINGLE in flags)]


_MEMORY = """#include "{name}.h"
extern char memory[sizeof({name})];
char memory[sizeof({name})] = {{1}};
"""


def footprint(folder: Path, name: str, core: str) -> Footprint | None:
    """Compile for a processor and read what it takes; None where there is no compiler for it."""
    chain = processor(core)
    if chain is None:
        return None
    with tempfile.TemporaryDirectory() as made:
        target = Path(made) / "controller.o"
        chain.build([folder / f"{name}.c"], target, "-c", "-fstack-usage", *PROCESSORS[core])
        flash = _flash(chain, target)
        stack = _stack((folder / f"{name}.c").read_text(encoding="utf-8"), target.with_suffix(".su").read_text())
        probe = Path(made) / "memory.c"
        probe.write_text(_MEMORY.format(name=name))
        chain.build([probe], target, "-c", "-I", str(folder), *PROCESSORS[core])
        memory = _columns(chain, target)["data"]
    return Footprint(flash, memory, stack)


def _columns(chain: Toolchain, target: Path) -> dict[str, int]:
    tool = re.sub("gcc$", "size", chain.compiler[0])
    heads, numbers = subprocess.run([tool, str(target)], capture_output=True, text=True, check=True).stdout.splitlines()
    return dict(zip(heads.split(), (int(word) for word in numbers.split()[:3]), strict=False))


def _flash(chain: Toolchain, target: Path) -> int:
    found = _columns(chain, target)
    return found["text"] + found["data"]


def _stack(source: str, usage: str) -> int:
    """Bound of the stack: the sum along the deepest path of calls, those that were inlined taking none of their own."""
    own = {line.split("\t")[0].rsplit(":", 1)[1]: int(line.split("\t")[1]) for line in usage.splitlines()}
    own = {name.partition(".")[0]: size for name, size in own.items()}
    bodies = re.split(r"\n(?=static |void |real |int32_t )", source)
    calls: dict[str, set[str]] = {}
    for body in bodies:
        head = re.match(r"[\w *]*?(\w+)\(", body)
        if head:
            calls[head[1]] = set(re.findall(rf"\b({PREFIX}\w+|begin_move|sample|arithmetic_fault)\(", body)) - {head[1]}
    depth: dict[str, int] = {}

    def deepest(name: str) -> int:
        if name not in depth:
            depth[name] = own.get(name, 0) + max((deepest(other) for other in calls.get(name, ())), default=0)
        return depth[name]

    return max((deepest(name) for name in calls), default=0)
