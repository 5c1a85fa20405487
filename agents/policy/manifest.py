"""The manifest of a policy bundle, `policy.json`: its schema and hash, and reading it whole or not at all."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from agents.policy.card import MANIFEST
from agents.residual.bases import BASES
from baselines.tools.files import read_regular
from baselines.tools.schema import FLAG, INTEGER, NUMBER, TEXT, check, in_a_line, list_of, mapping_of, object_of, parse
from beltarm_env.observation import ENTRIES
from beltarm_env.task.ranges import EDITION

FORMAT = "beltarm-policy"
VERSION = 3
MAX_BYTES = 1_000_000
"""Of each file of a bundle; larger ones are neither written nor read."""
ALGORITHMS = {"ppo": False, "recurrent_ppo": False, "rma": False, "sac": True, "student": False}
"""Algorithms by name, and whether a tanh bounds their residuals, instead of a cut."""
_COUNT, _TIME = (kind | {"minimum": 0, "maximum": 10**15} for kind in (INTEGER, NUMBER))
_RUN = {"steps": _COUNT, "seconds": _TIME}
_POINT = {"type": "array", "prefixItems": [_COUNT, _TIME, NUMBER], "minItems": 3, "maxItems": 3}
_NAMED_NUMBERS = {"type": "object", "propertyNames": {"pattern": r"^\w+\Z"}, "additionalProperties": NUMBER}
_PROVENANCE = {
    "command": TEXT,
    "version": TEXT,
    "commit": TEXT,
    "versions": mapping_of(TEXT),
    "config": object_of(("seed", "randomization"), seed=INTEGER, randomization=TEXT),
    "run": object_of(("steps", "seconds"), **_RUN),
    "curve": list_of(_POINT),
    "reached": object_of(**_RUN, validation=_NAMED_NUMBERS),
    "validation_of_base": _NAMED_NUMBERS,
}
SCHEMA = object_of(
    ("base_settings", "base_hash"),
    layout=INTEGER,
    algorithm={"enum": list(ALGORITHMS)},
    base={"enum": list(BASES)},
    residual=object_of(limit=NUMBER, hold=INTEGER, knowledge=TEXT) | {"additionalProperties": False},
    hidden=list_of(INTEGER),
    activation=TEXT,
    sensors={"enum": list(ENTRIES)},
    lstm=INTEGER,
    gru=INTEGER,
    standardised=FLAG,
    provenance=object_of(tuple(_PROVENANCE), **_PROVENANCE),
    base_settings=mapping_of(_NAMED_NUMBERS),
    base_hash=TEXT,
    entries=list_of(list_of({})),
    weights=object_of(file=TEXT, sha256=TEXT),
)
"""JSON Schema (2020-12) of a manifest in this release's format; what it names in `provenance` may lack."""


class BundleError(ValueError):
    """Error about a policy bundle that is missing, damaged or of another format."""


def content_hash(content: dict[str, Any]) -> str:
    """Compute the SHA-256 of a manifest's content but for the hash in it."""
    rest = {key: value for key, value in content.items() if key != "content_hash"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def read_manifest(folder: Path) -> dict[str, Any]:
    """Read and check the manifest of a bundle: complete, and in this release's format.

    Raises:
        BundleError: If it is not.
    """
    manifest = folder / MANIFEST
    try:
        content = parse(read_regular(manifest, MAX_BYTES))
    except FileNotFoundError:
        raise BundleError(
            f"no policy bundle at {folder}: {MANIFEST} is missing; a bundle is a folder such as runs/ppo/best"
        ) from None
    except (OSError, ValueError) as error:
        raise BundleError(f"{manifest} cannot be read ({error}); save the policy again") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise BundleError(f"{manifest} is not a {FORMAT} bundle")
    if content.get("version") != VERSION:
        version = in_a_line(repr(content.get("version")), 80)
        raise BundleError(f"{manifest} has version {version}, this release reads {VERSION}: train it again")
    if content.get("edition") != EDITION:
        edition = in_a_line(repr(content.get("edition")), 80)
        raise BundleError(
            f"{manifest} was trained on arms of edition {edition}, these are of {EDITION}: train it again"
        )
    if content.get("content_hash") != content_hash(content):
        raise BundleError(f"{manifest} was changed after it was saved: its content hash does not match")
    try:
        check(content, f"{manifest} does not fit this release", SCHEMA)
    except ValueError as error:
        raise BundleError(str(error)) from None
    return content
