"""Progress on a terminal."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from baselines.tools.progress import progress_count, progress_over, progress_rows


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Console:
    monkeypatch.setenv("TERM", "xterm")
    return Console(file=io.StringIO(), force_terminal=True, width=80)


def written(console: Console) -> str:
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def test_a_refusal_comes_without_a_display(terminal: Console):
    with pytest.raises(ValueError, match="no"), progress_rows(["a"], 2, terminal), progress_count("pairs", terminal):
        raise ValueError("no")
    assert written(terminal) == ""


def test_displays_begin_with_the_first_news(terminal: Console):
    with progress_rows(["a", "b"], 2, terminal) as rows:
        rows.show("a", 1, "half")
        assert " 50 %" in written(terminal) and "half" in written(terminal)
    with progress_count("pairs", terminal) as show:
        assert "pairs" not in written(terminal)
        show(0, 3)
        assert "pairs" in written(terminal)
    assert written(terminal).endswith("\x1b[2K")  # it is taken away


def test_things_that_are_gone_through_are_counted(terminal: Console):
    for _ in progress_over("things", "abcd", terminal):
        assert "things" in written(terminal), "from the first one on"
    assert written(terminal).endswith("\x1b[2K")


@pytest.mark.parametrize("thing", ["", "a"])
def test_nothing_is_shown_where_there_is_no_terminal(thing: str):
    console = Console(file=io.StringIO())
    assert list(progress_over("things", thing, console)) == list(thing) and written(console) == ""
