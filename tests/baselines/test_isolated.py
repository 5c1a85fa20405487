"""Calls in a process of their own, whose end is a failure of the call, however it comes."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from functools import partial
from pathlib import Path

import pytest
from refusals import refused
from waiting import until

from baselines.engines.isolated import run_isolated
from baselines.engines.parallel import BrokenOff

ROOT = Path(__file__).resolve().parents[2]


def hang(file: Path) -> None:
    file.write_text(str(os.getpid()))
    time.sleep(600)


def fork_and_exit() -> None:
    """Leave a process behind that has inherited everything."""
    if os.fork():
        os._exit(0)
    time.sleep(600)


def count(numbers: list[int] = []) -> int:  # noqa: B006
    numbers.append(0)
    return len(numbers)


ENDS = {
    "exit status 0": partial(os._exit, 0),
    "signal 9": partial(signal.raise_signal, signal.SIGKILL),
    "ended with exit status 0": fork_and_exit,
}


@pytest.mark.parametrize("words", ENDS)
def test_every_end_has_its_cause(words: str):
    refused(BrokenOff, (words,), lambda: run_isolated(ENDS[words], "tests", 60))
    assert run_isolated(count, "tests", 60) == 1, "the next call has a process again"


def test_results_and_errors_come_back():
    assert run_isolated(partial(divmod, 7, 2), "tests", 60) == (3, 1)
    refused(ZeroDivisionError, ("by zero",), lambda: run_isolated(partial(divmod, 7, 0), "tests", 60))
    refused(RuntimeError, ("cannot pickle",), lambda: run_isolated(partial(open, os.devnull), "tests", 60))


def is_there(process: int) -> bool:
    with suppress(ProcessLookupError):
        os.kill(process, 0)
        return True
    return False


def test_what_hangs_is_ended(tmp_path: Path):
    refused(BrokenOff, ("longer than 0.5 s",), lambda: run_isolated(partial(hang, tmp_path / "pid"), "tests", 0.5))
    assert not is_there(int((tmp_path / "pid").read_text()))


@pytest.mark.skipif(sys.platform != "linux", reason="of Linux")
def test_who_takes_all_memory_is_ended_before_who_waits_for_it():
    score = Path("/proc/self/oom_score_adj")
    assert run_isolated(score.read_text, "tests", 60) == "1000\n"
    assert score.read_text() != "1000\n"


def test_a_process_is_kept_for_its_owner():
    run_isolated(os.getpid, "others", 60)
    actual = [run_isolated(count, owner, 60) for owner in ("tests", "tests", "others", "tests")]
    assert actual == [1, 2, 1, 1]
    assert run_isolated(os.getpid, "tests", 60) != os.getpid()


def test_it_does_not_outlive_who_waits_for_it(tmp_path: Path):
    path = [str(ROOT / folder) for folder in (".", "tests/helpers", "tests/baselines")]
    code = f"import sys; sys.path[:0] = {path!r}; from pathlib import Path; "
    code += "from functools import partial; from test_isolated import hang, run_isolated; "
    code += f"run_isolated(partial(hang, Path({str(tmp_path / 'pid')!r})), 'tests', 600)"
    waiting = subprocess.Popen([sys.executable, "-c", code])
    pid = tmp_path / "pid"
    until(lambda: pid.exists() and pid.read_text())
    waiting.kill()
    waiting.wait()
    until(lambda: not is_there(int(pid.read_text())))
