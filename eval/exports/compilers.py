"""Compilers of exported sources: for this machine, for another one that an emulator runs, for small processors."""

import os
import re
import shlex
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

_WARNINGS = ("-Wall", "-Wextra", "-Wpedantic", "-Werror", "-Wno-unused-function")  # clang's, of inline functions
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", *_WARNINGS)
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
    flags: tuple[str, ...] = ()  # of all programs, such as `SINGLE`

    def build(self, sources: list[Path], program: Path, *flags: str) -> None:
        """Compile and link sources.

        Raises:
            ValueError: If that fails, with the compiler's first lines.
        """
        command = [*self.compiler, *FLAGS, *self.flags, *flags, *map(str, sources), "-o", str(program)]
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


PROCESSORS = {"cortex-m4": ("-mfpu=fpv4-sp-d16", SINGLE), "cortex-m7": ("-mfpu=fpv5-d16",)}
"""Processors with the flags of their builds: the first computes in single precision alone."""


def processors_for(identifies: bool) -> list[str]:
    """Processors for a controller: those without doubles only where it does not identify its arm."""
    return [core for core, flags in PROCESSORS.items() if not (identifies and SINGLE in flags)]


def footprint(folder: Path, name: str, core: str) -> Footprint | None:
    """Compile a controller for one of `PROCESSORS` and measure it; None where there is no compiler."""
    path = shutil.which("arm-none-eabi-gcc")
    if path is None:
        return None
    chain = Toolchain((path, f"-mcpu={core}", "-mfloat-abi=hard", "-mthumb", *PROCESSORS[core]))
    with tempfile.TemporaryDirectory() as made:
        source, target = Path(made) / "one.c", Path(made) / "one.o"
        source.write_text(f'#include "{folder.resolve() / name}.c"\n{name} memory;\n')  # in the section of zeros
        # The graph of calls names a function that is folded into an equal one, and does not have it.
        chain.build([source], target, "-c", "-fno-common", "-fno-ipa-icf", "-fcallgraph-info=su")
        listed = subprocess.check_output([re.sub("gcc$", "size", path), str(target)], text=True).splitlines()[1]
        text, data, memory = map(int, listed.split()[:3])
        return Footprint(text + data, memory, _deepest(target.with_suffix(".ci").read_text()))


def _deepest(graph: str) -> int:
    """Bytes of stack along the deepest path of GCC's graph of calls; exact functions of libraries count as none."""
    nodes = re.findall(r'node: { title: "(.*?)" label: "(?:[^"]*\\n(\d+) bytes)?', graph)
    calls = re.findall(r'edge: { sourcename: "(.*?)" targetname: "(.*?)"', graph)

    @cache
    def deepest(name: str) -> int:
        own = max(int(size or 0) for node, size in nodes if node == name)
        return own + max((deepest(called) for caller, called in calls if caller == name), default=0)

    return max(deepest(name) for name, _ in nodes)
