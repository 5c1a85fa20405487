"""The glue between Python and compiled kernels: what matches, what comes back, and the threads that share work."""

import ctypes
import gc
import os
import subprocess
import sys
import time
import warnings
import weakref
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from beltarm_env.engine import building

pytestmark = pytest.mark.skipif(building.compiler() is None, reason="there is no compiler of C")

ENTRIES = r"""
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#if defined(_WIN32)
#define ENTRY __declspec(dllexport) const char *
#else
#define ENTRY __attribute__((visibility("default"))) const char *
#endif
typedef union { double d; int64_t n; void *p; } Slot;
#define GIVEN void *const *p, const double *r, const int64_t *n, Slot *out

ENTRY nothing(GIVEN) { (void)p, (void)r, (void)n, (void)out; return NULL; }
ENTRY scalars(GIVEN) { (void)p; out[0].d = r[0]; out[1].n = n[0]; out[2].n = n[1]; out[3].n = -1; return NULL; }
ENTRY numbers(GIVEN) { (void)p, (void)r; for (int k = 0; k < 4; ++k) out[k].n = n[k]; return NULL; }
ENTRY wrong(GIVEN) { (void)p, (void)r, (void)n, (void)out; return "100% wrong"; }
ENTRY wrong_elsewhere(GIVEN) { (void)p, (void)r, (void)out; return n[0] == 2 ? "wrong in the third" : NULL; }

static _Thread_local int own;
ENTRY mark(GIVEN) /* how often each share was done, and by which thread */
{
    (void)r, (void)out;
    __atomic_fetch_add((int64_t *)p[0] + n[0], 1, __ATOMIC_SEQ_CST);
    ((int64_t *)p[1])[n[0]] = (int64_t)(intptr_t)&own;
    return NULL;
}
ENTRY hold(GIVEN) /* begun, until it is let go */
{
    (void)r, (void)out;
    __atomic_store_n((int64_t *)p[0] + n[0], 1, __ATOMIC_SEQ_CST);
    while (__atomic_load_n((int64_t *)p[1], __ATOMIC_SEQ_CST) == 0) { }
    return NULL;
}
"""


class Point(NamedTuple):
    x: Any
    y: Any


class Other(NamedTuple):
    x: Any
    y: Any


class Subclass(np.ndarray):
    """Read by its buffer, and not as NumPy's own type."""


@pytest.fixture(scope="module")
def glue() -> Any:
    module = building.load_glue()
    samples = np.zeros(3), np.zeros((2, 6), np.int64)[:, ::2], np.zeros(2, bool), np.zeros((0, 4), np.float32)
    assert module.know_arrays(samples)
    return module


@pytest.fixture(scope="module")
def at() -> Callable[[str], int]:
    library = building.load(building.build(ENTRIES, "test_glue"))

    def address(name: str) -> int:
        found = ctypes.cast(getattr(library, name), ctypes.c_void_p).value
        assert found is not None
        return found

    return address


@pytest.fixture
def kernel(glue: Any, at: Callable[[str], int]) -> Callable[..., Any]:
    """Make a kernel with one variant, that tells by a tuple which arguments it does not take."""

    def new(entry: str, spec: str, constants: tuple[Any, ...] = (), returns: str = "0", finish: Any = None) -> Any:
        made = glue.Kernel(lambda *arguments: ("missing", arguments))
        made.add(at(entry), spec, constants, returns, finish)
        return made

    return new


def takes(kernel: Any, *arguments: Any) -> bool:
    """Whether a kernel that returns None takes arguments, and its variant says the same."""
    if kernel.call(*arguments) is None:
        assert kernel.variant(0)(*arguments) is None
        return True
    with pytest.raises(TypeError, match="expected, not"):
        kernel.variant(0)(*arguments)
    return False


class TestMatching:
    @pytest.mark.parametrize(
        ("spec", "fitting", "others"),
        [
            ("d", (1.5, np.float64(1.5), float("nan")), (1, True, None, np.float32(1), np.int64(1), "1", [1.0])),
            ("n", (1, -(2**63), 2**63 - 1), (1.0, True, np.int64(1), None, np.uint64(1), "1")),
            ("b", (True, False), (1, 0, np.True_, None, 1.0)),
            ("0", (None,), (0, False, (), 0.0)),
        ],
    )
    def test_scalars(self, kernel: Any, spec: str, fitting: tuple[Any, ...], others: tuple[Any, ...]):
        made = kernel("nothing", spec)
        assert all(takes(made, value) for value in fitting)
        assert not any(takes(made, value) for value in others)
        assert not takes(made) and not takes(made, fitting[0], fitting[0])

    def test_constants_are_the_same_object(self, kernel: Any):
        model, other = [1], [1]
        made = kernel("nothing", "kk", (model, "full"))
        assert takes(made, model, "full")
        assert not takes(made, other, "full") and not takes(made, model, "lumped")

    def test_tuples_have_their_type_and_entries(self, kernel: Any):
        made = kernel("nothing", "(d(dn))", (Point, tuple))
        assert takes(made, Point(1.0, (2.0, 3)))
        unfit = (1.0, (2.0, 3)), Other(1.0, (2.0, 3)), Point(1.0, [2.0, 3]), Point(1.0, (2.0,)), Point(1.0, (2.0, 3, 4))
        assert not any(takes(made, value) for value in unfit)
        assert takes(kernel("nothing", "()", (tuple,)), ())

    @pytest.mark.parametrize("kind", [np.ndarray, Subclass])
    @pytest.mark.parametrize("code", "d f l ? b L B".split())
    def test_arrays_have_their_type(self, kernel: Any, code: str, kind: type):
        names = "float64 float32 int64 bool int8 uint64 uint8"
        types = dict(zip("dfl?bLB", map(np.dtype, names.split()), strict=True))
        made = kernel("nothing", f"a{code}1c")
        for other in types:
            assert takes(made, np.zeros(3, types[other]).view(kind)) == (other == code)
        for name in (">f8", ">i8", "i4", "u4", "f2", "c16", "M8[s]", "S8", "O", [("x", "f8")]):
            assert not takes(made, np.zeros(3, name).view(kind))
        assert takes(made, np.zeros(3, types[code].newbyteorder("=")).view(kind))
        if code == "l":
            assert takes(made, np.zeros(3, np.longlong).view(kind))

    @pytest.mark.parametrize("kind", [np.ndarray, Subclass])
    def test_arrays_have_their_layout(self, kernel: Any, kind: type):
        def readonly(array: np.ndarray) -> np.ndarray:
            array = array[...]
            array.flags.writeable = False
            return array

        whole = np.zeros((4, 6)).view(kind)
        arrays = {"c": whole, "C": readonly(whole), "s": whole[:, ::2], "S": readonly(whole.T)}
        for layout in arrays:
            made = kernel("nothing", f"ad2{layout}")
            assert [name for name, array in arrays.items() if takes(made, array)] == [layout]
            assert not takes(made, whole[0]) and not takes(made, whole[None])
        made = kernel("nothing", "ad2c")
        assert takes(made, whole[:1, :]) and takes(made, whole[::4]) and takes(made, whole[:0, ::2])  # as NumPy says
        assert not takes(made, whole[:, :1])
        assert takes(kernel("nothing", "ad2s"), whole[::-1])
        assert takes(kernel("nothing", "ad0c"), np.zeros(())) and not takes(kernel("nothing", "ad0C"), np.float64(1))

    def test_entries_that_lie_between_others_do_not_match(self, kernel: Any):
        records = np.zeros(4, [("a", "i1"), ("x", "f8")])
        odd = np.zeros(33, np.uint8)[1:].view(np.float64)
        assert not takes(kernel("nothing", "ad1s"), records["x"])
        assert not takes(kernel("nothing", "ad1c"), odd)
        assert takes(kernel("nothing", "ad1s"), np.zeros(4, [("a", "i8"), ("x", "f8")])["x"])

    def test_other_buffers_are_arrays_and_no_other_objects(self, kernel: Any):
        made = kernel("nothing", "aB1c")
        content = bytearray(8)
        assert takes(made, content) and takes(made, memoryview(content))
        content.append(1)  # nobody holds its memory
        assert not any(takes(made, value) for value in (b"12", [1, 2], None, "12", memoryview(content).cast("b")))

    def test_the_variant_that_fits_is_called_and_the_others_leave_nothing(self, glue: Any, at: Any):
        made = glue.Kernel(lambda *arguments: "missing")
        for number, spec in enumerate(("aB1cd", "aB1cn", "aB1c0", "aB1cb")):
            made.add(at("nothing"), spec, (), "0", lambda _, number=number: number)
        content = bytearray(8)
        for _ in range(2):
            for value, expected in ((1.0, 0), (True, 3), (None, 2), (1, 1), ("", "missing"), (2, 1)):
                assert made.call(content, value) == expected
        content.append(1)
        with pytest.raises(TypeError):
            made.variant(0)(content, 1)
        content.append(1)


class TestArguments:
    def test_numbers_come_in_order_through_tuples(self, kernel: Any):
        made = kernel("scalars", "(d(nb))", (Point, Point), "(d(n)0()bL)")
        assert made.call(Point(0.5, Point(-3, True))) == (0.5, (-3,), None, (), True, 2**64 - 1)
        assert made.variant(0)(Point(0.5, Point(2**62, False)))[1::3] == ((2**62,), False)

    @pytest.mark.parametrize("kind", [np.ndarray, Subclass])
    def test_shapes_and_strides_are_counted_in_entries(self, kernel: Any, kind: type):
        array = np.zeros((6, 8), np.float32).view(kind)
        assert kernel("numbers", "af2snn", (), "(nnnn)").call(array[::2, ::-4], 1, 2) == (3, 2, 16, -4)
        assert kernel("numbers", "af2cnn", (), "(nnnn)").call(array, 1, 2) == (6, 8, 1, 2)

    def test_whole_numbers_beyond_64_bits(self, kernel: Any):
        made = kernel("nothing", "nd")
        for number in (2**63, -(2**63) - 1, 10**40):
            for call in (made.call, made.variant(0)):
                with pytest.raises(OverflowError):
                    call(number, 1.0)
            assert made.call(number, 1)[0] == "missing"

    def test_an_error_names_the_argument(self, kernel: Any):
        call = kernel("nothing", "d(n(ad2c))", (Point, tuple)).variant(0)
        for arguments, words in (
            ((1,), "2 arguments are expected, not 1"),
            ((1, 2), "argument 0: a float is expected, not int"),
            ((1.0, (2, 3)), "argument 1: <class '.*Point'> with 2 entries is expected, not tuple"),
            ((1.0, Point(2, ([],))), r"1\[1\]\[0\]: an array \(float64, axes 2, contiguous, writable\) .* not list"),
            ((1.0, Point(2, (np.zeros(4, "f4")[::2],))), r"not ndarray \(float32, axes 1, not contiguous, writable\)"),
            ((1.0, Point(2, (np.zeros(4, "c8"),))), r"not ndarray \(of another type, axes 1, "),
        ):
            with pytest.raises(TypeError, match=words):
                call(*arguments)


class TestResults:
    def test_finish_makes_the_result(self, kernel: Any):
        assert kernel("scalars", "dnb", (), "(dn)", lambda result: Point(*result)).call(0.5, 2, True) == Point(0.5, 2)
        with pytest.raises(ZeroDivisionError):
            kernel("nothing", "", (), "0", lambda _: 1 / 0).call()

    def test_what_an_entry_says_is_an_error(self, kernel: Any):
        content = bytearray(8)
        with pytest.raises(ValueError, match=r"^100% wrong$"):
            kernel("wrong", "aB1c").call(content)
        content.append(1)

    def test_references_are_not_lost(self, kernel: Any):
        arrays, number, model = [np.zeros(3) for _ in range(4)], 12345.5, object()
        made = kernel("nothing", "ad1cad1c(ad1cd)k", (tuple, model))
        packed = (arrays[2], number)
        objects = [*arrays, packed, model, number]
        before = [sys.getrefcount(value) for value in objects]
        for _ in range(100):
            assert made.call(arrays[0], arrays[1], packed, model) is None
            made.call(arrays[0], arrays[1], packed, None)
        assert [sys.getrefcount(value) for value in objects] == before

    def test_kernels_are_collected(self, glue: Any, at: Any):
        class Function:
            kernel: Any = None

            def __call__(self, *_: Any) -> None:
                raise AssertionError

        missing, finish = Function(), Function()
        missing.kernel = finish.kernel = made = glue.Kernel(missing)
        made.add(at("nothing"), "k", (finish,), "0", finish)
        finish.call = made.variant(0)  # pyright: ignore[reportAttributeAccessIssue]
        references = weakref.ref(missing), weakref.ref(finish)
        del missing, finish, made
        gc.collect()
        assert [reference() for reference in references] == [None, None]


def test_arrays_of_another_layout_are_not_known(glue: Any):
    assert not glue.know_arrays((bytearray(80),)) and not glue.know_arrays(())
    with pytest.raises(TypeError):
        glue.know_arrays((1,))


class TestThreads:
    @pytest.mark.parametrize("threads", [1, 2, 3, 4, 300])
    def test_each_share_is_done_once(self, kernel: Any, threads: int):
        made, counts, places = kernel("mark", "nal1cal1c"), np.zeros(threads, np.int64), np.zeros(threads, np.int64)
        for _ in range(200 if threads < 10 else 3):
            before = counts.copy()
            assert made.share(threads, counts, places) is None
            assert (counts == before + 1).all() and places.all()

    def test_helpers_work_at_the_same_time_and_are_awaited_by_their_caller_alone(self, kernel: Any):
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

    def test_many_callers(self, kernel: Any):
        made = kernel("mark", "nal1cal1c")

        def work(threads: int) -> bool:
            counts, places = np.zeros(threads, np.int64), np.zeros(threads, np.int64)
            for _ in range(500):
                made.share(threads, counts, places)
            return counts.tolist() == [500] * threads

        with ThreadPoolExecutor(4) as pool:
            assert all(pool.map(work, [2, 3, 4, 2, 3, 4]))

    def test_errors_and_what_does_not_fit(self, kernel: Any):
        made = kernel("wrong_elsewhere", "n")
        assert made.share(2) is None
        for _ in range(50):
            with pytest.raises(ValueError, match="wrong in the third"):
                made.share(4)
        assert made.share(2, 1.0) == ("missing", (2, 1.0))
        assert kernel("nothing", "d").share(2) == ("missing", (2,))
        assert kernel("numbers", "nnnn", (), "n").share(2, 1, 1, 1)[0] == "missing", "results of threads go nowhere"
        for threads in (0, -1, 5000):
            with pytest.raises(ValueError, match="threads"):
                made.share(threads)
        for arguments in ((), (1.0,), (True,), (None,)):
            with pytest.raises(TypeError, match="number of threads"):
                made.share(*arguments)

    @pytest.mark.skipif(not hasattr(os, "fork"), reason="processes cannot be forked")
    def test_a_forked_process_has_helpers_of_its_own(self, kernel: Any):
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


def until(true: Callable[[], bool]) -> None:
    """Wait for something that comes soon."""
    deadline = time.monotonic() + 60
    while not true():
        assert time.monotonic() < deadline
        time.sleep(1e-4)


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
def test_a_process_with_helpers(before: str, said: str):
    if before and sys.platform != "linux":
        pytest.skip("memory is limited in another way")
    path = building.build(ENTRIES, "test_glue")
    command = [sys.executable, "-c", SCRIPT.format(before=before), str(path)]
    environment = {**os.environ, "PYTHONPATH": str(Path(building.__file__).parents[2])}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=120, check=False)
    assert (done.returncode, done.stderr) == (0, "") and done.stdout.startswith(said)
