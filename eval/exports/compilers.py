"""Compilers of exported sources: for this machine, for another one that an emulator runs, for small processors."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from eval.translation.scope import PREFIX

FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Wpedantic", "-Werror")
"""Flags that exported sources are compiled with."""
SINGLE = "-DBELTARM_SINGLE"
"""Flag for a program in single precision."""
SANITISED = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g")
"""Further flags for a program that stops at the first wrong access or undefined operation."""


@dataclass(frozen=True)
class Toolchain:
    """A compiler, and the command that runs its programs."""

    compiler: tuple[str, ...]
    runner: tuple[str, ...] = ()

    def build(self, sources: list[Path], program: Path, *flags: str) -> None:
        """Compile and link sources.

        Raises:
            ValueError: If that fails, with the compiler's first lines.
        """
        command = [*self.compiler, *FLAGS, *flags, *map(str, sources), "-o", str(program)]
        done = subprocess.run(
            [*command, *([] if "-c" in flags else ["-lm"])], capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise ValueError(f"{shlex.join(command)} failed:\n" + "\n".join(done.stderr.splitlines()[:20]))


def native() -> Toolchain:
    """Find a compiler for this machine: the command in the environment variable CC, or cc, gcc or clang.

    Raises:
        ValueError: If there is none.
    """
    named = os.environ.get("CC", "").strip()
    try:
        commands = [shlex.split(named)] if named else [["cc"], ["gcc"], ["clang"]]
    except ValueError as error:
        raise ValueError(f"CC={named!r} is no command: {error}") from None
    for name, *arguments in commands:
        if path := shutil.which(name):
            return Toolchain((path, *arguments))
    looked = f"CC={named!r} is not there" if named else "neither cc, gcc nor clang is there"
    raise ValueError(f"no C compiler: {looked}. Install one, name it in CC, or write the sources alone with --no-check")


class Footprint(NamedTuple):
    """Bytes on a processor."""

    flash: int  # code and constants
    memory: int  # of the controller's struct
    stack: int  # of its deepest calls, a bound


PROCESSORS = {"cortex-m4": (SINGLE,), "cortex-m7": ()}
"""Processors with the flags of their builds: the first computes in single precision alone."""
_UNITS = {"cortex-m4": "fpv4-sp-d16", "cortex-m7": "fpv5-d16"}


def processors_for(identifies: bool) -> list[str]:
    """Processors for a controller: those without doubles only where it does not identify its arm."""
    return [core for core, flags in PROCESSORS.items() if not (identifies and SINGLE in flags)]


def processor(core: str) -> Toolchain | None:
    """Find a compiler for objects of one of `PROCESSORS`; None where there is none."""
    if path := shutil.which("arm-none-eabi-gcc"):
        return Toolchain((path, f"-mcpu={core}", f"-mfpu={_UNITS[core]}", "-mfloat-abi=hard", "-mthumb"))
    return None


_MEMORY = """#include "{name}.h"
extern char memory[sizeof({name})];
char memory[sizeof({name})] = {{1}};
"""


def footprint(folder: Path, name: str, core: str) -> Footprint | None:
    """Compile a controller for a processor and measure it; None where there is no compiler."""
    chain = processor(core)
    if chain is None:
        return None
    with tempfile.TemporaryDirectory() as made:
        target = Path(made) / "controller.o"
        chain.build([folder / f"{name}.c"], target, "-c", "-fstack-usage", *PROCESSORS[core])
        sizes = _columns(chain, target)
        stack = _stack((folder / f"{name}.c").read_text(encoding="utf-8"), target.with_suffix(".su").read_text())
        probe = Path(made) / "memory.c"
        probe.write_text(_MEMORY.format(name=name))
        chain.build([probe], target, "-c", "-I", str(folder), *PROCESSORS[core])
        memory = _columns(chain, target)["data"]
    return Footprint(sizes["text"] + sizes["data"], memory, stack)


def _columns(chain: Toolchain, target: Path) -> dict[str, int]:
    """Sizes of an object's sections [bytes]."""
    tool = re.sub("gcc$", "size", chain.compiler[0])
    heads, numbers = subprocess.run([tool, str(target)], capture_output=True, text=True, check=True).stdout.splitlines()
    return dict(zip(heads.split(), (int(word) for word in numbers.split()[:3]), strict=False))


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
