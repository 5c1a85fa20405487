"""Arithmetic and memory that a step of an arm takes, counted by running its kernels.

With `NUMBA_DISABLE_JIT=1` kernels are plain Python, so they run on any kind of number. Here these are numbers that
remember which operation they came from. As a compiler does, an operation that was done before on the same numbers is
not counted again, and one whose result nobody stores or compares is not counted at all.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from beltarm_env import BeltArmVectorEnv
from beltarm_env.kernels import layout as at
from beltarm_env.kernels import tile
from beltarm_env.kernels.advance_driven import DRIVEN_WORK_ROWS, advance_driven_block
from beltarm_env.kernels.layout import LANES
from beltarm_env.kernels.observe import observe_block
from beltarm_env.kernels.sense import sense_block
from beltarm_env.kernels.step import ACTION, SCRATCH_ROWS, charge
from beltarm_env.observation import ENCODER, size
from beltarm_env.physics.models import LUMPED
from beltarm_env.task.ranges import Randomization
from beltarm_env.task.reference import TRAPEZOID
from eval.speed.timing import numbers

PARTS = ("motion", "sensing", "cost", "observation")
_ARMS, _STEPS = 50, 8
WARM_UP = 5
"""Steps that are not counted or timed, so that arms are in motion."""
_SLOW = ("division", "root")


class Effort(NamedTuple):
    """What a part of a step takes per arm, in the mean."""

    operations: float  # of float64: sums, products, quotients, roots and comparisons
    slow: float  # of them, quotients and roots
    read: float  # bytes of the arm
    written: float


class Traced(float):
    """Number that remembers the operation it came from, and on what."""

    operation: str | None = None
    operands: tuple[Any, ...] = ()


class Trace:
    """What has been computed, compared, read and stored since the last trace ended."""

    def __init__(self) -> None:
        self._begin()

    def _begin(self) -> None:
        self._done: dict[tuple[Any, ...], Any] = {}  # operands live as long, so that no two have the same id
        self._needed: list[Any] = []
        self.read: set[int] = set()
        self.written: set[int] = set()

    def apply(self, operation: str, function: Callable[..., Any], *operands: Any) -> Any:
        """Return the result of an operation, which is the same number again if it was done before."""
        key = operation, function, *(id(x) if isinstance(x, Traced) else x for x in operands)
        if key not in self._done:
            result = function(*operands)
            if result is NotImplemented:
                return result
            if isinstance(result, float):
                result = Traced(result)
                result.operation, result.operands = operation, operands
            else:
                self.need(*operands)
            self._done[key] = result
        return self._done[key]

    def need(self, *numbers: Any) -> None:
        """Note that these numbers are stored or compared."""
        self._needed.extend(numbers)

    def end(self) -> Effort:
        """Count what was needed; for the next trace, the results are numbers like others."""
        counts = Counter(key[0] for key, result in self._done.items() if not isinstance(result, float))
        while self._needed:
            number = self._needed.pop()
            if isinstance(number, Traced) and number.operation is not None:
                counts[number.operation] += 1
                self._needed.extend(number.operands)
                number.operation, number.operands = None, ()
        for number in self._done.values():
            if isinstance(number, Traced):
                number.operation, number.operands = None, ()
        slow = sum(counts[operation] for operation in _SLOW)
        found = Effort(counts.total() - counts["sign"], slow, 8.0 * len(self.read), 8.0 * len(self.written))
        self._begin()
        return found


_TRACE = Trace()


def _traced(name: str, operation: str) -> Callable[..., Any]:
    function = getattr(float, name)
    return lambda *operands: _TRACE.apply(operation, function, *operands)


def _product(one: Traced, other: float) -> Any:
    if not isinstance(other, Traced) and other == 1.0:
        return one  # which a compiler leaves out
    return _TRACE.apply("product", float.__mul__, one, other)


_OPERATIONS = {
    "sum": ("add", "radd", "sub", "rsub"),
    "division": ("truediv", "rtruediv"),
    "comparison": ("lt", "le", "gt", "ge", "eq", "ne"),
    "sign": ("neg", "abs"),
}
for _operation, _names in _OPERATIONS.items():
    for _name in _names:
        setattr(Traced, f"__{_name}__", _traced(f"__{_name}__", _operation))
for _name, _method in {"mul": _product, "rmul": _product, "hash": float.__hash__}.items():
    setattr(Traced, f"__{_name}__", _method)


class Memory:
    """Flat memory of a kernel, whose cells tell the trace what is stored; those of an arm also what is read."""

    def __init__(self, cells: list[Any], first: int = 0, of_arm: bool = False) -> None:
        self._cells, self._first, self._of_arm = cells, first, of_arm

    def __getitem__(self, place: Any) -> Any:
        """Return a cell, or all from one on."""
        if isinstance(place, slice):
            return Memory(self._cells, self._first + place.start)
        if self._of_arm:
            _TRACE.read.add(int(place))
        return self._cells[self._first + int(place)]

    def __setitem__(self, place: Any, value: Any) -> None:
        """Store a number."""
        if self._of_arm:
            _TRACE.written.add(int(place))
        _TRACE.need(value)
        self._cells[self._first + int(place)] = value


def efforts(randomization: Randomization) -> dict[str, Effort]:
    """Count what the parts of a step take under random torques; the kernels must be plain Python."""
    env = BeltArmVectorEnv(_ARMS, randomization=randomization)
    env.reset(seed=0)
    env.action_space.seed(0)
    torques = [env.action_space.sample()[:, 0] for _ in range(WARM_UP + _STEPS)]
    driven, rows = env._batch.driven, at.rows(env._batch.blocks, 0, at.ROWS, _ARMS)
    setattr(tile, "np", SimpleNamespace(float32=lambda number: number))  # noqa: B010 - NumPy's would not be traced
    setattr(math, "sqrt", partial(_TRACE.apply, "root", math.sqrt))  # noqa: B010
    totals = dict.fromkeys(PARTS, np.zeros(len(Effort._fields)))
    for arm in range(_ARMS):
        block: Any = Memory([Traced(rows[arm, k // LANES]) for k in range(at.ROWS * LANES)], of_arm=True)
        scratch, work, room = _room(SCRATCH_ROWS), _room(DRIVEN_WORK_ROWS), _room(tile.TILE_ROWS)
        held, observation = scratch[ACTION * LANES :], np.zeros((1, size()), np.float32)
        parts = (
            partial(advance_driven_block, block, work, held, 1, LUMPED),
            partial(sense_block, block, 1, ENCODER, driven),
            partial(charge, block, scratch, 1, TRAPEZOID, driven),
            partial(observe_block, block, room, observation, TRAPEZOID, ENCODER, driven),
        )
        for step, torque in enumerate(torques):
            held[0] = Traced(torque[arm])
            _TRACE.end()
            for name, part in zip(PARTS, parts, strict=True):
                part()
                effort = _TRACE.end()
                if step >= WARM_UP:
                    totals[name] = totals[name] + effort
    return {name: Effort(*total / (_ARMS * _STEPS)) for name, total in totals.items()}


def _room(rows: int) -> Any:
    return Memory([Traced(0.0)] * (rows * LANES))


def efforts_of_kernels(randomization: Randomization) -> dict[str, Effort]:
    """Count what the parts of a step take, in a process whose kernels are plain Python."""
    code = "import sys; from eval.speed.operations import print_efforts; print_efforts(sys.argv[1])"
    found = numbers(code, str(randomization), NUMBA_DISABLE_JIT="1")
    return {name: Effort(*effort) for name, effort in zip(PARTS, np.reshape(found, (len(PARTS), -1)), strict=True)}


def print_efforts(randomization: Randomization) -> None:
    """Print them, number by number."""
    for effort in efforts(randomization).values():
        print(*effort)
