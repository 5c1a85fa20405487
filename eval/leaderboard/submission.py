"""Submissions: what is in one, and what is refused.

    submission.json    what is submitted by whom, its scores, and the SHA-256 of every other file
    results.json       of the comparison, with command, commit, scenarios, packages
    controller/...     all files of a controller's folder; or
    policies/0, ...    a policy bundle for each training seed

Nothing of a controller or policy is executed where a submission is read.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from agents.policy.bundle import MANIFEST as POLICY_MANIFEST
from baselines import CONTROLLERS
from baselines.tools.schema import check, loads
from eval.comparison import schema, splits
from eval.comparison.methods import PRIMARY, PRIVILEGED, shipped_policies
from eval.comparison.results import COMPUTING_TIME
from eval.comparison.sets import DEVELOPMENT_NAME, ScenarioSet
from eval.leaderboard.archive import read_archive
from eval.leaderboard.scores import QUANTITIES, Scores

FORMAT, FORMAT_VERSION = "beltarm-submission", 1
MANIFEST, RESULTS = "submission.json", "results.json"
REFERENCES = (PRIMARY[1], PRIMARY[0])
"""The project's own methods that run beside every submission: the classical one of the primary comparison first."""
CONTROLLER, POLICIES = "controller", "policies"
_COMMIT = re.compile(r"(?!unknown$|.*-dirty$)[\w.-]{1,60}")
_HASH = {"type": "string", "pattern": "^[0-9a-f]{64}$"}
_NAME = {"type": "string", "pattern": r"^[A-Za-z0-9_][A-Za-z0-9_.-]{0,59}$"}
PERSON = {"type": "string", "pattern": r"^[^\W_][\w .,'&()-]{0,99}$"}
"""JSON Schema of the name of a person or group: nothing that a page or a terminal would take for more than text."""
_SCORE = {
    "type": "object",
    "required": list(QUANTITIES),
    "additionalProperties": False,
    "properties": {
        name: {"type": "number", "minimum": 0, "maximum": 1}
        if quantity.share
        else {"type": "number", "exclusiveMinimum": 0}
        for name, quantity in QUANTITIES.items()
    },
}
SCORES = {"type": "object", "additionalProperties": {"type": "object", "additionalProperties": _SCORE}}
"""JSON Schema of `Scores`."""
_PROPERTIES = {
    "format": {"const": FORMAT},
    "format_version": {"const": FORMAT_VERSION},
    "method": _NAME,
    "author": PERSON,
    "kind": {"enum": ["added", "learned"]},
    "sources": {"type": "array", "minItems": 1, "items": {"type": "string"}},
    "scores": SCORES,
    "files": {"type": "object", "additionalProperties": _HASH},
}
SCHEMA = {
    "type": "object",
    "required": list(_PROPERTIES),
    "additionalProperties": False,
    "properties": _PROPERTIES,
}
"""JSON Schema (2020-12) of `submission.json`."""


@dataclass(frozen=True, slots=True)
class Rules:
    """What a submission has to be measured on."""

    scenarios: ScenarioSet
    episodes: int  # of each split
    references: tuple[str, ...] = REFERENCES  # methods of the project that run beside it


@dataclass(frozen=True, slots=True)
class Submission:
    """A submission that keeps the rules, and whose hashes agree."""

    content: dict[str, Any]  # of submission.json
    results: dict[str, Any]  # of results.json
    files: dict[str, bytes]  # all, by name

    @property
    def method(self) -> str:
        """Name of what is submitted."""
        return self.content["method"]

    @property
    def scores(self) -> Scores:
        """Scores that are submitted, of the method and of the references beside it."""
        return self.content["scores"]

    @property
    def is_code(self) -> bool:
        """Whether running it executes code of its author; a policy bundle holds numbers alone."""
        return self.content["kind"] == "added"


def read(path: Path, rules: Rules) -> Submission:
    """Read a submission from its archive, and check it.

    Raises:
        ValueError: If it is damaged, or does not keep the rules.
    """
    return opened(read_archive(path), rules, path.name)


def require_person(name: str, option: str) -> None:
    """Check a name that is given with an option.

    Raises:
        ValueError: If it is empty, too long, or more than a name.
    """
    if not re.fullmatch(PERSON["pattern"], name):
        raise ValueError(
            f"{option} must be a name of at most 100 letters, digits, spaces and .,'&()-, got {name[:100]!r}"
        )


def opened(files: dict[str, bytes], rules: Rules, where: str) -> Submission:
    """Check the files of a submission: hashes, schemas, rules, and that its parts agree with one another.

    Raises:
        ValueError: Naming the first thing that is wrong.
    """
    content = _json(files, MANIFEST, where)
    check(content, f"{where}: {MANIFEST}", SCHEMA)
    _require_hashes(files, content["files"], where)
    results = _json(files, RESULTS, where)
    schema.check(results, f"{where}: {RESULTS}")
    require_rules(results, content["method"], rules, where)
    _require_scores(content, results, rules, where)
    for source in content["sources"]:
        code, _, name = source.rpartition(":")
        sound = code.startswith(f"{CONTROLLER}/") and code.endswith(".py") and name == content["method"]
        wanted = code if content["kind"] == "added" else f"{source}/{POLICY_MANIFEST}"
        if wanted not in files or (content["kind"] == "added") != sound:
            raise ValueError(f"{where} has no {source[:100]!r}, which it submits: pack it again")
    return Submission(content, results, files)


def _json(files: Mapping[str, bytes], name: str, where: str) -> Any:
    try:
        content = loads(files[name].decode("utf-8"), parse_constant=str)
        shown = json.dumps(content, ensure_ascii=False)
    except KeyError:
        raise ValueError(f"{where} has no {name}: it is no submission of eval/submit.py") from None
    except ValueError as error:
        raise ValueError(f"{where}: {name} is damaged ({error}): pack it again") from None
    if not shown.isprintable() or r"\u00" in shown:  # it may end up in a terminal
        raise ValueError(f"{where}: {name} has characters that cannot be shown: pack it again")
    return content


def _require_hashes(files: Mapping[str, bytes], hashes: Mapping[str, str], where: str) -> None:
    present = {*files} - {MANIFEST}
    if others := sorted(present ^ {*hashes}):
        which = "is not named in" if others[0] in present else "is missing, it is named in"
        raise ValueError(f"{where}: the file {others[0][:100]!r} {which} {MANIFEST}: pack it again")
    for name, digest in hashes.items():
        found = hashlib.sha256(files[name]).hexdigest()
        if found != digest:
            raise ValueError(
                f"{where}: {name} has the SHA-256 {found[:12]}, {MANIFEST} says {digest[:12]}: it was changed after it "
                "was packed; pack it again"
            )


def require_rules(results: Mapping[str, Any], name: str, rules: Rules, where: str) -> None:
    """Check that results are of all scenarios of the leaderboard's set, on a clean commit, with the references."""
    origin, wanted = results["provenance"], rules.scenarios.label
    if (results["edition"], results["version"]) != (splits.EDITION, splits.VERSION):
        raise ValueError(f"{where} has results of another edition or version of the scenarios: run the comparison anew")
    if results["scenario_set"] != wanted._asdict():
        found = str(results["scenario_set"]["name"])[:40]
        why = ", on which controllers may be chosen" if found == DEVELOPMENT_NAME else ""
        raise ValueError(f"{where} has results of the scenarios {found!r}{why}: run it with --scenarios {wanted.name}")
    if origin.get(COMPUTING_TIME):
        raise ValueError(f"{where} has results in which computing time counts: run it without --computing-time")
    if not _COMMIT.fullmatch(origin["commit"]):
        raise ValueError(
            f"{where} has results of the commit {origin['commit'][:60]!r}: commit or undo the changes to the project's "
            "files and run it again; a controller of your own may lie in a folder that git does not know"
        )
    if name in (names := {*CONTROLLERS, *(path.parent.name for path in shipped_policies()), PRIVILEGED}):
        raise ValueError(f"{where} submits {name!r}, one of the project's own methods: give yours another name")
    rows = {(row["method"], row["split"]): row["episodes"] for row in results["rows"]}
    for failure in results["failures"]:
        if failure["method"] not in names - {*rules.references}:
            which, split, message = (failure[key][:200] for key in ("method", "split", "message"))
            raise ValueError(f"{where}: {which!r} failed on {split!r}: {message!r}")
    for method in (name, *rules.references):
        for split in rules.scenarios.splits:
            if (method, split) not in rows:
                raise ValueError(f"{where} has no results of {method} on {split}: run all splits, with {method}")
            if rows[method, split] != rules.episodes:
                raise ValueError(
                    f"{where} has {rows[method, split]} scenarios of {split}, the leaderboard takes all "
                    f"{rules.episodes}: run it with --episodes {rules.episodes}"
                )


def _require_scores(content: Mapping[str, Any], results: Mapping[str, Any], rules: Rules, where: str) -> None:
    costs = {(row["method"], row["split"]): row["metrics"]["cost"]["iqm"] for row in results["rows"]}
    kinds = {row["method"]: row["kind"] for row in results["rows"]}
    if kinds[content["method"]] != content["kind"]:
        raise ValueError(f"{where}: {MANIFEST} and {RESULTS} do not agree about the kind of {content['method']}")
    wanted = {(method, split) for method in (content["method"], *rules.references) for split in rules.scenarios.splits}
    if {(method, split) for method, found in content["scores"].items() for split in found} != wanted:
        raise ValueError(
            f"{where}: {MANIFEST} must have scores of {content['method']}, {', '.join(rules.references)} alone"
        )
    for method, split in sorted(wanted):
        if not np.isclose(content["scores"][method][split]["iqm"], costs[method, split], rtol=1e-9, atol=0):
            raise ValueError(f"{where}: {MANIFEST} and {RESULTS} do not agree about the cost of {method} on {split}")
