"""Folders of exports: written as a whole or not at all, and never over a user's files."""

import json
import tempfile
from hashlib import sha256
from pathlib import Path
from typing import Any

from baselines.tools.files import replace_folder, require_writable, sha256_of
from baselines.tools.provenance import command_line, software
from beltarm_env import ArmParams
from beltarm_env.task.ranges import EDITION

FORMAT = "beltarm-export"
MANIFEST = "manifest.json"


def require_free(folder: Path, marker: str = MANIFEST, form: str = FORMAT) -> None:
    """Check that a folder is not there, is empty, or holds what an export of the same kind wrote.

    An export is known by the entry "format" of a JSON file, the marker, and its files by their sums there, if any.

    Raises:
        ValueError: If it holds anything else, or one of its files was changed.
        OSError: If it cannot be read, or its parent cannot be written to.
    """
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder} is a file: choose another folder for --out")
    try:
        manifest = json.loads((folder / marker).read_text(encoding="utf-8"))
        sums = manifest["sha256"] if manifest["format"] == form else {}
    except (OSError, ValueError, KeyError, TypeError):
        sums = {}
    for path in sorted(folder.iterdir()) if folder.exists() and isinstance(sums, dict) else ():
        written = path.is_file() and sums.get(path.name) == sha256_of(path)
        if not written and not (sums and path.name == marker):
            raise ValueError(f"{folder} holds {path.name}, which no export wrote: choose another folder for --out")
    require_writable(folder.parent)


def write_export(folder: Path, name: str, title: str, params: ArmParams, files: dict[str, bytes]) -> None:
    """Write files and their manifest into a folder, which is replaced if it holds an earlier export.

    Raises:
        ValueError: If the folder is in use for something else.
        OSError: If it cannot be written.
    """
    require_free(folder)
    manifest: dict[str, Any] = {
        "format": FORMAT,
        "name": name,
        "title": title,
        "arm_edition": EDITION,
        "gear_ratio": params.gear_ratio,
        "torque_limit": params.torque_limit,
        "command": command_line(),
        "software": software("numpy", "ziglang"),
        "sha256": {file: sha256(content).hexdigest() for file, content in sorted(files.items())},
    }
    write_folder(folder, {**files, MANIFEST: (json.dumps(manifest, indent=2) + "\n").encode()})


def write_folder(folder: Path, files: dict[str, bytes]) -> None:
    """Write files into a new folder and put it in the place of an older one.

    Raises:
        OSError: If it cannot be written; an older one is then as it was.
    """
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}-") as scratch:
        made = Path(scratch) / folder.name
        made.mkdir()
        for file, content in files.items():
            (made / file).write_bytes(content)
        replace_folder(folder, made)
