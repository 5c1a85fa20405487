"""Mutants of what matters most, tried by the tests that are to find them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from baselines.tools.files import write_text
from eval.mutation.mutants import Mutant, drawn
from eval.mutation.trial import trials

_ROOT = Path(__file__).resolve().parents[2]
_FIRST = 600.0  # CPU time that the tests may take without a fault [s]
_MORE, _AT_LEAST = 3.0, 5.0  # times as long with one, and [s]


@dataclass(frozen=True, slots=True)
class Tried:
    """Mutants of a module, and which of them no test finds."""

    module: str
    mutants: list[Mutant]
    survivors: list[Mutant]


def tried(module: str, tests: Sequence[str], count: int, kept: Path) -> Tried:
    """Draw mutants of a module and try them.

    Killed ones are kept in a file, so that an interrupted run goes on; what survived is tried again, for tests grow.

    Args:
        module: Path from the root of the checkout.
        tests: What pytest is told to run.
        count: Most mutants.
        kept: File of outcomes.

    Raises:
        ValueError: If the tests fail without a fault.
    """
    source = (_ROOT / module).read_text(encoding="utf-8")
    digest = hashlib.sha256(source.encode()).hexdigest()
    killed = _killed(kept, digest)
    mutants, survivors = drawn(source, count), []
    with trials(module, tests) as seconds:
        limit = 0.0
        for mutant in mutants:
            if mutant.name in killed:
                continue
            limit = limit or _limit(seconds, module, source)
            if seconds(mutant.source, limit) is not None:
                survivors.append(mutant)
            else:
                killed.append(mutant.name)
            write_text(kept, json.dumps({"source": digest, "killed": killed}, indent=1) + "\n")
    return Tried(module, mutants, survivors)


def _killed(kept: Path, digest: str) -> list[str]:
    """Names of mutants of this source that were killed before."""
    found: Mapping[str, Any] = json.loads(kept.read_text(encoding="utf-8")) if kept.exists() else {}
    return list(found["killed"]) if found.get("source") == digest else []


def _limit(seconds: Callable[[str, float], float | None], module: str, source: str) -> float:
    took = seconds(source, _FIRST)
    if took is None:
        raise ValueError(f"the tests of {module} fail, or take more than {_FIRST:g} s, without a fault: run them first")
    return max(_MORE * took, _AT_LEAST)
