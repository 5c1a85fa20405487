"""Mutants of a module: its source with one small fault, made by the operators of Cosmic Ray.

Of each kind of change there is one that means something: a sum for a difference, a number one larger or smaller, a
bound that is in instead of out. What is not behaviour is left alone: annotations, decorators, and what an error says.
"""

from __future__ import annotations

import ast
import hashlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

from gymnasium.error import DependencyNotInstalled

_REPLACED = {
    "BinaryOperator": ("Add_Sub", "Sub_Add", "Mul_Div", "Div_Mul", "FloorDiv_Mul", "Mod_Mul", "Pow_Mul"),
    "ComparisonOperator": (
        *("Lt_LtE", "Lt_GtE", "LtE_Lt", "LtE_Gt", "Gt_GtE", "Gt_LtE", "GtE_Gt", "GtE_Lt"),
        *("Eq_NotEq", "NotEq_Eq", "Is_IsNot", "IsNot_Is"),
    ),
    "UnaryOperator": ("Delete_USub", "Delete_Invert", "Delete_Not"),
}
OPERATORS = (
    *(f"Replace{kind}_{change}" for kind, changes in _REPLACED.items() for change in changes),
    *("ReplaceBinaryOperator_BitAnd_BitOr", "ReplaceBinaryOperator_BitOr_BitAnd"),
    *("AddNot", "ReplaceTrueWithFalse", "ReplaceFalseWithTrue", "ReplaceAndWithOr", "ReplaceOrWithAnd"),
    *("ReplaceBreakWithContinue", "ReplaceContinueWithBreak", "ZeroIterationForLoop"),
    *("NumberReplacer", "ExceptionReplacer"),
)
"""Of Cosmic Ray: those that change what a line does, and not just whether it runs at all."""
Place = tuple[int, int]  # line from 1, column from 0


@dataclass(frozen=True, slots=True)
class Mutant:
    """A fault in a module."""

    function: str  # in which it is, with its class; empty outside of functions
    before: str  # the line
    after: str
    source: str  # of the whole module

    @property
    def name(self) -> str:
        """What it is known by: it stays the same where other lines change."""
        return f"{self.function or 'module'}: {self.before} -> {self.after}"


def drawn(source: str, count: int) -> list[Mutant]:
    """Draw mutants of a source by the hashes of their names, so that they stay the same where other lines change."""
    mutants = sorted(mutants_of(source), key=lambda mutant: hashlib.sha256(mutant.name.encode()).digest())
    return mutants[:count]


def mutants_of(source: str) -> Iterator[Mutant]:
    """Make all mutants of a source; of those that look the same, later ones are numbered.

    Raises:
        DependencyNotInstalled: If the package cosmic-ray is not installed.
    """
    try:
        from cosmic_ray.ast import ast_nodes, get_ast  # pyright: ignore[reportMissingImports]
        from cosmic_ray.mutating import mutate_code  # pyright: ignore[reportMissingImports]
        from cosmic_ray.plugins import get_operator  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise DependencyNotInstalled("mutants need the package cosmic-ray: pip install -e '.[mutation]'") from None

    tree, nodes, seen = ast.parse(source), list(ast_nodes(get_ast(source))), Counter[str]()
    silent = list(_silent(tree))
    for name in OPERATORS:
        operator = get_operator(f"core/{name}")()
        places = [start for node in nodes for start, _ in operator.mutation_positions(node)]
        for occurrence, place in enumerate(places):
            if any(begin <= place < end for begin, end in silent):
                continue
            mutated = mutate_code(source, operator, occurrence)
            if mutated is None or not _compiles(mutated):
                continue
            before, after = _changed(source, mutated)
            mutant = Mutant(_function_at(tree, place[0]), before, after, mutated)
            seen[mutant.name] += 1
            again = f" ({seen[mutant.name]})" if seen[mutant.name] > 1 else ""
            yield Mutant(mutant.function, before, after + again, mutated)


def _silent(tree: ast.Module) -> Iterator[tuple[Place, Place]]:
    """Where a fault would change nothing that a test should look at."""
    for node in ast.walk(tree):
        parts: list[ast.AST | None] = []
        if isinstance(node, ast.FunctionDef):
            parts = [node.returns, *node.decorator_list]
        elif isinstance(node, ast.ClassDef):
            parts = [*node.decorator_list]
        elif isinstance(node, ast.arg | ast.AnnAssign):
            parts = [node.annotation]
        elif isinstance(node, ast.Raise):
            parts = [node.exc]
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "in_a_line":
            parts = [node]
        elif isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            parts = [node]
        for part in parts:
            if isinstance(part, ast.expr | ast.stmt):
                assert part.end_lineno is not None and part.end_col_offset is not None
                yield (part.lineno, part.col_offset), (part.end_lineno, part.end_col_offset)


def _compiles(source: str) -> bool:
    try:
        compile(source, "mutant", "exec")
    except SyntaxError:
        return False
    return True


def _changed(source: str, mutated: str) -> tuple[str, str]:
    """The line that differs, before and after; of several the first."""
    pairs = zip(source.splitlines(), mutated.splitlines(), strict=False)
    before, after = next(pair for pair in pairs if pair[0] != pair[1])
    return " ".join(before.split()), " ".join(after.split())


def _function_at(tree: ast.Module, line: int) -> str:
    """Innermost function around a line, with its class."""
    around = [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.lineno <= line <= (node.end_lineno or 0)
    ]
    return ".".join(node.name for node in sorted(around, key=lambda node: node.lineno))
