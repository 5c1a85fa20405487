"""Calls that are refused."""

from collections.abc import Callable
from typing import Any

import pytest


def refused(
    expected: type[BaseException] | tuple[type[BaseException], ...], words: tuple[str, ...], call: Callable[[], Any]
):
    """Assert that a call raises exactly this kind of exception, with all the words in its message."""
    with pytest.raises(expected) as caught:
        call()
    kinds = expected if isinstance(expected, tuple) else (expected,)
    assert type(caught.value) in kinds
    missing = [word for word in words if word not in str(caught.value)]
    assert not missing, f"{missing} not in {str(caught.value)!r}"
