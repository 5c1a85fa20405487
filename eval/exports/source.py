"""Sources of C for a controller: its kernels, translated, between a header and the four functions that one calls."""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_type_hints

import jinja2
import numpy as np

from baselines.models.friction import RESTING
from beltarm_env import CONTROL_PERIOD, ArmParams, __version__
from beltarm_env.engine.translation import header
from beltarm_env.engine.translation.arrays import contiguous
from beltarm_env.engine.translation.numbers import IN_SINGLE
from beltarm_env.engine.translation.program import Function, Program
from beltarm_env.engine.translation.scope import RESERVED
from beltarm_env.engine.translation.types import (
    BOOL,
    REAL,
    SMALL,
    Array,
    Const,
    Group,
    Scalar,
    TranslationError,
    Value,
    dtype_of,
)
from beltarm_env.kernels.layout import LANES, Rows
from beltarm_env.physics.events import CLOSE, NEGLIGIBLE
from beltarm_env.physics.step import ROUNDING
from beltarm_env.task.reference import MoveShape
from eval.exports.kernels import begin, empty_device, go_on

SINGLE_LANE = {"LANES": 1, "_VECTOR": 1}
"""Constants that differ from the kernels in Python, which work on many arms side by side."""
TEMPLATES = jinja2.Environment(
    loader=jinja2.FileSystemLoader(Path(__file__).parent / "templates"),
    keep_trailing_newline=True,
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
)
IN_SINGLE.update({CLOSE: 1e-6, NEGLIGIBLE: 1e-5, ROUNDING: 1e-5, RESTING: 5e-6})
MOST_COUNTS = 10_000_000
"""Most counts of an encoder per turn of the motor."""
FAULTS = {
    "counts": f"counts_per_turn must be a whole number from 1 to {MOST_COUNTS}",
    "sums": "sums are not rounded to nearest one by one: build without -fassociative-math, -funsafe-math-optimizations "
    "and x87 arithmetic, and leave the rounding mode as it is",
    "products": "products are fused with sums: build with -ffp-contract=off",
    "quotients": "quotients are products with reciprocals: build without -freciprocal-math",
    "root": "square roots are not rounded to nearest: build without -funsafe-math-optimizations",
    "constants": "constants are in single precision: build without -fsingle-precision-constant",
    "numbers": "what is no number or endless, or the sign of zero, is lost: build without -ffinite-math-only and "
    "-fno-signed-zeros",
    "tiny": "tiny numbers become zero: link without -ffast-math, and set no flush-to-zero mode",
}
"""Why a program gives no torque; its functions return the number of the fault, from 1."""
TEMPLATES.globals.update(
    arithmetic=header("arithmetic.h"),
    fault=lambda name: 1 + list(FAULTS).index(name),
    faults=list(FAULTS.values()),
    most_counts=MOST_COUNTS,
)
_CPP = (
    "alignas alignof and and_eq asm bitand bitor catch char8_t char16_t char32_t class co_await co_return "
    "co_yield compl concept const_cast consteval constexpr constinit decltype delete dynamic_cast explicit export "
    "friend mutable namespace new noexcept not not_eq nullptr operator or or_eq private protected public "
    "reinterpret_cast requires static_assert static_cast template this thread_local throw try typeid typename "
    "using virtual wchar_t xor xor_eq"
)
_TEMPLATES = "in_the_loop begin_move next_move sample arithmetic_fault plus_rounder REAL_EPSILON REAL_MIN"
TAKEN = {*_TEMPLATES.split(), *_CPP.split()}
"""Names that are taken in a program: those of the templates, and keywords of C++."""
_NAME = re.compile("[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*")


@dataclass(frozen=True)
class Loop:
    """A controller's loop, ready to be translated."""

    name: str  # of the C functions
    title: str
    params: ArmParams  # arm with the gear ratio and torque limit that it is made for
    step: Any  # function of design, limit, device, memory and count
    design: Any
    memory: Any  # array, or named tuple of arrays
    identifies: bool = False  # whether a filter identifies the arm, which takes double precision
    plans: bool = False  # whether plans are made anew while the arm moves

    def __post_init__(self) -> None:
        """Check the name; raises ValueError if it is none for functions of C and C++."""
        if not _NAME.fullmatch(self.name) or not (TAKEN | RESERVED).isdisjoint(self.public):
            raise ValueError(
                f"--name must be a name of C and C++, a letter and then letters and digits with single _ between them, "
                f"that means nothing else, such as my_arm; got {self.name!r}"
            )

    @property
    def public(self) -> set[str]:
        """Names that its header defines."""
        return {self.name, *(f"{self.name}_{part}" for part in ("real", "move", "init", "reset", "next", "step"))}


def for_one_lane(template: Any) -> Any:
    """Memory of a kernel without the lanes that one arm does not need: what is declared as `Rows` has one in each row.

    Raises:
        TranslationError: If an array is not as it is declared.
    """
    if template is None or isinstance(template, np.ndarray):
        return template
    declared, made = get_type_hints(type(template), include_extras=True), []
    for field, part in template._asdict().items():
        if not isinstance(part, np.ndarray):
            made.append(for_one_lane(part))
            continue
        name, rows = f"{type(template).__name__}.{field}", declared[field] == Rows
        shorter, rest = divmod(part.shape[-1], LANES)
        if rows and rest:
            raise TranslationError(f"{name} is declared as Rows of {LANES} lanes, and has {part.shape[-1]} numbers")
        if not rows and not rest and part.ndim == 1 and part.dtype == np.float64:
            raise TranslationError(
                f"{name} has {len(part)} numbers, as rows of {LANES} lanes have: declare it as Rows, or take one more"
            )
        made.append(np.zeros((*part.shape[:-1], shorter), part.dtype) if rows else part)
    return type(template)(*made)


def sources(loop: Loop) -> dict[str, str]:
    """Write the files of a loop, by name.

    Raises:
        TranslationError: If a kernel cannot be translated; names function, line and construct.
    """
    program = Program(SINGLE_LANE)
    program.taken |= TAKEN | loop.public
    device = empty_device(1)
    limit, memory = loop.params.torque_limit, for_one_lane(loop.memory)
    of_device, of_memory = members("device", device), members("memory", memory)
    move = Group(MoveShape, tuple((field, Scalar(REAL, f"move->{field}")) for field in MoveShape._fields))
    holds_part, count = Scalar(BOOL, "move->holds_part"), Scalar(SMALL, "count")
    resolution = Scalar(REAL, "self->resolution")
    began = body(program, begin, [of_device, Const(loop.params.plant()), resolution, move, holds_part, count])
    stepped = body(program, loop.step, [Const(loop.design), Const(limit), of_device, of_memory, count])
    given = {
        "name": loop.name,
        "title": loop.title,
        "version": __version__,
        "period_ms": f"{1000 * CONTROL_PERIOD:g}",
        "limit": f"{limit:g}",
        "identifies": loop.identifies,
        "fields": [*fields_of("device", device), *fields_of("memory", memory)],
        "turn": repr(2 * math.pi),
        "begin": began,
        "go_on": body(program, go_on, [of_device, move, holds_part]),
        "step": stepped,
        **parts_of(program),
    }
    files = {f"{loop.name}.h": "controller.h", f"{loop.name}.c": "controller.c", "in_the_loop.c": "in_the_loop.c"}
    return {file: TEMPLATES.get_template(f"{template}.j2").render(given) for file, template in files.items()}


def parts_of(program: Program) -> dict[str, str]:
    """Structs, tables and functions of a program, for a template."""
    parts = {"structs": program.struct_texts, "tables": program.used_tables(), "functions": program.texts}
    return {name: "\n\n".join(texts) for name, texts in parts.items()}


def body(program: Program, function: Any, values: list[Value], kind: str = REAL) -> str:
    """Lines of a public function that calls a translated one; `kind` is the type that it returns."""
    scope = Function(program)
    result: Any = program.call(scope, getattr(function, "py_func", function), values)
    lines = list(scope.lines)
    if not isinstance(result, Const):
        call = lines.pop().partition(" = ")[2]
        lines.append(f"return {call}" if result.dtype == kind else f"return ({kind}){call}")
    return "\n".join(f"    {line}" for line in lines)


def fields_of(name: str, template: Any) -> Iterator[tuple[str, str, int]]:
    """Type, name and length of the arrays of a template."""
    if isinstance(template, np.ndarray):
        yield dtype_of(template.dtype), name, max(template.size, 1)
    elif template is not None:
        for field, part in zip(template._fields, template, strict=True):
            yield from fields_of(f"{name}_{field}", part)


def members(name: str, template: Any) -> Value:
    """The arrays of a template as values of the translation."""
    if isinstance(template, np.ndarray):
        shape = tuple(map(int, template.shape))
        return Array(dtype_of(template.dtype), shape, contiguous(shape), f"self->{name}", memory=name)
    if template is None:
        return Const(None)
    parts = zip(template._fields, template, strict=True)
    return Group(type(template), tuple((field, members(f"{name}_{field}", part)) for field, part in parts))
