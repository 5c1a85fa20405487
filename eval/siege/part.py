"""What a part of the siege reports."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class Siege:
    """Attacks on one promise: how many there were, of what, and what they found."""

    name: str
    unit: str  # what is counted, in the plural
    blind: str  # what it cannot see, a sentence
    count: int = 0
    found: list[str] = field(default_factory=list)  # one line each: what to do to see it again, and what happens
