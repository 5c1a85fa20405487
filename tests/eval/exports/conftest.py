"""Exported programs, each written and compiled once for all tests."""

import shutil
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import translating

from eval.comparison.sets import development_set
from eval.exports.compilers import Toolchain
from eval.exports.in_the_loop import compare
from eval.exports.program import controller_of, loop_of, write_program
from eval.exports.source import Loop

in_python = cache(controller_of)


@dataclass(frozen=True)
class CachingToolchain(Toolchain):
    programs: dict[Any, Path] = field(default_factory=dict, compare=False)

    def build(self, sources: list[Path], program: Path, *flags: str) -> None:
        key = (*sources, *self.flags, *flags)
        if key not in self.programs:
            kept = sources[0].with_name(f"{program.name}-{len(self.programs)}")
            super().build(sources, kept, *flags)
            self.programs[key] = kept
        shutil.copy(self.programs[key], program)


@dataclass(frozen=True)
class Exported:
    folder: Path
    loop: Loop
    source: str
    guard: bool
    toolchain: Toolchain

    @property
    def text(self) -> str:
        return (self.folder / f"{self.loop.name}.c").read_text()

    def assert_equal(
        self, split: str, toolchain: Toolchain | None = None, flags: tuple[str, ...] = (), moves: int = 1
    ) -> None:
        """Assert that program and controller ask for the same torques on a development scenario, or a shift of it."""
        scenarios = development_set().splits[split]
        if moves > 1:
            scenarios = replace(scenarios, settings={**scenarios.settings, "moves": moves, "randomization": "train"})
        python = in_python(self.source, self.guard)
        with_flags = replace(toolchain or self.toolchain, flags=flags)
        agreement = compare(self.folder, self.loop, python, scenarios, 1, with_flags)
        assert agreement.samples > 1000
        assert agreement.equal == agreement.samples, f"{split}: {agreement.words()}"
        assert np.array_equal(*agreement.costs)


class Exports:
    def __init__(self, folder: Path, toolchain: Toolchain) -> None:
        self.folder, self.toolchain = folder, toolchain
        self.made: dict[tuple[str, bool], Exported] = {}

    def of(self, source: str, guard: bool = True) -> Exported:
        if (source, guard) not in self.made:
            loop = loop_of(source, guard)
            folder = self.folder / f"{loop.name}-{guard}"
            write_program(folder, loop)
            self.made[source, guard] = Exported(folder, loop, source, guard, self.toolchain)
        return self.made[source, guard]


@pytest.fixture(scope="session")
def compiler() -> tuple[str, ...]:
    """Command of this machine's compiler; the test is skipped where there is none."""
    return translating.compiler().compiler


@pytest.fixture(scope="session")
def exports(compiler: tuple[str, ...], tmp_path_factory: pytest.TempPathFactory) -> Exports:
    return Exports(tmp_path_factory.mktemp("exports"), CachingToolchain(compiler))
