"""A policy's model card: what its description says, for people and the Hugging Face Hub.

The card is Markdown. Before it, between two lines of dashes, stands YAML, which the Hub reads: fields as
`huggingface_hub.ModelCardData` has them. That class is not used, since training needs no package of the Hub: it writes
the scores of a policy that is offered (`eval.exports.hub`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
import yaml

from beltarm_env.task.ranges import RANGES
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
    offer = offer or Offer()
    provenance = content["provenance"]
    reached, base = provenance.get("reached", {}), provenance.get("validation_of_base", {})
    return _TEMPLATES.get_template("card.md.j2").render(
        front_matter=yaml.safe_dump(front_matter(content, offer), sort_keys=False, allow_unicode=True),
        environment=ENVIRONMENT,
        period=CONTROL_PERIOD,
        policy_file=POLICY_FILE,
        policy=content,
        residual=content["residual"],
        repo_id=offer.repo_id,
        scores=offer.scores,
        facts=_facts(content),
        reached=reached,
        validation=[(name, value, base[name]) for name, value in reached.get("validation", {}).items() if name in base],
        curve=_points(provenance.get("curve", [])),
        ranges=RANGES.get(provenance.get("config", {}).get("randomization", ""), {}),
        citation=offer.citation,
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


def _facts(content: dict[str, Any]) -> dict[str, Any]:
    """Table of what the description says of the policy and its training; what it does not say is left out."""
    provenance, residual = content["provenance"], content["residual"]
    network = " × ".join(str(width) for width in content["hidden"]) or "linear"
    memory = "".join(f"{kind.upper()} of {content[kind]}, then " for kind in ("lstm", "gru") if content[kind])
    software = {"beltarm": provenance.get("version"), **provenance.get("versions", {})}
    facts = {
        "algorithm": content["algorithm"],
        "base controller": f"`{content['base']}`, settings {content['base_hash'][:12]}",
        "residual": f"at most {residual['limit']:g} of the torque limit, held for {residual['hold']} samples",
        "told besides the observation": residual["knowledge"],
        "sensors": content["sensors"],
        "network": f"{memory}{network}, {content['activation']}",
        "inputs": f"{len(content['entries'])}, layout {content['layout']}",
        "seed": provenance.get("config", {}).get("seed"),
        "command": f"`{provenance['command']}`" if "command" in provenance else None,
        "commit": provenance.get("commit"),
        "versions": ", ".join(f"{name} {version}" for name, version in software.items() if version),
    }
    return {name: value for name, value in facts.items() if value not in (None, "")}


def _points(curve: Sequence[Sequence[float]]) -> list[Sequence[float]]:
    """A dozen points of the learning curve."""
    count = min(len(curve), _ROWS)
    return [curve[round(k * (len(curve) - 1) / max(count - 1, 1))] for k in range(count)]
