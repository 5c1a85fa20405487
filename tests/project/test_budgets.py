"""The size of the house: what outgrows its budget takes something away first."""

import subprocess
from pathlib import Path

import pytest
from commands import PACKAGES, ROOT, is_command

LINES = {"eval": 13_000, "tests": 16_000}
COMMANDS, MODULES = 11, 15
DOCS = 6e6  # bytes of tracked files


def sources(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*.py") if "__pycache__" not in path.parts]


@pytest.mark.parametrize("folder", LINES)
def test_lines(folder: str):
    assert sum(path.read_bytes().count(b"\n") for path in sources(ROOT / folder)) <= LINES[folder]


def test_commands_and_documents():
    assert len([path for path in (ROOT / "eval").glob("*.py") if is_command(path)]) <= COMMANDS
    listed = subprocess.run(["git", "ls-files", "docs"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode:
        pytest.skip("this is no checkout")
    paths = [ROOT / name for name in listed.stdout.splitlines()]
    assert sum(path.stat().st_size for path in paths if path.is_file()) <= DOCS


@pytest.mark.parametrize("package", PACKAGES)
def test_modules_of_a_folder(package: str):
    for folder in {path.parent for path in sources(ROOT / package)}:
        inside = [path for path in folder.glob("*.py") if path.name != "__init__.py" and not is_command(path)]
        assert len(inside) <= MODULES, f"{folder.relative_to(ROOT)} has {len(inside)} modules"
