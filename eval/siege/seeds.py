"""Plugin for pytest that runs property tests under many seeds: `pytest -p eval.siege.seeds --seeds 3,14`."""

from __future__ import annotations

import hypothesis
import pytest

TELL = "with the seed "


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option with the seeds."""
    parser.addoption("--seeds", default="", help="seeds of the property tests, with commas between")


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Call a property test under each seed; the error of one that fails says which."""
    seeds = [int(word) for word in str(pyfuncitem.config.getoption("--seeds")).split(",") if word]
    if not seeds or not getattr(pyfuncitem.obj, "is_hypothesis_test", False):
        return None
    arguments = {name: pyfuncitem.funcargs[name] for name in pyfuncitem._fixtureinfo.argnames}
    for given in seeds:
        hypothesis.seed(given)(pyfuncitem.function)
        try:
            pyfuncitem.obj(**arguments)
        except BaseException as error:
            error.add_note(f"{TELL}{given}")
            raise
    return True
