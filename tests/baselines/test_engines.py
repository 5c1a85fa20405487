"""Tasks side by side on this machine, and calls in a process of their own; tasks on Ray are in `tests/stress`."""

import os
import signal
import socket
import subprocess
import sys
import time
import zipfile
from contextlib import suppress
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import pytest
from commands import ROOT, started
from gymnasium.error import DependencyNotInstalled
from refusals import refused
from side_by_side import Anywhere, InWorkers, Place, go_on, square, where_it_works
from waiting import until

from baselines.engines import workplace
from baselines.engines.isolated import run_isolated
from baselines.engines.parallel import BrokenOff, Channel, StopRequest, stop_on_signals
from baselines.engines.workplace import WithStorage, Workplace


class TestInThisProcess(Anywhere):
    @pytest.fixture
    def place(self) -> Place:
        return Place(jobs=1)


class TestInProcesses(InWorkers):
    @pytest.fixture
    def place(self) -> Place:
        return Place(jobs=2)


SCRIPT = f"""
import sys
sys.path[:0] = {[str(ROOT), str(ROOT / "tests" / "helpers")]}
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from baselines.engines.parallel import SideBySide, StopRequest, run_side_by_side, stop_on_signals
from side_by_side import last
stop = StopRequest()
with stop_on_signals(stop, lambda: print("asked", flush=True)):
    tasks = {{name: partial(last, Path(name)) for name in "ab"}}
    for name, outcome in run_side_by_side(tasks, SideBySide(jobs=2), stop=stop):
        print(name, outcome.message, flush=True)
"""


@pytest.mark.parametrize("killed", [False, True])
def test_a_signal_to_the_whole_group_asks_to_stop_as_the_death_of_who_waits_does(killed: bool, tmp_path: Path):
    """As Ctrl-C in a terminal is: the workers get it, too, and leave it to the one that began them."""
    process = started("-c", SCRIPT, cwd=tmp_path, start_new_session=True)
    for name in "ab":
        until((tmp_path / name / "began").exists)
    if killed:
        process.kill()
    else:
        os.killpg(process.pid, signal.SIGINT)
    output, errors = process.communicate(timeout=60)
    for name in "ab":
        until((tmp_path / name / "ended").exists)
    if not killed:
        assert errors == "" and process.returncode == 0
        assert sorted(output.splitlines()) == ["a saved", "asked", "b saved"]


def test_a_second_signal_ends_at_once():
    stop = StopRequest()
    with stop_on_signals(stop):
        signal.raise_signal(signal.SIGTERM)
        assert stop.made
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def test_what_cannot_be_used_is_refused(monkeypatch: pytest.MonkeyPatch):
    tasks = {"a": partial(square, 2)}
    for name, value in {"address": "auto", "storage": "s3://bucket", "jobs": 0}.items():
        refused(ValueError, (f"--{name}",), WithStorage(**{name: value}).check_engine)
    for address in ("127.0.0.1:1", "nonsense", "ray://127.0.0.1:10001") if find_spec("ray") else ():
        place = Place(engine="ray", address=address, jobs=2)
        refused(OSError, (f"--address {address} ",), partial(place.outcomes, tasks))
    monkeypatch.setitem(sys.modules, "ray", None)
    refused(DependencyNotInstalled, ("[ray]",), lambda: Place(engine="ray", jobs=2).outcomes(tasks))


class TestFolders:
    def test_a_folder_that_a_machine_does_not_see_needs_a_storage(self, tmp_path: Path):
        with Workplace(WithStorage(engine="ray"), tmp_path / "out") as place:
            task = place.task("a", tmp_path / "out", where_it_works, Path("checkpoint"))
            assert task(Channel()) == str(tmp_path / "out")
        assert list((tmp_path / "out").iterdir()) == []
        words = (socket.gethostname(), str(tmp_path / "out"), "--storage")
        refused(ValueError, words, partial(task, Channel()))  # without the file that proves it

    def test_a_task_goes_on_from_what_a_storage_keeps(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setattr(workplace, "_WORK_PER_COPY", 0)
        url, own, kept = tmp_path / "store", tmp_path / "own", list[str]()

        def report(step: int) -> None:
            with zipfile.ZipFile(url / "a.zip") as archive:
                kept.append(archive.read("checkpoint").decode())
            if step == 2:
                raise ValueError("no further")

        with Workplace(WithStorage(engine="ray", storage=str(url)), own) as place:
            task = place.task("a", own, go_on, Path("checkpoint"))
            refused(ValueError, ("no further",), partial(task, Channel(report)))
            assert kept == ["1", "2", "3"], "on the way, too"
            assert task(Channel()) == [3]
            place.collect("a", own)
            assert (own / "checkpoint").read_text() == "4"
            refused(ValueError, ("already holds a", "--resume"), partial(place.prepare, "a", own, resume=False))
            place.prepare("a", tmp_path / "another", resume=True)
            assert (tmp_path / "another/checkpoint").exists()
            assert [path.name for path in url.iterdir()] == ["a.zip"], "nothing half-written"
            (url / "a.zip").write_bytes(b"damaged")
            refused(ValueError, ("a.zip", "damaged"), partial(place.prepare, "a", own, resume=True))
            place.prepare("a", own, resume=False, overwrite=True)
            assert not list(url.iterdir())

    def test_a_storage_that_cannot_be_used_is_named(self, tmp_path: Path):
        (tmp_path / "file").write_text("")
        wrong = {f"{tmp_path}/file/store": (OSError, socket.gethostname()), "nowhere://bucket": (ValueError, "nowhere")}
        for url, (kind, word) in wrong.items():
            refused(kind, (f"--storage {url}", word), Workplace(WithStorage(storage=url), tmp_path).__enter__)


def hang(file: Path) -> str:
    """Code that leaves its process's number in a file, and takes its time."""
    return f"import os, time; open({str(file)!r}, 'w').write(str(os.getpid())); time.sleep(600)"


def fork_and_exit() -> None:
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
    refused(BrokenOff, ("than 0.5 s",), lambda: run_isolated(partial(exec, hang(tmp_path / "pid")), "tests", 0.5))
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


def test_it_does_not_outlive_who_waits_for_it(tmp_path: Path):
    pid = tmp_path / "pid"
    call = f"run_isolated(partial(exec, {hang(pid)!r}), 'tests', 600)"
    code = f"from functools import partial; from baselines.engines.isolated import run_isolated; {call}"
    waiting = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT)
    until(lambda: pid.exists() and pid.read_text())
    waiting.kill()
    waiting.wait()
    until(lambda: not is_there(int(pid.read_text())))
