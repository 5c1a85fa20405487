"""The folder of a policy for the Hugging Face Hub: the policy, a card that the Hub reads, and the card's scores.

Nothing is uploaded: the command that does is printed. docs/guide/hub.md says what is in the folder, and what is safe to
load. Needs the extra hub.
"""

import json
import re
import shlex
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
import yaml
from gymnasium.error import DependencyNotInstalled

from agents.policy.bundle import CARD, ENVIRONMENT, POLICY_FILE, Offer, card, load_controller, model_name, read_bundle
from agents.runs.command_line import compare_command
from beltarm_env.rollout import rollout
from eval.comparison.sets import development_set
from eval.exports.folder import require_free, write_folder
from eval.exports.scores import Scores, eval_results, markdown, scores_of
from eval.exports.source import TEMPLATES
from eval.report import side_by_side

ROOT = Path(__file__).resolve().parents[2]
PUBLISHED = ROOT / "docs" / "results" / "comparison" / "results.json"
CITATION: dict[str, Any] = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
FORMAT = "beltarm-shared-policy"
CONFIG, FILM, MODEL = "config.json", "replay.mp4", "policy.onnx"
_LARGE = ("*.safetensors", "*.onnx", "*.mp4")
_SPEED = 0.5  # of the film


@dataclass(frozen=True)
class Options:
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


def export(options: Options) -> None:
    """Write the folder, and print how to upload it."""
    try:
        from huggingface_hub.utils import HFValidationError, validate_repo_id
    except ImportError:
        raise DependencyNotInstalled("this needs huggingface_hub: pip install 'beltarm-env[hub]'") from None
    try:
        if options.repo_id:
            validate_repo_id(options.repo_id)
            if "/" not in options.repo_id:
                raise HFValidationError("it names no owner")
    except HFValidationError as error:
        line = " ".join(str(error).split())
        raise ValueError(f"--repo-id must be ORG/NAME as the Hub allows it, got {options.repo_id!r}: {line}") from None
    if not re.fullmatch(r"[a-z0-9][a-z0-9.-]*", options.license):
        raise ValueError(f"--license must be the Hub's abbreviation, such as mit, got {options.license!r}")
    content = read_bundle(options.policy).content
    out = options.out or Path("results/hub") / (options.repo_id.split("/")[-1] or model_name(content))
    require_free(out, CONFIG, FORMAT)
    if out.exists() and any(out.iterdir()) and not options.overwrite:
        raise ValueError(f"{out} is there already: replace it with --overwrite, or choose another with --out")
    scores = scores_of(options.policy, content["sha256"], options.results or PUBLISHED)
    if scores is None and options.results is not None:
        raise ValueError(f"{options.policy} took no part in {options.results}: give it to eval/compare.py by --policy")
    files = files_of(options, scores)
    write_folder(out, files)
    if scores is None:
        print(f"without scores: `{compare_command([options.policy])}` makes some, for --results (and --overwrite)")
    print(f"written to {out}: {', '.join(sorted(files))}")
    print(f"to upload it: {shlex.join(['hf', 'upload', options.repo_id or 'ORG/NAME', str(out)])}")


def files_of(options: Options, scores: Scores | None) -> dict[str, bytes]:
    """Files of the folder by name: the policy as it is, under a new card with its scores.

    Raises:
        BundleError: If the policy is missing, damaged, or foreign.
        DependencyNotInstalled: If a package is not installed.
        ValueError: If no package is installed that writes films.
    """
    from huggingface_hub import ModelCard

    _, spec, content, data = read_bundle(options.policy)
    config: dict[str, Any] = {"format": FORMAT, "environment": ENVIRONMENT, "policy": POLICY_FILE}
    config |= {key: content[key] for key in ("sha256", "algorithm", "base", "sensors", "residual", "edition", "layout")}
    text = markdown(scores) if scores else ""
    model_card = ModelCard(card(content, Offer(options.repo_id, options.license, scores=text, citation=bibtex())))
    if scores:
        model_card.data["model_name"], model_card.data["eval_results"] = model_name(content), eval_results(scores)
    texts = {
        CARD: str(model_card),
        CONFIG: json.dumps(config, indent=2) + "\n",
        ".gitattributes": "".join(f"{pattern} filter=lfs diff=lfs merge=lfs -text\n" for pattern in _LARGE),
    }
    files = {**{name: text.encode() for name, text in texts.items()}, POLICY_FILE: data}
    if options.onnx:
        from agents.policy.onnx_model import onnx_model

        files[MODEL] = onnx_model(options.policy).SerializeToString()
    if options.video:
        side_by_side.require_writer(Path(FILM))
        split = development_set().splits["randomized"]  # the first single move of the development set
        motion = rollout(load_controller(options.policy), 1, sensors=spec.sensors, **split.arguments(slice(1)))
        track = side_by_side.Track(f"{spec.algorithm} on {spec.base}, {split.name}", motion)
        with tempfile.TemporaryDirectory() as made:
            side_by_side.write([track], _SPEED, Path(made) / FILM)
            files[FILM] = (Path(made) / FILM).read_bytes()
    return files


def bibtex() -> str:
    """Write CITATION.cff as BibTeX: the software, and the paper whose robot it simulates."""
    return TEMPLATES.get_template("citation.bib.j2").render(CITATION, released=str(CITATION["date-released"]))
