"""Packing of submissions from a comparison's folder.

Scores come from the runs that the comparison keeps. Those are named by a key of all that they depend on, the
controller's files among it: what is packed is what was run. Nothing of a controller or policy is executed.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import shlex
from pathlib import Path

from agents.policy.bundle import bundle_files
from eval.comparison import custom, schema
from eval.comparison.methods import Method, added_method, classical_methods, learned_methods, shipped_policies
from eval.comparison.pairs import Pair, read_kept
from eval.leaderboard.archive import require_plain, require_size
from eval.leaderboard.scores import score
from eval.leaderboard.submission import (
    CONTROLLER,
    FORMAT,
    FORMAT_VERSION,
    MANIFEST,
    POLICIES,
    RESULTS,
    Rules,
    Submission,
    opened,
    require_person,
    require_rules,
)


def pack(folder: Path, author: str, rules: Rules) -> Submission:
    """Make a submission of the method of one's own in a comparison's folder.

    Raises:
        ValueError: If the folder has none or several, does not keep the rules, or was made by other files than those
            that are here.
    """
    require_person(author, "--author")
    results = schema.read_results(folder / RESULTS)
    method = _own_method(results["provenance"]["command"], {row["method"] for row in results["rows"]}, folder)
    require_rules(results, method.name, rules, str(folder))
    own = {found.name: found for found in [method, *classical_methods(), *learned_methods(shipped_policies())]}
    files, sources = _files_of(method, folder)
    files[RESULTS] = (folder / RESULTS).read_bytes()
    content = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "method": method.name,
        "author": author,
        "kind": method.kind,
        "sources": sources,
        "scores": {name: _kept_scores(own[name], folder, rules) for name in (method.name, *rules.references)},
        "files": {name: hashlib.sha256(data).hexdigest() for name, data in sorted(files.items())},
    }
    manifest = json.dumps(content, indent=1, allow_nan=False) + "\n"
    return opened({MANIFEST: manifest.encode(), **files}, rules, str(folder))


def _own_method(command: str, ran: set[str], folder: Path) -> Method:
    """Find the one method of the user's own in a comparison's command."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    parser.add_argument("--add", action="append", default=[])
    parser.add_argument("--policy", action="append", default=[])
    try:
        given, _ = parser.parse_known_args(shlex.split(command))
    except (argparse.ArgumentError, ValueError) as error:
        raise ValueError(f"{folder / RESULTS} has a command that cannot be read ({error}): run it again") from None
    for spec in given.add:
        where, _, _ = spec.rpartition(":")
        if not where.endswith(".py") or not Path(where).is_file():
            raise ValueError(
                f"{folder} is of --add {spec}, which is no file here: name it as path/to/file.py:Class, and pack "
                "in the folder where eval/compare.py ran"
            )
    methods = [*(added_method(spec, folder) for spec in given.add), *learned_methods(given.policy)]
    found = [method for method in methods if method.name in ran]
    if not found:
        raise ValueError(f"{folder} has the project's own methods alone: add yours, eval/compare.py --add or --policy")
    if len(found) > 1:
        names = ", ".join(method.name for method in found)
        raise ValueError(f"{folder} has several methods of your own, {names}: submit each from a folder of its own")
    return found[0]


def _files_of(method: Method, folder: Path) -> tuple[dict[str, bytes], list[str]]:
    """Files of a method by their name in the submission, and its sources there."""
    if method.kind == "learned":
        files, sources = {}, []
        for k, source in enumerate(map(Path, method.sources)):
            sources.append(f"{POLICIES}/{k}")
            files |= {f"{sources[-1]}/{name}": data for name, data in bundle_files(source).items()}
        return files, sources
    (spec,) = method.sources
    where, _, name = spec.rpartition(":")
    home = custom.home(spec)
    paths = custom.files_of(home, folder)
    remedy = f"put the controller, and all that it needs, into a folder of its own (all of {home} belongs to it now)"
    if paths is None:
        raise ValueError(f"{home} is too large, or cannot be read: {remedy}")
    try:
        require_plain([path.relative_to(home).as_posix() for path in paths], str(home))
        require_size(sum(path.stat().st_size for path in paths), str(home))
    except ValueError as error:
        raise ValueError(f"{error}; {remedy}") from None
    files = {f"{CONTROLLER}/{path.relative_to(home).as_posix()}": path.read_bytes() for path in paths}
    return files, [f"{CONTROLLER}/{Path(where).relative_to(home).as_posix()}:{name}"]


def _kept_scores(method: Method, folder: Path, rules: Rules) -> dict[str, dict[str, float]]:
    """Scores by split of a method whose runs are kept in a comparison's folder."""
    found = {}
    for split in rules.scenarios.splits.values():
        metrics = read_kept(Pair(method, split, rules.episodes), folder)
        if metrics is None:
            raise ValueError(
                f"{folder} does not keep the runs of {method.name} on {split.name} by the code and files that are "
                "here: run the same command again, which runs what has changed"
            )
        found[split.name] = score(metrics)
    return found
