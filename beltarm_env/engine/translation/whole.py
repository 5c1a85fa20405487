"""Whole numbers of the translation: where each one lies, and arithmetic that no C compiler may take for undefined.

A kernel's whole numbers have 64 bits, and wrap. One that is known to fit 32 bits is an
`int32_t`, which small processors are faster with; what could leave 64 bits is computed by functions of `arithmetic.h`.
"""

from __future__ import annotations

import ast

from beltarm_env.engine.translation.types import BOOL, INT, SMALL, Scalar, TranslationError

LEAST, MOST = -(2**63), 2**63 - 1
_SPANS = {BOOL: (0, 1), SMALL: (-(2**31), 2**31 - 1), INT: (LEAST, MOST)}
_SIGNS = {
    **{ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.FloorDiv: "/", ast.Mod: "%"},
    **{ast.BitAnd: "&", ast.BitOr: "|", ast.BitXor: "^", ast.RShift: ">>"},
}
_WRAPPING = {ast.Add: "int_add", ast.Sub: "int_sub", ast.Mult: "int_mul"}
WHOLE = (BOOL, SMALL, INT)


def span(number: Scalar) -> tuple[int, int]:
    """Least and largest value that a whole number can have, were there numbers of any size."""
    return number.span or _SPANS[number.dtype]


def either(a: Scalar, b: Scalar) -> tuple[int, int] | None:
    """Span of two numbers together; None unless both are whole."""
    if a.dtype not in (SMALL, INT) or b.dtype not in (SMALL, INT):
        return None
    return min(span(a)[0], span(b)[0]), max(span(a)[1], span(b)[1])


def natural(number: Scalar) -> bool:
    """Tell whether a whole number is known not to be negative."""
    return span(number)[0] >= 0


def may_wrap(number: Scalar) -> bool:
    """Tell whether a whole number is a product that may have wrapped; sums count as those that have not."""
    low, high = span(number)
    return low < 2 * LEAST or high > 2 * MOST + 1


def fits(low: int, high: int, dtype: str) -> bool:
    """Tell whether numbers of a span are numbers of a type."""
    least, most = _SPANS[dtype]
    return least <= low and high <= most


def whole(code: str, low: int, high: int) -> Scalar:
    """Make a whole number of the smallest type that holds its span."""
    return Scalar(SMALL if fits(low, high, SMALL) else INT, code, (low, high))


def whole_literal(value: int) -> str:
    """Write a known whole number.

    Raises:
        TranslationError: If it has more than 64 bits.
    """
    if abs(value) < 2**31:
        return str(value)
    if not LEAST < value <= MOST:
        raise TranslationError(f"{value} is beyond the whole numbers of 64 bits")
    return f"INT64_C({value})" if value > 0 else f"(-INT64_C({-value}))"


def arithmetic(kind: type, a: Scalar, b: Scalar) -> Scalar:
    """Combine two whole numbers, of which one at least is no bool.

    Raises:
        TranslationError: If there is no such operation.
    """
    low, high = _span_of(kind, span(a), span(b))
    if kind in (ast.FloorDiv, ast.Mod) and (not natural(a) or may_wrap(a) or span(b)[0] <= 0):
        name = "floor_div" if kind is ast.FloorDiv else "floor_mod"
        return whole(f"{name}({a.code}, {b.code})", max(low, LEAST), min(high, MOST))
    if not fits(low, high, INT):
        return Scalar(INT, f"{_WRAPPING[kind]}({a.code}, {b.code})", (low, high))
    wide = not fits(low, high, SMALL) and INT not in (a.dtype, b.dtype)
    return whole(f"({'(int64_t)' if wide else ''}{a.code} {_SIGNS[kind]} {b.code})", low, high)


def _span_of(kind: type, a: tuple[int, int], b: tuple[int, int]) -> tuple[int, int]:
    """Span of what an operation gives, were there numbers of any size."""
    (al, ah), (bl, bh) = a, b
    if kind is ast.Add:
        return al + bl, ah + bh
    if kind is ast.Sub:
        return al - bh, ah - bl
    if kind in (ast.Mult, ast.FloorDiv):
        if kind is ast.FloorDiv and bl <= 0:
            return min(al, -ah) - 1, max(ah, -al)
        corners = [x * y if kind is ast.Mult else x // y for x in a for y in b]
        return min(corners), max(corners)
    if kind is ast.Mod:
        return (0 if bl > 0 else min(bl + 1, 0)), (0 if bh < 0 else max(bh - 1, 0))
    if kind is ast.BitAnd:
        return (0, min(ah if al >= 0 else bh, bh if bl >= 0 else ah)) if al >= 0 or bl >= 0 else (LEAST, MOST)
    if kind is ast.RShift and bl >= 0 and bh < 64:
        return min(al >> bl, al >> bh), max(ah >> bl, ah >> bh)
    if kind in (ast.BitOr, ast.BitXor):
        return (0, 2 ** max(ah, bh).bit_length() - 1) if al >= 0 and bl >= 0 else (LEAST, MOST)
    raise TranslationError(f"no operation {kind.__name__} on whole numbers")
