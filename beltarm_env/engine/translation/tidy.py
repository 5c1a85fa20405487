"""Text of a translated function: variables where they are first assigned, none that nobody reads."""

from __future__ import annotations

import inspect
import re
import textwrap
from collections.abc import Callable
from functools import lru_cache
from typing import Any

from beltarm_env.engine.translation.reading import place
from beltarm_env.engine.translation.scope import PREFIX, Scope
from beltarm_env.engine.translation.types import ConstType, RecordType


def without_unused(body: Scope) -> list[str]:
    """Declarations and lines, without variables that are never read, or that only pass a value on."""
    lines = list(body.lines)
    for name in body.locals:
        if re.match(r"t_\d", name):
            lines = _passed_on(lines, name)
    while True:
        text = "\n".join(lines)
        read = {*re.findall(r"(?<![.>])\b\w+\b(?! = )", text), *_variables("\n".join(re.findall("= (.*)", text)))}
        unread = {name for name, local in body.locals.items() if local.kind is not None and name not in read}
        kept = []
        for line in lines:
            target, _, source = line.strip().partition(" = ")
            if target in unread and source:
                if re.match(rf"({PREFIX}\w+|__atomic_fetch_add)\(", source):
                    kept.append(line.replace(f"{target} = ", "(void)", 1))
                continue
            kept.append(line)
        if kept == lines:
            break
        lines = kept
    declared = []
    for name, local in body.locals.items():
        uses = [k for k, line in enumerate(lines) if name in _words(line)]
        if not uses:
            continue
        first = lines[uses[0]]
        target, _, source = first.partition(" = ")
        if local.kind is not None and target == name and name not in _words(source):  # where it is assigned first
            lines[uses[0]] = f"{local.text.partition(' = ')[0].removesuffix(name)}{first}"
        else:
            declared.append(local.text)
    return [*declared, *lines]


@lru_cache(10_000)
def _words(line: str) -> frozenset[str]:
    """Names, numbers and keywords of a line: to look for a name there takes longer with a pattern of its own."""
    return frozenset(re.findall(r"\w+", line))


def _variables(text: str) -> set[str]:
    """Words of a text that name no field."""
    return set(re.findall(r"(?<![.>])\b\w+", text))


def _passed_on(lines: list[str], name: str) -> list[str]:
    """Join `t = f(); x = t;` to `x = f();` where t is read nowhere else."""
    uses = [k for k, line in enumerate(lines) if name in _words(line)]
    if len(uses) != 2 or uses[1] != uses[0] + 1:
        return lines
    indent, assigns, source = lines[uses[0]].partition(f"{name} = ")
    used = lines[uses[1]].strip()
    if not assigns or indent.strip() or not (used == f"return {name};" or used.endswith(f" = {name};")):
        return lines
    joined = f"{indent}{used.removesuffix(f'{name};')}{source}"
    return [*lines[: uses[0]], joined, *lines[uses[1] + 1 :]]


def text_of(function: Callable[..., Any], name: str, body: Any, parameters: list[str]) -> str:
    """Write a function: a comment, its head, and its lines."""
    kind = body.returned
    returns = "void" if kind is None or isinstance(kind, ConstType) else kind
    returns = body.program.struct(returns) if isinstance(returns, RecordType) else returns
    lines = without_unused(body)
    if body.uses_heap:
        lines = releasing(lines, returns)
    read = _variables("\n".join(lines))
    names = [p.split()[-1].lstrip("*") for p in parameters]
    unused = [f"    (void){name};" for name in names if name not in read]
    first = (inspect.getdoc(function) or "").partition("\n")[0].replace("*/", "* /").replace("/*", "/ *")
    source = place(function)
    static = "INLINED" if body.program.runs_here and getattr(function, "inlined", False) else "static"
    head = f"{static} {returns} {name}({', '.join(parameters) or 'void'})"
    if len(head) > 118:
        head = f"{static} {returns} {name}(\n    " + ",\n    ".join(parameters) + ")"
    comment = textwrap.fill(f"{source}: {first}".rstrip(": "), 112, subsequent_indent="   ")
    return "\n".join([f"/* {comment} */", head, "{", *unused, *(f"    {line}" for line in lines), "}"])


def releasing(lines: list[str], returns: str) -> list[str]:
    """Release what a function allocates on the heap wherever it returns."""
    found = ["void *const heap = heap_mark();"]
    for line in lines:
        indent, (word, _, value) = line[: len(line) - len(line.lstrip())], line.strip().partition(" ")
        if word == "return" and value:
            found += [
                f"{indent}{returns} result_ = {value}",
                f"{indent}heap_release(heap);",
                f"{indent}return result_;",
            ]
        else:
            found += [f"{indent}heap_release(heap);", line] if line.strip() == "return;" else [line]
    if not lines[-1].strip().startswith("return"):
        found.append("heap_release(heap);")
    return found
