"""Words of memory that several threads read and write; plain Python has one thread."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Integers = NDArray[np.int64]


def add(words: Integers, index: int, more: int) -> int:
    """Add to a word, and return what it was before; no other thread comes in between."""
    words[index] += more
    return int(words[index] - more)


def look(words: Integers, index: int) -> int:
    """Return a word that other threads write."""
    return int(words[index])
