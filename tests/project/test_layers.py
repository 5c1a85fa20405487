"""The house: packages and their folders import one way, from the bottom up, and commands are imported by nobody."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FLOORS = {
    "beltarm_env": (
        *(
            "arrays sources timing",
            "jit",
            "threads",
            "arm",
            "physics",
            "observation metrics",
            "task",
            "kernels",
            "rendering",
            "mujoco",
        ),
        *("arguments simulation batch recording", "env", "vector_env", "rollout"),
    ),
    "baselines": (
        *("tools", "engines", "gains reading", "controller models", "estimation planning", "servo optimal"),
        *("iterative yardsticks loops", "registry", "guard tuning"),
    ),
    "agents": ("residual", "policy", "runs", "learners observer"),
    "eval": ("comparison reference translation", "report", "exports", "studies", "speed"),
}
"""From the bottom up: a module may import what stands on a lower floor, and what is in its own room.

Rooms on one floor do not know one another.
"""
PACKAGES = (*FLOORS, "train")


def modules(package: str) -> Iterator[tuple[str, Path]]:
    """Dotted names and files of a package."""
    for path in sorted((ROOT / package).rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts), path


KNOWN = {name for package in PACKAGES for name, _ in modules(package)}


def imported(path: Path) -> set[str]:
    """Modules of this project that a file imports anywhere, inside functions too."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            inside = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= (inside & KNOWN) or {node.module}
    return found & KNOWN


def room(module: str) -> str:
    """The folder or module right below its package."""
    return ".".join(module.split(".")[:2])


def is_command(path: Path) -> bool:
    return '__name__ == "__main__"' in path.read_text(encoding="utf-8")


@pytest.mark.parametrize("package", FLOORS)
def test_folders_of_a_package_import_one_way(package: str):
    floor_of = {f"{package}.{name}": k for k, floor in enumerate(FLOORS[package]) for name in floor.split()}
    for module, path in modules(package):
        if module == package or is_command(path):
            continue  # the package itself names what is public; commands are on top of everything
        assert room(module) in floor_of, f"{module} stands on no floor: add it to FLOORS"
        for other in imported(path):
            if other.split(".")[0] == package and room(other) not in (room(module), package):
                assert floor_of[room(other)] < floor_of[room(module)], f"{module} imports {other}"


def test_studies_do_not_know_one_another():
    for module, path in modules("eval"):
        own = module.split(".")[2:3]
        if module.startswith("eval.studies.") and not own[0].startswith("_"):
            others = {other for other in imported(path) if other.startswith("eval.studies.")}
            strangers = {other for other in others if other.split(".")[2] != own[0] and "._" not in other}
            assert not strangers, f"{module} imports {sorted(strangers)}"


def test_no_command_is_imported():
    commands = {module for package in PACKAGES for module, path in modules(package) if is_command(path)}
    assert {"eval.compare", "train.ppo", "baselines.tune"} <= commands
    for package in PACKAGES:
        for module, path in modules(package):
            assert not imported(path) & commands, f"{module} imports a command"


def test_commands_are_thin():
    """A command has its options, the order of calls and `main`; whatever computes is in a folder."""
    for package in PACKAGES:
        for module, path in modules(package):
            if is_command(path):
                body = ast.parse(path.read_text(encoding="utf-8")).body
                classes = [node.name for node in body if isinstance(node, ast.ClassDef)]
                functions = [node.name for node in body if isinstance(node, ast.FunctionDef)]
                assert classes in ([], ["Config"]) and len(functions) <= 2, f"{module} has {classes + functions}"
