"""Arithmetic of translated expressions: the type of each result, and the text of C.

Numbers of two types meet in the wider one; a whole number and a float32 in float64. Quotients of whole numbers are
float64, powers are products in one fixed order.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable
from typing import Any

import numpy as np

from beltarm_env.engine.translation.types import (
    BOOL,
    BYTE,
    INT,
    REAL,
    SINGLE,
    SMALL,
    UNSIGNED,
    Const,
    NotConstantError,
    Scalar,
    TranslationError,
    dtype_of,
    joined,
    shown,
)
from beltarm_env.engine.translation.whole import LEAST, WHOLE, arithmetic, fits, span, whole, whole_literal

PYTHON_OPERATORS: dict[type, Callable[..., Any]] = {
    **{ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv},
    **{ast.FloorDiv: operator.floordiv, ast.Mod: operator.mod, ast.Pow: operator.pow},
    **{ast.BitAnd: operator.and_, ast.BitOr: operator.or_, ast.BitXor: operator.xor},
    **{ast.Eq: operator.eq, ast.NotEq: operator.ne, ast.Lt: operator.lt, ast.LtE: operator.le},
    **{ast.Gt: operator.gt, ast.GtE: operator.ge},
    **{ast.USub: operator.neg, ast.UAdd: operator.pos, ast.Not: operator.not_},
    **{ast.LShift: operator.lshift, ast.RShift: operator.rshift},
}
C_OPERATORS: dict[type, str] = {
    **{ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"},
    **{ast.Eq: "==", ast.NotEq: "!=", ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">="},
}
UNSIGNED_OPERATORS: dict[type, str] = {
    **{kind: sign for kind, sign in C_OPERATORS.items() if kind is not ast.Div},
    **{ast.BitAnd: "&", ast.BitOr: "|", ast.BitXor: "^", ast.LShift: "<<", ast.RShift: ">>"},
}
COMPARISONS = (ast.Eq, ast.NotEq, ast.Lt, ast.LtE, ast.Gt, ast.GtE)
NUMBERS: Any = (int, float, bool, np.integer, np.floating, np.bool_)

IN_SINGLE: dict[float, float] = {}
"""Tolerances below the rounding of single precision, and what stands for them there: of a caller that writes such C."""
ROUNDER = 1.5 * 2.0**52
"""Adding it, and taking it off again, rounds a float64 to a whole number; exact for magnitudes below 2^51."""


def dtype_of_number(value: Any) -> str:
    """Find the type of a known number."""
    if isinstance(value, np.generic):
        dtype_of(value.dtype)
    if isinstance(value, bool | np.bool_):
        return BOOL
    if type(value) is np.uint64:
        return UNSIGNED
    if isinstance(value, int | np.integer):
        return SMALL if fits(int(value), int(value), SMALL) else INT
    return SINGLE if getattr(value, "dtype", None) == np.float32 else REAL


def literal(value: Any, dtype: str) -> str:
    """Write a known number as a literal of C."""
    if dtype == BOOL:
        return "true" if value else "false"
    if dtype == UNSIGNED:
        return f"UINT64_C({int(value)})"
    if dtype in (*WHOLE, BYTE):
        return whole_literal(int(value))
    number = float(value)
    if number == ROUNDER:
        return "ROUNDER"
    if abs(number) in IN_SINGLE and dtype == REAL:
        return f"PRECISE({number!r}, {math.copysign(IN_SINGLE[abs(number)], number)!r})"
    if math.isnan(number):
        return "NAN"
    if math.isinf(number):
        return "INFINITY" if number > 0 else "(-INFINITY)"
    text = f"R({number!r})" if dtype == REAL else f"(float){number!r}"
    return text if math.copysign(1.0, number) > 0 or dtype == REAL else f"({text})"


def scalar(value: Any) -> Scalar:
    """Turn a value into a number of the program.

    Raises:
        TranslationError: If it is none.
    """
    if isinstance(value, Scalar):
        return Scalar(SMALL, value.code, (-128, 127)) if value.dtype == BYTE else value
    if isinstance(value, Const) and isinstance(value.value, NUMBERS):
        dtype = dtype_of_number(value.value)
        known = (int(value.value), int(value.value)) if dtype in WHOLE else None
        return Scalar(dtype, literal(value.value, dtype), known)
    raise TranslationError(f"a number is expected, not {shown(value)}")


def cast(value: Any, dtype: str) -> Scalar:
    """Convert a number to a type."""
    if isinstance(value, Const) and isinstance(value.value, NUMBERS):
        return Scalar(dtype, literal(np.float32(value.value) if dtype == SINGLE else value.value, dtype))
    number = scalar(value)
    if number.dtype == dtype or (number.dtype, dtype) == (SMALL, INT):
        return number
    if dtype in (SMALL, INT) and number.dtype == UNSIGNED:
        return Scalar(INT, f"(int64_t){grouped(number.code)}")
    if dtype in (SMALL, INT) and number.dtype not in WHOLE:
        return Scalar(INT, f"int_of({bare(number.code)})")
    return Scalar(dtype, f"({dtype}){grouped(number.code)}", number.span if dtype in WHOLE and dtype != BOOL else None)


def grouped(code: str) -> str:
    """Put an expression in parentheses, unless it is one name, literal or call."""
    return code if bare(code) != code or code.replace("_", "").replace(".", "").isalnum() else f"({code})"


def bare(code: str) -> str:
    """Take off parentheses around a whole expression."""
    while code.startswith("(") and code.endswith(")"):
        depth = 0
        for k, character in enumerate(code):
            depth += (character == "(") - (character == ")")
            if depth == 0 and k < len(code) - 1:
                return code
        code = code[1:-1]
    return code


def constant(value: Any) -> Any:
    """Return the Python value of something known.

    Raises:
        NotConstantError: If it is not.
    """
    if isinstance(value, Const):
        return value.value
    raise NotConstantError(f"this has to be known when the program is written: {shown(value)}")


def binary(kind: type, left: Any, right: Any) -> Any:
    """Translate `left kind right` for numbers; both are converted to the type that they have in common.

    Raises:
        TranslationError: If there is no such operation.
    """
    if isinstance(left, Const) and isinstance(right, Const):
        values: list[Any] = [left.value, right.value]
        plain = all(isinstance(one, NUMBERS) and type(one) is not np.uint64 for one in values)
        if plain and joined(*map(dtype_of_number, values)) == REAL:
            values = [float(one) if dtype_of_number(one) == SINGLE else one for one in values]
        with np.errstate(all="ignore"):
            if kind is ast.Div and values[1] == 0:
                return Const(float(np.divide(*values)))
            return Const(PYTHON_OPERATORS[kind](*values))
    a, b = scalar(left), scalar(right)
    if kind is ast.Add and isinstance(right, Const) and right.value == ROUNDER and a.dtype == REAL:
        return Scalar(REAL, f"plus_rounder({bare(a.code)})")  # half of rounding, which no compiler takes away
    if kind is ast.Pow:
        return _power(a, right)
    if UNSIGNED in (a.dtype, b.dtype):
        return _unsigned(kind, left, right)
    common = joined(a.dtype, b.dtype)
    computes = kind not in COMPARISONS and kind not in (ast.BitAnd, ast.BitOr)
    if common == BOOL and computes:
        raise TranslationError(f"no {kind.__name__} of two bools, which NumPy keeps bools: write int(a)")
    if kind is ast.Div:
        common = REAL if common in WHOLE else common
    if common in WHOLE and kind not in COMPARISONS:
        if common == BOOL:
            return Scalar(BOOL, f"({a.code} {'&' if kind is ast.BitAnd else '|'} {b.code})")
        if kind is ast.Mult and "1" in (a.code, b.code):
            return cast(b if a.code == "1" else a, common)
        return arithmetic(kind, cast(a, SMALL) if a.dtype == BOOL else a, cast(b, SMALL) if b.dtype == BOOL else b)
    a, b = cast(left, common), cast(right, common)
    if kind in (ast.Mod, ast.FloorDiv) and common == REAL:
        name = "real_mod" if kind is ast.Mod else "real_floor_div"
        return Scalar(REAL, f"{name}({bare(a.code)}, {bare(b.code)})")
    if kind not in C_OPERATORS:
        raise TranslationError(f"no operation {kind.__name__} on {a.dtype} and {b.dtype}")
    return Scalar(BOOL if kind in COMPARISONS else common, f"({a.code} {C_OPERATORS[kind]} {b.code})")


def _unsigned(kind: type, left: Any, right: Any) -> Scalar:
    """Combine unsigned numbers, which wrap, with their like, or with known whole numbers."""
    for one in (left, right):
        known = isinstance(one, Const) and dtype_of_number(one.value) in (SMALL, INT) and one.value >= 0
        if not known and scalar(one).dtype != UNSIGNED:
            raise TranslationError(f"unsigned numbers meet their like alone: np.uint64({shown(one)})")
    if kind not in UNSIGNED_OPERATORS:
        raise TranslationError(f"no operation {kind.__name__} on {UNSIGNED}")
    a, b = cast(left, UNSIGNED), cast(right, UNSIGNED)
    if kind in (ast.LShift, ast.RShift) and not (isinstance(right, Const) and right.value < 64):
        return Scalar(UNSIGNED, f"shift_{'left' if kind is ast.LShift else 'right'}({bare(a.code)}, {bare(b.code)})")
    return Scalar(BOOL if kind in COMPARISONS else UNSIGNED, f"({a.code} {UNSIGNED_OPERATORS[kind]} {b.code})")


def _power(base: Scalar, exponent: Any) -> Scalar:
    """Square, cube or fourth power, in the order of multiplications of `arithmetic.h`."""
    power = constant(exponent)
    names = {2: "square", 3: "cube", 4: "fourth_power"}
    if base.dtype in WHOLE:
        raise TranslationError("powers of whole numbers are not translated")
    if power not in names or base.dtype != REAL:
        raise TranslationError(f"only the powers 2, 3 and 4 of float64 are translated, not {power} of {base.dtype}")
    return Scalar(REAL, f"{names[power]}({bare(base.code)})")


def unary(kind: type, operand: Any) -> Any:
    """Translate `kind operand` for a number."""
    if isinstance(operand, Const):
        return Const(PYTHON_OPERATORS[kind](operand.value))
    a = scalar(operand)
    if kind is ast.Not:
        return Scalar(BOOL, f"(!{grouped(a.code)})")
    if kind is ast.USub and a.dtype in (SMALL, INT):
        low, high = span(a)
        if low > (LEAST if a.dtype == INT else -(2**31)):
            return whole(f"(-{grouped(a.code)})", -high, -low)
        return arithmetic(ast.Sub, scalar(Const(0)), a)
    if kind is ast.USub and a.dtype != BOOL:
        return Scalar(a.dtype, f"(-{grouped(a.code)})")
    raise TranslationError(f"no operation {kind.__name__} on {a.dtype}")


def condition(value: Any) -> Any:
    """Turn a value into what an `if` asks: a known bool, or an expression."""
    if isinstance(value, Const):
        return Const(bool(value.value))
    number = scalar(value)
    return number if number.dtype == BOOL else Scalar(BOOL, f"({number.code} != 0)")
