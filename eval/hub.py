"""Write the folder of a policy for the Hugging Face Hub: `python eval/hub.py agents/policies/student/seed0`.

The folder has the policy, a card that the Hub reads, and what the card's scores rest on. Nothing is uploaded: the
command that does is printed. docs/guide/hub.md says what is in the folder, and what is safe to load.
"""

from __future__ import annotations

import re
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import tyro

from agents.policy.bundle import read_spec
from agents.policy.card import Offer, model_name
from agents.runs.command_line import compare_command
from baselines.tools.command import run_command
from eval.deploy.package import write_folder
from eval.sharing import folder as shared
from eval.sharing.citation import bibtex
from eval.sharing.page import markdown, model_index
from eval.sharing.scores import scores_of

PUBLISHED = Path(__file__).resolve().parent.parent / "docs" / "results" / "comparison" / "results.json"


@dataclass(frozen=True)
class Config:
    """Write the folder of a policy for the Hugging Face Hub."""

    policy: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="POLICY")]
    """Folder of a policy, such as runs/ppo/best."""
    out: Path | None = None
    """Folder to write. Default: results/hub/NAME, by the repository's name or the algorithm's."""
    results: Path | None = None
    """results.json of a comparison in which the policy took part. Default: the published one, if it did in that; else
    the card has no scores."""
    repo_id: str = ""
    """Repository on the Hub, ORG/NAME, for the card and the printed command."""
    license: str = "mit"
    """Licence that you offer the policy under, as the Hub abbreviates it."""
    onnx: bool = False
    """Write the policy's network as policy.onnx too. Needs the extra onnx."""
    video: bool = False
    """Write a film, replay.mp4, which the Hub shows. Needs the extra video."""
    overwrite: bool = False
    """Replace a folder that was written before."""


def share(config: Config) -> None:
    """Write the folder, and print how to upload it.

    Raises:
        ValueError: If an option is not allowed, the policy is damaged, or the results are not of it.
        OSError: If the folder cannot be written.
    """
    shared.require_repo(config.repo_id)
    if not re.fullmatch(r"[a-z0-9][a-z0-9.-]*", config.license):
        raise ValueError(f"--license must be the Hub's abbreviation, such as mit or apache-2.0, got {config.license!r}")
    _, content = read_spec(config.policy)
    out = config.out or Path("results/hub") / (config.repo_id.split("/")[-1] or model_name(content))
    shared.require_free(out, config.overwrite)
    scores = scores_of(config.policy, content["content_hash"], config.results or PUBLISHED)
    if scores is None and config.results is not None:
        raise ValueError(f"{config.policy} took no part in {config.results}: give it to eval/compare.py with --policy")
    told = (model_index(scores), markdown(scores)) if scores else ((), "")
    files = shared.files_of(config.policy, Offer(config.repo_id, config.license, *told, bibtex()), scores)
    if config.onnx:
        from agents.policy.onnx_model import onnx_model

        files[shared.MODEL] = onnx_model(config.policy).SerializeToString()
    if config.video:
        files[shared.FILM] = shared.film_of(config.policy)
    write_folder(out, files)
    if scores is None:
        print(f"without scores: `{compare_command([config.policy])}` makes some, for --results")
    print(f"written to {out}: {', '.join(sorted(files))}")
    print(f"to upload it: {shlex.join(['hf', 'upload', config.repo_id or 'ORG/NAME', str(out)])}")


def main() -> None:
    """Command line."""
    run_command(__file__, Config, share, __doc__)


if __name__ == "__main__":
    main()
