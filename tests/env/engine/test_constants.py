"""Kernels with other constants: the same equations for blocks of another size."""

import sys
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from beltarm_env.engine import PLAIN, compiled, inlined, library, with_constants
from beltarm_env.engine.entries import types_of
from beltarm_env.kernels.episodes import tip_errors
from beltarm_env.kernels.layout import empty_blocks, for_lanes

WIDTH = 3


@inlined
def _place(row: int) -> int:
    return row * WIDTH


@compiled
def _double(x: float) -> float:
    return 2 * x


@compiled
def _mark(values: Any) -> int:
    values[_place(1)] = _double(WIDTH)
    return WIDTH


def test_a_constant_is_another_in_all_that_a_kernel_calls_and_the_kernel_stays_as_it_is():
    expected = {3: [0, 0, 0, 6, 0, 0], 1: [0, 2, 0, 0, 0, 0], 5: [0, 0, 0, 0, 0, 10]}
    for width in (3, 1, 5, 3, 1):
        kernel: Any = _mark if width == WIDTH else with_constants(cast("Any", _mark), WIDTH=width)
        values = np.zeros(6)
        assert kernel(values) == width and values.tolist() == expected[width]
    assert with_constants(_mark, WIDTH=2) is with_constants(_mark, WIDTH=2)
    assert with_constants(_mark, WIDTH=2) is not with_constants(_mark, WIDTH=4)
    assert with_constants(_double, WIDTH=2) is _double


@pytest.mark.skipif(PLAIN, reason="kernels run in plain Python")
def test_a_note_is_found_again_unless_a_value_that_the_kernel_was_made_with_is_another(monkeypatch: pytest.MonkeyPatch):
    kernel: Any = for_lanes(cast("Any", tip_errors), 1)
    given = empty_blocks(1, 1), np.zeros((1, 4)), 0, None
    kernel(*given)
    words = library.words_of(kernel.py_func, types_of(given), False)
    found = library._read(library._note_of(words))
    assert found is not None
    assert {"tip_errors", "tip_motion", "CONTROL_PERIOD"} <= {name for _, name, _ in found["read"]}
    for module, name in {(module, name) for module, name, _ in found["read"] if name in dir(sys.modules[module])}:
        with monkeypatch.context() as patch:
            patch.setattr(f"{module}.{name}", 12345)
            assert library._read(library._note_of(words)) is None
    assert library._read(library._note_of(words)) == found


@pytest.mark.skipif(PLAIN, reason="kernels run in plain Python")
@pytest.mark.parametrize(
    "damage",
    [
        lambda note: note[: len(note) // 2],
        lambda _: "",
        lambda _: "[]",
        lambda note: note.replace('"read"', '"red"'),
        lambda note: note.replace('"object": "', '"object": 1, "is": "'),
        lambda note: note.replace("tuple", "triple").replace("array", "arrow"),
    ],
)
def test_a_damaged_note_is_as_good_as_none(damage: Any, tmp_path: Path):
    kernel: Any = for_lanes(cast("Any", tip_errors), 1)
    given = empty_blocks(1, 1), np.zeros((1, 4)), 0, None
    kernel(*given)
    whole, copy = library._note_of(library.words_of(kernel.py_func, types_of(given), False)), tmp_path / "note.json"
    assert whole is not None
    copy.write_text(damage(whole.read_text()))
    assert library._read(copy) is None and library._read(whole) is not None
