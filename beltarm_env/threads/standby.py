"""Threads that stand by for a kernel, so that none need be woken while a batch is stepped again and again.

A kernel packs its arguments into memory and offers them. Threads that stand by are within a kernel of their own, and
hold no lock of Python's: after each offer that they take they look for the next one for a while, and only then sleep.
What no thread has taken once the work is done is withdrawn, so nobody waits for one that is late.
"""

from __future__ import annotations

import atexit
import os
import time
from collections.abc import Callable
from functools import cache
from queue import SimpleQueue
from threading import Thread
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils

from beltarm_env.jit import PLAIN, code_for, compiled
from beltarm_env.threads.blocks import MAX_THREADS
from beltarm_env.threads.calls import start
from beltarm_env.threads.words import WORD, Integers, address, exchange, look, operation, wait, write

# Words of the box of a thread, two cache lines of its own: processors fetch lines in pairs.
_OFFER, _CODE, _ENDED, _AWAKE, _DISMISSED = range(5)
_WORDS = 16
_NONE, _FILLED, _TAKEN = range(3)
"""Offers that are none to take; others are the address of packed arguments."""

_LONG, _SHORT = 20_000, 2_000
"""Looks for an offer if one is soon expected, for some 0.3 ms, and if not."""
SOON = 1e-3
"""Time within which a call must follow another for the next to be soon expected [s]."""
_EXIT = 1.0  # s

_RUNS = ir.FunctionType(ir.VoidType(), [WORD, WORD])
_NOBODY = np.empty((0, _WORDS), np.int64)


def standing_by(threads: int) -> Integers:
    """Return the boxes of so many threads, less the one that calls, and wake those that sleep.

    Of fewer, where the system allows no more threads.
    """
    if threads == 1 or PLAIN:
        return _NOBODY
    process = os.getpid()
    boxes = _boxes(process)[1:threads]
    for number, box in enumerate(boxes, 1):
        if box[_AWAKE] == 0:
            bell = _bell(process, number)
            if bell is None:
                return boxes[: number - 1]
            box[_AWAKE] = 1
            bell.put(None)
    return boxes


@cache
def _boxes(process: int) -> Integers:
    """Boxes of all threads of a process; one that was forked has none of the threads, and boxes of its own."""
    boxes = np.zeros((MAX_THREADS, _WORDS), np.int64)
    atexit.register(_dismiss, process, boxes)
    return boxes


@cache
def _bell(process: int, number: int) -> SimpleQueue[None] | None:
    """What wakes a thread, which begins with it; None if the system allows no new one."""
    bell: SimpleQueue[None] = SimpleQueue()
    box = _boxes(process)[number]
    # Not in that thread: a process that is forked while it compiles can compile nothing any more.
    serve = code_for(_serve, box, number, _LONG)
    name = f"beltarm-standby-{number}"
    started = start(Thread(target=_stand_by, args=(serve, box, number, bell), name=name, daemon=True))
    return bell if started else None


def _stand_by(serve: Callable[..., None], box: Integers, number: int, bell: SimpleQueue[None]) -> None:
    while not box[_DISMISSED]:
        asleep = time.perf_counter()
        bell.get()
        box[_AWAKE] = 1
        serve(box, number, _LONG if time.perf_counter() - asleep < SOON else _SHORT)


def _dismiss(process: int, boxes: Integers) -> None:
    """Have no thread within a kernel as Python ends, and takes the kernels' memory."""
    boxes[:, _DISMISSED] = 1
    until = time.monotonic() + _EXIT
    while os.getpid() == process and boxes[:, _AWAKE].any() and time.monotonic() < until:
        time.sleep(1e-4)


@compiled
def _serve(box: Integers, thread: int, patience: int) -> None:
    """Take offers, until there was none for so many looks."""
    looks = 0
    while looks < patience and look(box, _DISMISSED) == 0:
        offer = look(box, _OFFER)
        if offer > _TAKEN and exchange(box, _OFFER, offer, _TAKEN):
            ended = box[_ENDED]
            _call(box[_CODE], offer, thread)
            write(ended, 1)  # from here on the arguments may be gone
            write(address(box, _OFFER), _NONE)
            looks = 0
        else:
            looks = wait(looks)
    write(address(box, _AWAKE), 0)


def _share(work: Any, arguments: Any, flags: Integers, boxes: Integers) -> None:
    """Run a kernel in this thread and in those that stand by, until all that have begun are done.

    Args:
        work: Kernel that raises no errors, called with the index of a thread and the arguments.
        arguments: Tuple.
        flags: Its last entries are room for a flag of each thread that stands by.
        boxes: Of `standing_by`.
    """
    code, offer = _pack(work, arguments)
    first = len(flags) - len(boxes)
    for k in range(len(boxes)):
        flags[first + k] = 1
        if exchange(boxes[k], _OFFER, _NONE, _FILLED):  # it does not work for another caller
            flags[first + k] = 0
            boxes[k, _CODE] = code
            boxes[k, _ENDED] = address(flags, first + k)
            write(address(boxes[k], _OFFER), offer)
    _call(code, offer, 0)
    for k in range(len(boxes)):
        if not exchange(boxes[k], _OFFER, offer, _NONE):
            looks = 0
            while look(flags, first + k) == 0:
                looks = wait(looks)


def _share_alone(work: Any, arguments: Any, flags: Integers, boxes: Integers) -> None:
    work(0, *arguments)


share = _share_alone if PLAIN else compiled(_share)


@operation
def _pack(typing: Any, work: Any, arguments: Any) -> Any:
    """Pack arguments into memory of the caller: addresses of the code that runs a kernel with them, and of these."""
    called = work.get_call_type(typing, (types.int64, *arguments.types), {})

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        part = work.dispatcher.overloads[tuple(called.args)]
        context.active_code_library.add_linking_library(part.library)
        packed = cgutils.alloca_once_value(builder, values[1])
        runs = ir.Function(builder.module, _RUNS, builder.module.get_unique_name("beltarm_runs"))
        runs.linkage = "internal"
        runs.attributes.add("noinline")
        inside = ir.IRBuilder(runs.append_basic_block())
        given = cgutils.unpack_tuple(inside, inside.load(inside.inttoptr(runs.args[0], packed.type)))
        function = context.declare_function(builder.module, part.fndesc)
        passed = [runs.args[1], *given]
        context.call_conv.call_function(inside, function, called.return_type, called.args, passed, ("noinline",))
        inside.ret_void()
        addresses = [builder.ptrtoint(runs, WORD), builder.ptrtoint(packed, WORD)]
        return context.make_tuple(builder, signature.return_type, addresses)

    return types.UniTuple(types.int64, 2)(work, arguments), generate


@operation
def _call(_: Any, code: Any, packed: Any, thread: Any) -> Any:
    """Run a kernel with packed arguments."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        builder.call(builder.inttoptr(values[0], _RUNS.as_pointer()), values[1:])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64), generate
