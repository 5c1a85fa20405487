"""The page that says which mutants the tests find, and of each that they do not, why."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from eval.mutation.mutants import Mutant
from eval.mutation.study import Tried
from eval.report.text import markdown_table

_JUDGEMENTS = Path(__file__).with_name("judgements.json")
_HEAD = """# Which faults the tests find

`make mutants` puts small faults into the code of physics, statistics and bundles of policies, one at a time: a sum for
a difference, a bound that is in instead of out, a number one larger. A mutant is killed if a test fails. Of each module
some mutants are drawn, and a few quick tests are to kill them: numbers say what these tests find, the whole suite finds
more. Tests have been added where mutants of these draws survived, so that of new mutants somewhat fewer would be
found. A mutant is equivalent if it does what the code does, so that no test can find it.
"""


class Judgement(NamedTuple):
    """Why a mutant survives."""

    function: str
    before: str
    after: str
    equivalent: bool
    why: str


def judgements() -> dict[str, list[Judgement]]:
    """Read the judgements of mutants that survived, by module."""
    found = json.loads(_JUDGEMENTS.read_text(encoding="utf-8"))
    return {module: [Judgement(**each) for each in of_module] for module, of_module in found.items()}


def markdown(parts: Sequence[Tried], origin: str, judged: Mapping[str, Sequence[Judgement]]) -> str:
    """Page with a table of modules, and all mutants that survived, with their judgements by module."""
    found = {part.module: [_of(mutant, judged.get(part.module, [])) for mutant in part.survivors] for part in parts}
    rows = [_row(part.module, len(part.mutants), found[part.module]) for part in parts]
    rows.append(_row("all", sum(len(part.mutants) for part in parts), [one for each in found.values() for one in each]))
    sections = [
        _HEAD,
        markdown_table(("module", "mutants", "killed", "survived", "equivalent", "killed of the others"), rows),
    ]
    sections += ["## What survived"] if any(found.values()) else []
    for module, survivors in found.items():
        sections += [f"### {module}", *map(_shown, survivors)] if survivors else []
    return "\n\n".join(section.strip() for section in [*sections, origin]) + "\n"


def _of(mutant: Mutant, judged: Sequence[Judgement]) -> Judgement:
    """Judgement of a mutant; one that says so where there is none yet."""
    place = (mutant.function, mutant.before, mutant.after)
    return next((each for each in judged if each[:3] == place), Judgement(*place, False, "Not judged yet."))


def _row(name: str, count: int, survivors: Sequence[Judgement]) -> list[str]:
    equivalent = sum(one.equivalent for one in survivors)
    killed = count - len(survivors)
    share = f"{killed / (count - equivalent):.0%}" if count > equivalent else "–"
    return [name, *map(str, (count, killed, len(survivors), equivalent)), share]


def _shown(one: Judgement) -> str:
    place = f"In `{one.function}`" if one.function else "Outside of functions"
    kind = "equivalent" if one.equivalent else "not found"
    return f"{place}, {kind}: {one.why}\n\n```diff\n-{one.before}\n+{one.after}\n```"
