"""The house: packages and their folders import one way, from the bottom up, and commands are imported by nobody."""

import ast
import re
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import pytest
from commands import ROOT, is_command

from beltarm_env.sources import source_files

FLOORS = {
    "beltarm_env": (
        *("sources", "engine", "arrays timing", "arm", "physics"),
        *("observation", "task", "kernels metrics"),
        *("rendering", "mujoco", "info", "arguments simulation batch recording", "env", "vector_env", "rollout"),
    ),
    "baselines": (
        *("tools", "engines", "gains reading", "controller models", "estimation planning", "servo optimal"),
        *("yardsticks loops", "registry", "guard tuning"),
    ),
    "agents": ("tensor_file residual", "policy", "runs", "observer", "learners"),
    "eval": ("comparison reference", "report", "exports", "studies", "speed"),
}
"""From the bottom up: a module may import what stands on a lower floor, and what is in its own room.

Rooms on one floor do not know one another.
"""
PACKAGES = (*FLOORS, "train")
ABOVE = {
    "beltarm_env": {"baselines", "agents", "train", "eval"},
    "baselines": {"agents", "train", "eval"},
    "agents": {"train", "eval"},
}
DEPENDENCIES = {"gymnasium", "numpy"}
OPTIONAL = {"pygame", "mujoco", "matplotlib", "pandas", "pyarrow"}


def modules(package: str) -> Iterator[tuple[str, Path]]:
    for path in (path for path in source_files(ROOT / package) if path.suffix == ".py"):
        parts = path.relative_to(ROOT).with_suffix("").parts
        yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts), path


KNOWN = {name for package in PACKAGES for name, _ in modules(package)}


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def named(nodes: Iterable[ast.AST]) -> set[str]:
    """Modules that statements import: those of this project, else what is imported from."""
    found: set[str] = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0 and node.module, "a relative import"
            found |= ({f"{node.module}.{alias.name}" for alias in node.names} & KNOWN) or {node.module}
    return found


@cache
def imported(path: Path) -> set[str]:
    """Modules that a file imports anywhere, inside functions too."""
    return named(ast.walk(tree(path)))


def room(module: str) -> str:
    return ".".join(module.split(".")[:2])


@pytest.mark.parametrize("package", FLOORS)
def test_packages_and_their_folders_import_one_way(package: str):
    floor_of = {f"{package}.{name}": k for k, floor in enumerate(FLOORS[package]) for name in floor.split()}
    for module, path in modules(package):
        assert {name.split(".")[0] for name in imported(path)}.isdisjoint(ABOVE.get(package, ())), module
        if module == package or is_command(path):
            continue  # the package itself names what is public; commands are on top of everything
        assert room(module) in floor_of, f"{module} stands on no floor: add it to FLOORS"
        for other in imported(path) & KNOWN:
            if other.split(".")[0] == package and room(other) not in (room(module), package):
                assert floor_of[room(other)] < floor_of[room(module)], f"{module} imports {other}"


def test_the_environment_needs_what_it_declares_and_imports_the_rest_where_it_is_used_and_no_controller_needs_it():
    for module, path in modules("beltarm_env"):
        others = {name.split(".")[0] for name in imported(path)} - set(sys.stdlib_module_names) - {"beltarm_env"}
        assert others <= DEPENDENCIES | OPTIONAL, module
        assert {name.split(".")[0] for name in named(tree(path).body)}.isdisjoint(OPTIONAL), module
    for module, path in modules("baselines"):  # which do not know the environment's class
        assert not re.search(r"BeltArm(Vector)?Env", path.read_text(encoding="utf-8")), module


def test_studies_do_not_know_one_another():
    for module, path in modules("eval"):
        own = module.split(".")[2:3]
        if module.startswith("eval.studies.") and not own[0].startswith("_"):
            others = {other for other in imported(path) if other.startswith("eval.studies.") and "._" not in other}
            assert {other.split(".")[2] for other in others} <= {*own}, module


def test_commands_are_thin_and_no_module_imports_one():
    """A command has its options, the order of calls and `main`; whatever computes is in a folder."""
    every = [(module, path) for package in PACKAGES for module, path in modules(package)]
    commands = {module: path for module, path in every if is_command(path)}
    assert {"eval.compare", "train.ppo", "baselines.tune"} <= {*commands}
    for module, path in commands.items():
        classes = [node.name for node in tree(path).body if isinstance(node, ast.ClassDef)]
        functions = [node.name for node in tree(path).body if isinstance(node, ast.FunctionDef)]
        assert classes in ([], ["Config"]) and len(functions) <= 2, f"{module} has {classes + functions}"
    for module, path in every:
        assert imported(path).isdisjoint(commands), f"{module} imports a command"
