"""What a part of the siege reports, and the page of all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field


@dataclass
class Siege:
    """Attacks on one promise: how many there were, of what, and what they found."""

    name: str
    unit: str  # what is counted, in the plural
    blind: str  # what it cannot see, a sentence
    count: int = 0
    found: list[str] = field(default_factory=list)  # one line each: what to do to see it again, and what happens


_HEAD = """# What was tried to break it

`make soak` attacks the promises that this documentation makes, anew, with any seed (`ARGS=--seed=1`). The last column
has what it found on the commit named below; whatever it finds is a defect.
"""


def markdown(parts: Sequence[tuple[Siege, float]], origin: str) -> str:
    """Page with a table of the parts of a siege and their time [s], what they found, and what they cannot see."""
    rows = [
        f"| {siege.name} | {siege.count:,} {siege.unit} | {took:.0f} s | {len(siege.found)} |" for siege, took in parts
    ]
    table = "\n".join(["| part | tried | took | broken promises |", "|---|---:|---:|---:|", *rows])
    found = [f"- {siege.name}: {line}" for siege, _ in parts for line in siege.found]
    blind = "\n".join(f"- {siege.name}: {siege.blind}." for siege, _ in parts)
    sections = [
        _HEAD,
        table,
        *(["## Found", "\n".join(found)] if found else []),
        "## What it cannot see",
        blind,
        origin,
    ]
    return "\n\n".join(section.strip() for section in sections) + "\n"
