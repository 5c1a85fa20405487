"""A policy's model card: what its description says, for people and the Hugging Face Hub.

The card is Markdown. Before it, between two lines of dashes, stands YAML, which the Hub reads: fields as
`huggingface_hub.ModelCardData` has them. That class is not used, since training needs no package of the Hub: it writes
the scores of a policy that is offered (`eval.exports.hub`).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import yaml

from beltarm_env.task.ranges import resolve_ranges
from beltarm_env.timing import CONTROL_PERIOD

ENVIRONMENT = "BeltArm-v0"
POLICY_FILE = "policy.safetensors"
CARD = "README.md"
_ROWS = 12  # of the learning curve
_TEMPLATES = jinja2.Environment(
    loader=jinja2.FileSystemLoader(Path(__file__).parent),
    keep_trailing_newline=True,
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
)


@dataclass(frozen=True, slots=True)
class Offer:
    """What a card says besides the description, of a policy that is offered to others."""

    repo_id: str = ""  # ORG/NAME on the Hub
    license: str = ""  # as the Hub names it, such as "mit"
    scores: str = ""  # and where the policy loses: Markdown
    citation: str = ""  # how to cite it: BibTeX


def model_name(content: dict[str, Any]) -> str:
    """Name of a policy as the Hub's agents are called, from its description."""
    return f"{content['algorithm']}-{ENVIRONMENT}"


def card(content: dict[str, Any], offer: Offer | None = None) -> str:
    """Format a description as a card: what the policy is, how it is loaded, its training, and what is offered."""
    offer, provenance = offer or Offer(), content["provenance"]
    config, curve = provenance.get("config", {}), provenance.get("curve", [])
    moves = config.get("moves", 1)
    return _TEMPLATES.get_template("card.md.j2").render(
        front_matter=yaml.safe_dump(front_matter(content, offer), sort_keys=False, allow_unicode=True),
        environment=ENVIRONMENT,
        period=CONTROL_PERIOD,
        policy_file=POLICY_FILE,
        policy=content,
        residual=content["residual"],
        provenance=provenance,
        offer=offer,
        software={"beltarm": provenance.get("version"), **provenance.get("versions", {})},
        seed=config.get("seed"),
        curve=[curve[k] for k in np.linspace(0, len(curve) - 1, min(len(curve), _ROWS)).round().astype(int)],
        moves=moves,
        ranges=resolve_ranges(config["randomization"], moves) if "randomization" in config else {},
    )


def front_matter(content: dict[str, Any], offer: Offer) -> dict[str, Any]:
    """Fields that the Hub reads. A library is named whose interface the policy has, not one whose archive it is."""
    learning = ["deep-reinforcement-learning", "reinforcement-learning", "residual-policy-learning"]
    method = [content["algorithm"], f"residual-on-{content['base']}"]
    return {
        **({"license": offer.license} if offer.license else {}),
        "library_name": "stable-baselines3",
        "pipeline_tag": "reinforcement-learning",
        "tags": [ENVIRONMENT, *learning, *method, "gymnasium", "robotics", "beltarm"],
    }
