"""The measurement of speed: what it compares, and the page over the size of the batch."""

from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from eval.speed import peers, sizes
from eval.speed.operations import Memory, Trace, Traced, efforts_of_kernels
from eval.speed.timing import ratios, times_in_turns


def test_runs_take_turns_and_the_first_turn_does_not_count():
    turns: list[str] = []
    times = times_in_turns([lambda: turns.append("a"), lambda: turns.append("b")], 2)
    assert turns == ["a", "b"] * 3
    assert times.shape == (2, 2) and (times > 0).all()


def test_ratios_are_of_each_repetition():
    assert ratios(np.array([1.0, 2.0, 4.0]), np.array([2.0, 4.0, 8.0])) == ("2.00x", "2.00 to 2.00")
    assert ratios(np.array([2.0, 2.0, 2.0]), np.array([1.0, 2.0, 3.0])) == ("1.00x", "0.75 to 1.25")


def test_a_page_shows_every_peer_that_is_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sizes, "SIZES", (1, 20))
    monkeypatch.setattr(sizes, "_TIME", 0.001)
    monkeypatch.setitem(peers.STEPPERS, "CartPole-v1, EnvPool", ("no_such_package", peers.envpool_carts))
    monkeypatch.setitem(peers.STEPPERS, "CartPole-v1, gymnax", ("gymnasium", peers.gymnasium_carts))
    sizes.save_sizes(tmp_path, 2, Console(quiet=True))
    page = (tmp_path / "sizes.md").read_text(encoding="utf-8")
    (head,) = [line for line in page.splitlines() if line.startswith("| arms")]
    assert "BeltArm-v0, ideal drives | BeltArm-v0, all effects of the drive | CartPole-v1, Gymnasium" in head
    assert "CartPole-v1, gymnax" in head and "EnvPool" not in head
    assert "\n| 1 | " in page and "\n| 20 | " in page
    assert (tmp_path / "sizes.png").read_bytes().startswith(b"\x89PNG")


# Operations


@pytest.fixture
def trace(monkeypatch: pytest.MonkeyPatch) -> Trace:
    new = Trace()
    monkeypatch.setattr("eval.speed.operations._TRACE", new)
    return new


def counted(trace: Trace, *stored: float) -> tuple[float, float]:
    trace.need(*stored)
    return trace.end()[:2]


def test_operations_are_counted_once_and_only_if_their_result_is_needed(trace: Trace):
    x, y = Traced(3.0), Traced(0.5)
    assert counted(trace, x * y + x / y) == (3, 1)
    assert counted(trace, (x * y) * (x * y)) == (2, 0), "x * y is done once"
    assert x * y == 1.5 and counted(trace) == (2, 0), "a comparison is one, and needs what it compares"
    assert x - 1.0 and counted(trace) == (0, 0), "nobody stores it"
    assert counted(trace, 1.0 * x, -x, abs(x)) == (0, 0), "a compiler leaves these out, or a sign is all that changes"
    assert counted(trace, 2.0 - x, 2.0 / x, x - 2.0) == (3, 1)
    assert [2.0 - x, 2.0 / y, x - 2.0, 2 * x] == [-1.0, 4.0, 1.0, 6.0]


def test_what_was_computed_in_an_earlier_part_is_not_counted_again(trace: Trace):
    product = Traced(2.0) * Traced(3.0)
    assert counted(trace, product) == (1, 0)
    assert counted(trace, product + 1.0) == (1, 0)


def test_memory_of_an_arm_knows_what_is_read_and_written(trace: Trace):
    arm, other = Memory([1.0, 2.0, 3.0], of_arm=True), Memory([1.0, 2.0, 3.0])
    arm[0] = arm[1] + arm[1]
    other[1:][0] = Traced(2.0) * 2.0
    assert (float(arm[0]), float(other[1])) == (4.0, 4.0)
    assert trace.end() == (1, 0, 16.0, 8.0), "the product is stored, the sum of plain numbers is none of its own"


def test_parts_of_a_step_take_what_their_equations_say():
    """Quotients and roots by hand, others within what equations of their size can have."""
    efforts = efforts_of_kernels("ideal")
    assert efforts["sensing"].slow == 1, "angle / resolution"
    assert efforts["cost"].slow == 4, "of the reference its ramp and its cruising speed, and the length of two errors"
    assert efforts["observation"].slow == 2, "of seven references the same ramp and cruising speed"
    assert 4 <= efforts["motion"].slow < 12, "an inertia in each stage, more where a motor stops"
    assert 200 < efforts["motion"].operations < 1000 and efforts["motion"].written == 4 * 8
