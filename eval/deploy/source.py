"""Sources of C for a controller: its kernels, translated, between a header and the three functions that one calls."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from beltarm_env import CONTROL_PERIOD, ArmParams, __version__
from beltarm_env.kernels.layout import LANES
from beltarm_env.task.reference import MoveShape
from eval.deploy.loop import begin, empty_device
from eval.translation.arrays import contiguous
from eval.translation.program import Function, Program
from eval.translation.types import INT, REAL, Array, Const, Group, Scalar, Value, dtype_of

SINGLE_LANE = {"LANES": 1, "_VECTOR": 1}
"""What differs from the kernels in Python: they are compiled for many arms side by side."""
_ROWS_OF_LANES = (
    *("block", "blocks", "work", "actions", "velocities", "loaded", "z", "constants", "perturbed", "shapes"),
    *("other_shapes", "ripple", "other_ripple"),
)
TEMPLATES = jinja2.Environment(
    loader=jinja2.FileSystemLoader(Path(__file__).parent / "templates"),
    keep_trailing_newline=True,
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
)


@dataclass(frozen=True)
class Loop:
    """A controller's loop, ready to be translated."""

    name: str  # of the C functions
    title: str
    params: ArmParams  # whose gear ratio and torque limit it is made for
    step: Any  # function of design, limit, device, memory and count
    design: Any
    memory: Any  # array, or named tuple of arrays
    identifies: bool = False  # whether a filter identifies the arm, which takes double precision
    plans: bool = False  # whether plans are made anew while the arm moves


def for_one_lane(template: Any, name: str = "") -> Any:
    """Memory of a kernel without the lanes that one arm does not need: rows of a simulation have one each."""
    if template is None:
        return None
    if not isinstance(template, np.ndarray):
        names = zip(template._fields, template, strict=True)
        return type(template)(*(for_one_lane(part, field) for field, part in names))
    if name in _ROWS_OF_LANES and template.size % LANES == 0:
        return np.zeros(template.size // LANES)
    return template


def sources(loop: Loop) -> dict[str, str]:
    """Write the files of a loop, by name.

    Raises:
        TranslationError: If a kernel cannot be translated; names function, line and construct.
    """
    program = Program(SINGLE_LANE)
    device = empty_device(1)
    plant, limit = loop.params.plant(), loop.params.torque_limit
    memory = for_one_lane(loop.memory)
    fields = [*fields_of("device", device), *fields_of("memory", memory)]
    of_device, of_memory = members("device", device), members("memory", memory)
    move = Group(MoveShape, tuple((field, Scalar(REAL, f"move->{field}")) for field in MoveShape._fields))
    count = Scalar(INT, "count")
    resolution = Scalar(REAL, "self->resolution")
    began = body(program, begin, [of_device, Const(plant), resolution, move, count])
    stepped = body(program, loop.step, [Const(loop.design), Const(limit), of_device, of_memory, count])
    given = {
        "name": loop.name,
        "title": loop.title,
        "version": __version__,
        "period_ms": f"{1000 * CONTROL_PERIOD:g}",
        "limit": f"{limit:g}",
        "identifies": loop.identifies,
        "fields": fields,
        "turn": repr(2 * math.pi),
        "structs": "\n\n".join(program.struct_texts),
        "tables": "\n\n".join(program.used_tables()),
        "functions": "\n\n".join(program.texts),
        "begin": began,
        "step": stepped,
    }
    return {
        "real.h": TEMPLATES.get_template("real.h.j2").render(),
        "arithmetic.h": TEMPLATES.get_template("arithmetic.h.j2").render(),
        f"{loop.name}.h": TEMPLATES.get_template("controller.h.j2").render(given),
        f"{loop.name}.c": TEMPLATES.get_template("controller.c.j2").render(given),
        "in_the_loop.c": TEMPLATES.get_template("in_the_loop.c.j2").render(given),
    }


def body(program: Program, function: Any, values: list[Value], kind: str = REAL) -> str:
    """Lines of a public function that calls a translated one; `kind` is the type that it returns."""
    scope = Function(program, {}, {})
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
        return Array(dtype_of(template.dtype), shape, contiguous(shape), f"self->{name}")
    if template is None:
        return Const(None)
    parts = zip(template._fields, template, strict=True)
    return Group(type(template), tuple((field, members(f"{name}_{field}", part)) for field, part in parts))
