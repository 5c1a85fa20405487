"""Translation of kernels to C: restricted Python, function by function, type by type."""

from pathlib import Path

HEADERS = Path(__file__).parents[1] / "c"
"""Folder of the headers that the C of a program includes."""


def header(name: str) -> str:
    """Text of a header, with the headers of this folder that it includes in their places."""
    text = (HEADERS / name).read_text()
    for path in HEADERS.glob("*.h"):
        if (line := f'#include "{path.name}"\n') in text:
            text = text.replace(line, header(path.name))
    return text
