"""Shares of work among the threads of the glue: each is done once, after a fork and at the end of Python, too."""

import os
import subprocess
import sys
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused
from waiting import until

from beltarm_env.engine import building

pytestmark = pytest.mark.skipif(building.compiler() is None, reason="there is no compiler of C")


@pytest.mark.parametrize("threads", [1, 2, 3, 4, 300])
def test_each_share_is_done_once(kernel: Any, threads: int):
    made, counts, places = kernel("mark", "nal1cal1c"), np.zeros(threads, np.int64), np.zeros(threads, np.int64)
    for _ in range(200 if threads < 10 else 3):
        before = counts.copy()
        assert made.share(threads, counts, places) is None
        assert (counts == before + 1).all() and places.all()


def test_helpers_work_at_the_same_time_and_are_awaited_by_their_caller_alone(kernel: Any):
    holds, begun, over = kernel("hold", "nal1cal1c"), np.zeros(2, np.int64), np.zeros(1, np.int64)
    marks, counts, places = kernel("mark", "nal1cal1c"), np.zeros(2, np.int64), np.zeros(2, np.int64)
    with ThreadPoolExecutor(1) as pool:
        held = pool.submit(holds.share, 2, begun, over)
        until(lambda: bool(begun.all()))
        marks.share(2, counts, places)
        assert counts.tolist() == [1, 1] and places[0] == places[1], "this thread has done both"
        assert not held.done()
        over[0] = 1
        assert held.result(60) is None


def test_errors_and_what_does_not_fit(kernel: Any):
    made = kernel("wrong_elsewhere", "n")
    assert made.share(2) is None
    for _ in range(50):
        refused(ValueError, ("wrong in the third",), lambda: made.share(4))
    assert made.share(2, 1.0) is kernel("nothing", "d").share(2) is False
    assert kernel("numbers", "nnnn", (), "n").share(2, 1, 1, 1) is False, "results of threads go nowhere"
    for threads in (0, -1, 5000):
        refused(ValueError, ("threads",), lambda threads=threads: made.share(threads))
    for arguments in ((), (1.0,), (True,), (None,)):
        refused(TypeError, ("number of threads",), lambda arguments=arguments: made.share(*arguments))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes cannot be forked")
def test_a_forked_process_has_helpers_of_its_own(kernel: Any):
    made, counts, places = kernel("mark", "nal1cal1c"), np.zeros(3, np.int64), np.zeros(3, np.int64)
    holds, begun, over = kernel("hold", "nal1cal1c"), np.zeros(3, np.int64), np.zeros(1, np.int64)

    def hold(meanwhile: Callable[[], Any]) -> None:
        begun[:] = over[0] = 0
        with ThreadPoolExecutor(1) as pool:
            held = pool.submit(holds.share, 3, begun, over)
            until(lambda: bool(begun.all()))
            meanwhile()
            over[0] = 1
            held.result(60)

    def fork() -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of Python 3.12, in processes with threads
            child = os.fork()
        if child:
            assert os.waitpid(child, 0)[1] == 0
            return
        try:
            made.share(3, counts, places)
            hold(lambda: None)
        finally:
            os._exit(0 if counts.tolist() == [2] * 3 and begun.all() else 1)

    made.share(3, counts, places)
    hold(fork)  # helpers that are busy are not so in the other process
    made.share(3, counts, places)
    assert counts.tolist() == [2] * 3


SCRIPT = """
import ctypes, sys
from pathlib import Path
from beltarm_env.engine import building
module, library = building.load_glue(), building.load(Path(sys.argv[1]))
kernel = module.Kernel(None)
kernel.add(ctypes.cast(library.mark, ctypes.c_void_p).value, "naB1caB1c", (), "0", None)
counts, places = bytearray(8 * 4), bytearray(8 * 4)
{before}
for _ in range(100):
    kernel.share(4, counts, places)
print(list(memoryview(counts).cast("q")), len(set(memoryview(places).cast("q"))))
"""
LIMITED = """
import resource
size = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (size + (4 << 20), -1))
"""


@pytest.mark.parametrize(
    ("before", "said"),
    [
        pytest.param("", "[100, 100, 100, 100] ", id="Python ends while helpers look for work"),
        pytest.param(LIMITED, "[100, 100, 100, 100] 1", id="no thread can be started, and the caller does all"),
    ],
)
def test_a_process_with_helpers(before: str, said: str, entries: Path):
    if before and sys.platform != "linux":
        pytest.skip("memory is limited in another way")
    command = [sys.executable, "-c", SCRIPT.format(before=before), str(entries)]
    environment = {**os.environ, "PYTHONPATH": str(Path(building.__file__).parents[2])}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=120, check=False)
    assert (done.returncode, done.stderr) == (0, "") and done.stdout.startswith(said)
