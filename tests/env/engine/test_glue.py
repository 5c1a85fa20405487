"""The glue between Python and compiled kernels: what matches, and what comes back."""

import sys
from typing import Any, NamedTuple

import numpy as np
import pytest
from refusals import refused

from beltarm_env.engine import building

pytestmark = pytest.mark.skipif(building.compiler() is None, reason="there is no compiler of C")


class Point(NamedTuple):
    x: Any
    y: Any


class Other(Point):
    pass


class Subclass(np.ndarray):  # read by its buffer, and not as NumPy's own type
    pass


EACH_KIND = pytest.mark.parametrize("kind", [np.ndarray, Subclass])


def takes(kernel: Any, *arguments: Any) -> bool:
    """Whether a kernel that returns None takes arguments, and its variant says the same."""
    if kernel.call(*arguments) is None:
        assert kernel.bind(0, ())(*arguments) is None
        return True
    refused(TypeError, ("expected, not",), lambda arguments=arguments: kernel.bind(0, ())(*arguments))
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

    def test_constants_are_the_same_object_and_tuples_have_their_type_and_entries(self, kernel: Any):
        model = [1]
        made = kernel("nothing", "kk", (model, "full"))
        assert takes(made, model, "full") and not takes(made, [1], "full") and not takes(made, model, "lumped")
        made = kernel("nothing", "(d(dn))", (Point, tuple))
        unfit = (1.0, (2.0, 3)), Other(1.0, (2.0, 3)), Point(1.0, [2.0, 3]), Point(1.0, (2.0,)), Point(1.0, (2.0, 3, 4))
        assert takes(made, Point(1.0, (2.0, 3))) and not any(takes(made, value) for value in unfit)
        assert takes(kernel("nothing", "()", (tuple,)), ())

    @EACH_KIND
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
        assert code != "l" or takes(made, np.zeros(3, np.longlong).view(kind))

    @EACH_KIND
    def test_arrays_have_their_layout(self, kernel: Any, kind: type):
        whole = np.zeros((4, 6)).view(kind)
        fixed = np.broadcast_to(whole, (4, 6), subok=True)  # read-only
        arrays = {"c": whole, "C": fixed, "s": whole[:, ::2], "S": fixed.T}
        for layout in arrays:
            made = kernel("nothing", f"ad2{layout}")
            assert [name for name, array in arrays.items() if takes(made, array)] == [layout]
            assert not takes(made, whole[0]) and not takes(made, whole[None])
        made = kernel("nothing", "ad2c")
        assert takes(made, whole[:1, :]) and takes(made, whole[::4]) and takes(made, whole[:0, ::2])  # as NumPy says
        assert not takes(made, whole[:, :1]) and takes(kernel("nothing", "ad2s"), whole[::-1])
        assert takes(kernel("nothing", "ad0c"), np.zeros(())) and not takes(kernel("nothing", "ad0C"), np.float64(1))
        records, odd = np.zeros(4, [("a", "i1"), ("x", "f8")]), np.zeros(33, np.uint8)[1:].view(np.float64)
        assert not takes(kernel("nothing", "ad1s"), records["x"]) and not takes(kernel("nothing", "ad1c"), odd)
        assert takes(kernel("nothing", "ad1s"), np.zeros(4, [("a", "i8"), ("x", "f8")])["x"])

    def test_other_buffers_are_arrays_and_no_other_objects(self, kernel: Any):
        made, content = kernel("nothing", "aB1c"), bytearray(8)
        assert takes(made, content) and takes(made, memoryview(content))
        content.append(1)  # nobody holds its memory
        assert not any(takes(made, value) for value in (b"12", [1, 2], None, "12", memoryview(content).cast("b")))

    def test_the_variant_that_fits_is_called_and_the_others_leave_nothing(self, glue: Any, at: Any):
        made, content = glue.Kernel(lambda *arguments: "missing"), bytearray(8)
        for number, spec in enumerate(("aB1cd", "aB1cn", "aB1c0", "aB1cb")):
            made.add(at("nothing"), spec, (), "0", lambda _, number=number: number)
        for _ in range(2):
            for value, expected in ((1.0, 0), (True, 3), (None, 2), (1, 1), ("", "missing"), (2, 1)):
                assert made.call(content, value) == expected
        content.append(1)
        with pytest.raises(TypeError):
            made.bind(0, ())(content, 1)
        content.append(1)


class TestArguments:
    def test_numbers_come_in_order_through_tuples(self, kernel: Any):
        made = kernel("scalars", "(d(nb))", (Point, Point), "(d(n)0()bL)")
        assert made.call(Point(0.5, Point(-3, True))) == (0.5, (-3,), None, (), True, 2**64 - 1)
        assert made.bind(0, ())(Point(0.5, Point(2**62, False)))[1::3] == ((2**62,), False)

    @EACH_KIND
    def test_shapes_and_strides_are_counted_in_entries(self, kernel: Any, kind: type):
        array = np.zeros((6, 8), np.float32).view(kind)
        assert kernel("numbers", "af2snn", (), "(nnnn)").call(array[::2, ::-4], 1, 2) == (3, 2, 16, -4)
        assert kernel("numbers", "af2cnn", (), "(nnnn)").call(array, 1, 2) == (6, 8, 1, 2)

    def test_whole_numbers_beyond_64_bits(self, kernel: Any):
        made = kernel("nothing", "nd")
        for number in (2**63, -(2**63) - 1, 10**40):
            for call in (made.call, made.bind(0, ())):
                with pytest.raises(OverflowError):
                    call(number, 1.0)
            assert made.call(number, 1)[0] == "missing"

    def test_an_error_names_the_argument(self, kernel: Any):
        call = kernel("nothing", "d(n(ad2c))", (Point, tuple)).bind(0, ())
        for arguments, words in (
            ((1,), "2 arguments are expected, not 1"),
            ((1, 2), "argument 0: .*float.* not int"),
            ((1.0, (2, 3)), "argument 1: .*Point.* not tuple"),
            ((1.0, Point(2, ([],))), r"1\[1\]\[0\]: .*float64, axes 2, contiguous, writable.* not list"),
            ((1.0, Point(2, (np.zeros(4, "f4")[::2],))), "not ndarray .*float32, axes 1, not contiguous, writable"),
            ((1.0, Point(2, (np.zeros(4, "c8"),))), "not ndarray .*another type, axes 1"),
        ):
            with pytest.raises(TypeError, match=words):
                call(*arguments)


class TestResults:
    def test_finish_makes_the_result_and_what_an_entry_says_is_an_error(self, kernel: Any):
        assert kernel("scalars", "dnb", (), "(dn)", lambda result: Point(*result)).call(0.5, 2, True) == Point(0.5, 2)
        with pytest.raises(ZeroDivisionError):
            kernel("nothing", "", (), "0", lambda _: 1 / 0).call()
        content = bytearray(8)
        with pytest.raises(ValueError, match=r"^100% wrong$"):
            kernel("wrong", "aB1c").call(content)
        content.append(1)

    @EACH_KIND
    def test_the_last_argument_comes_back_and_may_be_made_anew(self, kernel: Any, kind: type):
        made, like = kernel("numbers", "nnnaf1c", (), "(o(nnn)n)"), np.ones(3, np.float32).view(kind)
        assert made.bind(0, (7, 8))(9, like) == made.bind(0, (7, 8, 9, like))() == (like, (7, 8, 9), 3)
        new = [made.bind(0, (), like)(7, 8, 9)[0] for _ in range(2)]
        assert len({id(one) for one in (like, *new)}) == 3 and all(type(one) is kind and one.size == 3 for one in new)
        assert sys.getrefcount(like) == 2 and [sys.getrefcount(one) for one in new] == [3, 3]

    def test_references_are_not_lost(self, kernel: Any):
        arrays, number, model = [np.zeros(3) for _ in range(4)], 12345.5, object()
        made = kernel("nothing", "ad1cad1c(ad1cd)k", (tuple, model))
        packed, content = (arrays[2], number), bytearray(8)
        objects = [*arrays, packed, model, number, content]
        before = [sys.getrefcount(value) for value in objects]
        for _ in range(100):
            assert made.call(arrays[0], arrays[1], packed, model) is None
            made.call(arrays[0], arrays[1], packed, None)
            assert made.bind(0, (arrays[0], arrays[1], packed))(model) is None
            refused(TypeError, ("argument 1",), lambda: made.bind(0, (arrays[0], packed)))
            held = kernel("numbers", "aB1cnnn", (), "{length,one,two,three:nnnn}").bind
            assert held(0, (content, 1))(2, 3) == {"length": 8, "one": 1, "two": 2, "three": 3}
        content.append(1)  # nobody holds its memory
        assert [sys.getrefcount(value) for value in objects] == before


def test_arrays_of_another_layout_are_not_known(glue: Any):
    assert not glue.know_arrays((bytearray(80),)) and not glue.know_arrays(())
    with pytest.raises(TypeError):
        glue.know_arrays((1,))
