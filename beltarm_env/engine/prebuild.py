"""Builds beforehand what a wheel holds, see `shipped`; no other module imports this one, and `hatch_build.py` calls it.

Calls decide what is built: each kernel that runs is compiled for each level of a platform's processors. Its C is the
same for all of them.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from beltarm_env.engine import building, library, shipped
from beltarm_env.engine.entries import Entry, entry_of
from beltarm_env.engine.threads import each_in_threads

X86 = "x86_64_v2", "x86_64_v3", "x86_64_v4"
ARM = ("baseline",)


class Platform(NamedTuple):
    """Kind of machine.

    Args:
        system: Zig's name for it.
        levels: Of its processors.
        glue: Name of the module `_glue`.
    """

    system: str
    levels: tuple[str, ...]
    glue: str = "_glue.abi3.so"


PLATFORMS = {
    "manylinux_2_17_x86_64": Platform("x86_64-linux-gnu.2.17", X86),
    "manylinux_2_17_aarch64": Platform("aarch64-linux-gnu.2.17", ARM),
    "macosx_11_0_arm64": Platform("aarch64-macos.11.0", ARM),
    "macosx_11_0_x86_64": Platform("x86_64-macos.11.0", X86),
    "win_amd64": Platform("x86_64-windows-gnu", X86, "_glue.pyd"),
}
"""By the name that wheels have for them."""


class Call(NamedTuple):
    """First call of a kernel with arguments of some types."""

    words: list[Any]
    name: str
    entry: Entry


def prebuild(platform: Platform, use: Callable[[], None], out: Path) -> None:
    """Write what the folder `built` holds, for all levels of the platform or that of `BELTARM_LEVEL`.

    Args:
        platform: One of `PLATFORMS`.
        use: Makes the calls.
        out: The folder, written anew.

    Raises:
        BuildError: If something cannot be built.
    """
    compiler = building.compiler()
    if compiler is None or not compiler.zig:
        raise building.BuildError("only the compiler of the package ziglang builds wheels; unset BELTARM_CC")
    calls = calls_of(use)
    told = os.environ.get("BELTARM_LEVEL")
    levels = (told,) if told else platform.levels
    shutil.rmtree(out, ignore_errors=True)
    folder = out / shipped.sources()
    for level in levels:
        (folder / level).mkdir(parents=True)
    wanted = [(call, level) for call in calls for level in levels]
    each_in_threads(lambda one: _build_kernel(*one, platform, folder), wanted)
    _build_glue(platform, folder)
    noted = [(one.words, library.note_for(one.entry, _file_of(one, platform), codes=False)) for one in calls]
    notes = {shipped.key_of(words): note for words, note in noted}
    (folder / "kernels.json").write_text(json.dumps(notes), encoding="utf-8")
    (out / "sources.json").write_text(json.dumps(shipped.source_hashes()), encoding="utf-8")


def _file_of(call: Call, platform: Platform) -> str:
    return f"{call.name}.{shipped.key_of(call.words)}.{'dll' if 'windows' in platform.system else 'so'}"


def _build_kernel(call: Call, level: str, platform: Platform, folder: Path) -> None:
    defined = ["-Wl,-z,defs"] if "linux" in platform.system else []  # a name that is nowhere is an error here
    built = building.build(call.entry.text, call.name, target=level, system=platform.system, options=["-s", *defined])
    shutil.copyfile(built, folder / level / _file_of(call, platform))


def _build_glue(platform: Platform, folder: Path) -> None:
    lowest = "x86_64" if platform.system.startswith("x86_64") else "baseline"
    with tempfile.TemporaryDirectory() as scratch:
        library = [_import_library(Path(scratch))] if "windows" in platform.system else []
        options = ["-s", *building.glue_options(library, platform.system)]
        built = building.build(building.glue_text(), "_glue", target=lowest, system=platform.system, options=options)
        shutil.copyfile(built, folder / platform.glue)


def _import_library(scratch: Path) -> str:
    """Make what Windows needs to link with Python: its stable interface, as far as it is used."""
    declared = (building.SOURCES / "python_abi.h").read_text(encoding="utf-8")
    lines = re.findall(r"^PY_IMPORT (.*);$", declared, re.MULTILINE)
    functions = [name for line in lines for name in re.findall(r"\b(_?Py\w+)\(", line)]
    values = [f"{name} DATA" for line in lines if "(" not in line for name in re.findall(r"(\w+)(?=,|$)", line)]
    definition, library = scratch / "python3.def", scratch / "python3.lib"
    definition.write_text("\n".join(["LIBRARY python3.dll", "EXPORTS", *functions, *values, ""]), encoding="utf-8")
    compiler = building.compiler()
    assert compiler is not None
    command = [compiler.command[0], "dlltool", "-m", "i386:x86-64", "-d", str(definition), "-l", str(library)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise building.BuildError(f"python3.lib: {done.stderr.strip()}")
    return str(library)


def calls_of(use: Callable[[], None]) -> list[Call]:
    """Return the first call of each kernel and types, in their order, of those that run while something is used."""
    calls: list[Call] = []
    really = library.compiled

    def noted(function: Callable[..., Any], arguments: tuple[Any, ...], types: library.Types, checked: bool) -> Any:
        words = library.words_of(function, types, checked)
        if words is not None and function.__module__.startswith("beltarm_env."):
            entry = entry_of(function, arguments, checked)
            assert entry.read is not None, function.__qualname__
            calls.append(Call(words, function.__name__.strip("_"), entry))
        return really(function, arguments, types, checked)

    library.compiled = noted
    try:
        use()
    finally:
        library.compiled = really
    return calls
