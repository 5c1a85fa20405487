"""Memory of exported kernels has one lane where it is declared to have rows of lanes, under whatever name."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest
from refusals import refused

from beltarm_env.arrays import Floats, Singles
from beltarm_env.kernels.layout import LANES, Rows
from eval.exports.source import for_one_lane
from eval.translation.types import TranslationError


class Room(NamedTuple):
    """Rows of lanes under names that nothing else has, and what is none."""

    anything: Rows
    block: Floats
    layers: Singles
    nothing: Any = None


class Memory(NamedTuple):
    """A room in a tuple."""

    room: Room


def test_rows_are_declared_not_named() -> None:
    block = np.ones(7)
    found = for_one_lane(Memory(Room(np.ones((2, 3 * LANES)), block, np.ones((2, LANES), np.float32)))).room
    assert found.anything.shape == (2, 3)
    assert found.block is block and found.layers.shape == (2, LANES) and found.nothing is None


@pytest.mark.parametrize(
    ("room", "words"),
    [
        (Room(np.ones(LANES + 1), np.ones(7), np.ones(1, np.float32)), ("Room.anything", f"{LANES + 1} numbers")),
        (Room(np.ones(LANES), np.ones(2 * LANES), np.ones(1, np.float32)), ("Room.block", "declare it as Rows")),
    ],
    ids=["declared", "not declared"],
)
def test_memory_that_is_not_as_declared(room: Room, words: tuple[str, ...]) -> None:
    refused(TranslationError, words, lambda: for_one_lane(Memory(room)))
