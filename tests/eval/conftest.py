"""What all tests of the comparison share."""

from collections.abc import Iterator
from functools import cache

import pytest

from eval.comparison import sets


@pytest.fixture(scope="session", autouse=True)
def read_once() -> Iterator[None]:
    """Read each file of scenarios once: to read one and check its hashes takes longer than a command's mistake."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sets, "load", cache(sets.load))
        yield
