"""Source text of a kernel: its syntax tree, its variables, its place."""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import CodeType
from typing import Any

from beltarm_env.engine.translation.known import made_of
from beltarm_env.engine.translation.types import TranslationError


def tree_of(function: Callable[..., Any]) -> ast.FunctionDef:
    """Parse a kernel.

    Raises:
        TranslationError: If it has no source text, or one that was edited after it was loaded, or takes any number of
            arguments.
    """
    return _tree_of(function, function.__code__)


@cache  # a function that many call is translated many times
def _tree_of(function: Callable[..., Any], _: CodeType) -> ast.FunctionDef:
    if inspect.unwrap(function).__code__ is not function.__code__:
        raise TranslationError(f"{place(function)} is wrapped by a decorator, which would be left out")
    try:
        source, loaded = textwrap.dedent(inspect.getsource(function)), _is_loaded(function)
    except OSError:
        raise TranslationError(f"{function.__name__} has no source text that could be translated") from None
    if not loaded:
        raise TranslationError(f"{place(function)} was edited after it was loaded: start Python anew")
    tree = ast.parse(source).body[0]
    if not isinstance(tree, ast.FunctionDef) or tree.args.vararg or tree.args.kwarg:
        raise TranslationError(f"{place(function)} is not a plain function")
    tree.args.args = [*tree.args.posonlyargs, *tree.args.args, *tree.args.kwonlyargs]
    return tree


def _is_loaded(function: Callable[..., Any]) -> bool:
    """Tell whether a function's file says what its code does; where lines have moved, its text is another one's."""
    code, codes = function.__code__, _codes_of("".join(inspect.findsource(function)[0]))
    return any(made_of(one) == made_of(code) for one in codes.get((code.co_name, code.co_firstlineno), ()))


@cache
def _codes_of(text: str) -> dict[tuple[str, int], list[CodeType]]:
    """Compile a file; return the codes in it by name and line."""
    found: dict[tuple[str, int], list[CodeType]] = {}
    try:  # with `await` outside functions, as cells of a notebook may have it
        codes = [compile(text, "", "exec", ast.PyCF_ALLOW_TOP_LEVEL_AWAIT, dont_inherit=True)]
    except SyntaxError:  # somebody edits it
        return found
    for code in codes:
        inner = [one for one in code.co_consts if isinstance(one, CodeType)]
        codes += inner
        found.setdefault((code.co_name, code.co_firstlineno), []).append(code)
    return found


@cache
def assignments(tree: ast.FunctionDef) -> dict[str, int]:
    """How often each name is assigned in a function; not by loops that alone set it, for themselves alone."""
    found: dict[str, int] = {argument.arg: 0 for argument in tree.args.args}

    def note(target: ast.expr, times: int) -> None:
        for node in ast.walk(target):
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                found[node.id] = found.get(node.id, 0) + times

    parameters = set(found)
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign):
            for target in node.targets:
                note(target, 1)
        elif isinstance(node, ast.AugAssign | ast.AnnAssign):
            note(node.target, 2 if isinstance(node, ast.AugAssign) else 1)
        elif isinstance(node, ast.For) and not isinstance(node.iter, ast.Call):
            note(node.target, 2)
    for node in ast.walk(tree):  # a loop over a tuple, whose variables are known unless something else sets them
        if isinstance(node, ast.For) and isinstance(node.iter, ast.Call) and isinstance(node.target, ast.Tuple):
            for name in {part.id for part in ast.walk(node.target) if isinstance(part, ast.Name)} & {*found}:
                found[name] += 2
    loops: list[Any] = [n for n in ast.walk(tree) if isinstance(n, ast.For) and isinstance(n.target, ast.Name)]
    for loop in loops:
        name = loop.target.id
        found.setdefault(name, 0)
        if found[name] or (name != "_" and (_is_set_within(loop) or _is_read_beyond(tree, loops, name))):
            found[name] += 2
    return {name: count + (1 if name in parameters and count else 0) for name, count in found.items()}


def _is_set_within(loop: Any) -> bool:
    """Tell whether a loop within a loop has the same variable."""
    inner = [node for statement in loop.body for node in ast.walk(statement) if isinstance(node, ast.For)]
    return any(isinstance(node.target, ast.Name) and node.target.id == loop.target.id for node in inner)


def _is_read_beyond(tree: ast.FunctionDef, loops: list[Any], name: str) -> bool:
    """Tell whether a function reads a variable of its loops where none of them runs."""

    def reads(nodes: list[ast.stmt]) -> set[int]:
        names = [node for part in nodes for node in ast.walk(part) if isinstance(node, ast.Name)]
        return {id(node) for node in names if node.id == name and isinstance(node.ctx, ast.Load)}

    within = [reads(loop.body) for loop in loops if loop.target.id == name]
    return bool(reads(tree.body) - set().union(*within))


def _module_file(function: Callable[..., Any]) -> str:
    module = function.__module__ or "?"  # None: made by exec
    path = Path(inspect.getsourcefile(function) or "?")
    if path.suffix == ".py" and path.stem not in (module.rpartition(".")[2], "__init__"):
        return path.name  # a file that was loaded under another name
    return module.replace(".", "/") + ".py"


def place(function: Callable[..., Any]) -> str:
    """Name file, line and function."""
    path = Path(inspect.getsourcefile(function) or "?")
    module = _module_file(function)
    return f"{module if path.name != '<string>' else path.name}:{function.__code__.co_firstlineno} {function.__name__}"


def placed(error: TranslationError, function: Callable[..., Any], line: int) -> TranslationError:
    """Error with the function and line that it is about, once."""
    return error if " (in " in str(error) else type(error)(f"{error} (in {located(function, line)})")


def located(function: Callable[..., Any], line: int) -> str:
    """Name function, file and line, of which `line` counts from the function's first."""
    return f"{function.__name__}, {_module_file(function)}, line {function.__code__.co_firstlineno + line - 1}"
