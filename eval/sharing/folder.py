"""The folder of a policy that is offered to others: all of it is written, or nothing, and nothing is uploaded."""

from __future__ import annotations

import json
import os
import re
import tempfile
from pathlib import Path
from typing import Any

from agents.policy.bundle import CARD, MANIFEST, bundle_files, load_controller, read_spec, read_weights
from agents.policy.card import ENVIRONMENT, Offer, card
from eval.comparison.sets import development_set
from eval.comparison.splits import main_split
from eval.report import side_by_side
from eval.report.film import require_writer
from eval.sharing.scores import Scores, with_sensors

FORMAT = "beltarm-shared-policy"
CONFIG, EXCERPT, FILM, MODEL = "config.json", "results.json", "replay.mp4", "policy.onnx"
_LARGE = ("*.safetensors", "*.onnx", "*.mp4")
_REPO = re.compile(r"[A-Za-z0-9][\w.-]{0,95}/[A-Za-z0-9][\w.-]{0,95}", re.ASCII)
_SPEED = 0.5  # of the film


def require_repo(repo_id: str) -> None:
    """Check the name of a repository on the Hub; none is allowed too.

    Raises:
        ValueError: If it cannot be one.
    """
    if repo_id and (not _REPO.fullmatch(repo_id) or re.search(r"--|\.\.|[.-]/|[.-]$|\.git$", repo_id)):
        raise ValueError(
            f"--repo-id must be ORG/NAME of letters, digits, '-', '_' and '.', beginning and ending with a letter or a "
            f"digit, without '--' and '..', got {repo_id!r}"
        )


def require_free(folder: Path, overwrite: bool) -> None:
    """Check that a folder is not there, is empty, or may be replaced: on demand, one that was written here.

    Raises:
        ValueError: If it may not.
        OSError: If the folder that it is to be in cannot be written to.
    """
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder} is a file: choose another folder for --out")
    if folder.exists() and any(folder.iterdir()):
        if not _is_ours(folder):
            raise ValueError(f"{folder} holds other files: choose another folder for --out")
        if not overwrite:
            raise ValueError(f"{folder} is there already: replace it with --overwrite, or choose another with --out")
    folder.parent.mkdir(parents=True, exist_ok=True)
    if not os.access(folder.parent, os.W_OK):
        raise OSError(f"cannot write to {folder.parent}; choose another folder")


def _is_ours(folder: Path) -> bool:
    try:
        return json.loads((folder / CONFIG).read_text(encoding="utf-8"))["format"] == FORMAT
    except (OSError, ValueError, KeyError, TypeError):
        return False


def files_of(policy: Path, offer: Offer, scores: Scores | None) -> dict[str, bytes]:
    """Files of the folder by name: the bundle as it is, under a new card, and what is known of its scores.

    Raises:
        BundleError: If the bundle is missing, damaged, or foreign.
    """
    _, _, content = read_weights(policy)
    config = {
        "format": FORMAT,
        "environment": ENVIRONMENT,
        "manifest": MANIFEST,
        "content_hash": content["content_hash"],
        **{name: content[name] for name in ("algorithm", "base", "sensors", "residual", "edition", "layout")},
    }
    texts = {
        CARD: card(content, offer),
        CONFIG: _json(config),
        ".gitattributes": "".join(f"{pattern} filter=lfs diff=lfs merge=lfs -text\n" for pattern in _LARGE),
        **({EXCERPT: _json(scores.excerpt())} if scores else {}),
    }
    return {**{name: text.encode() for name, text in texts.items()}, **bundle_files(policy)}


def _json(content: Any) -> str:
    return json.dumps(content, indent=2, allow_nan=False) + "\n"


def film_of(policy: Path) -> bytes:
    """Film of the policy on the first scenario of the development set's main split, as MP4.

    Raises:
        ValueError: If nothing is installed that writes it.
    """
    require_writer(Path(FILM))
    controller = load_controller(policy)
    spec, _ = read_spec(policy)
    splits = development_set().splits
    split = with_sensors(splits[main_split(list(splits))], spec.sensors)
    track = side_by_side.track_of(f"{spec.algorithm} on {spec.base}, {split.name}", split.run(controller, 0))
    with tempfile.TemporaryDirectory() as made:
        side_by_side.write([track], _SPEED, Path(made) / FILM)
        return (Path(made) / FILM).read_bytes()
