"""Compilers: generated sources as a program of this machine, or of another one that an emulator runs."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Wpedantic", "-Werror")
"""How generated sources are compiled."""
SINGLE = "-DBELTARM_SINGLE"
"""Flag for a program in single precision."""
SANITISED = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g")
"""Further flags for a program that stops at the first wrong access or undefined operation."""


@dataclass(frozen=True)
class Toolchain:
    """A compiler, and what runs its programs."""

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


def here() -> Toolchain:
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
        if found := shutil.which(name):
            return Toolchain((found, *arguments))
    looked = f"CC={named!r} is not there" if named else "neither cc, gcc nor clang is there"
    raise ValueError(f"no C compiler: {looked}. Install one, name it in CC, or write the sources alone with --no-check")


_EMULATED = {
    "aarch64": ("aarch64-linux-gnu-gcc", "aarch64-linux-musl", "qemu-aarch64", ()),
    "arm": ("arm-linux-gnueabihf-gcc", "arm-linux-musleabihf", "qemu-arm", ("-mcpu=cortex_a7",)),
}


def emulated(machine: str) -> Toolchain | None:
    """Find compiler and emulator for "aarch64" or "arm" (32 bit, hard float): a cross compiler or `ziglang`, and qemu.

    Returns:
        None where either is missing.
    """
    cross, target, emulator, flags = _EMULATED[machine]
    runner = shutil.which(emulator) or shutil.which(f"{emulator}-static")
    if runner is None:
        return None
    if found := shutil.which(cross):
        return Toolchain((found, "-static"), (runner,))
    if find_spec("ziglang"):
        return Toolchain((sys.executable, "-m", "ziglang", "cc", "-target", target, "-static", *flags), (runner,))
    return None


def processor(name: str) -> Toolchain | None:
    """Find a compiler for objects of "cortex-m4" or "cortex-m7"; None where there is none."""
    unit = {"cortex-m4": "fpv4-sp-d16", "cortex-m7": "fpv5-d16"}[name]
    if found := shutil.which("arm-none-eabi-gcc"):
        return Toolchain((found, f"-mcpu={name}", f"-mfpu={unit}", "-mfloat-abi=hard", "-mthumb"))
    return None
