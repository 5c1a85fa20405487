"""Bundles of small untrained policies, and changes to them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch
import yaml

import agents.policy.bundle
from agents.policy.actor import Actor
from agents.policy.bundle import MANIFEST, BundleSpec
from agents.policy.weights import Weights
from agents.residual.controller import ResidualSettings

SPEC = BundleSpec("ppo", "paper", ResidualSettings(), (4, 3), provenance={"seed": 1})


def new_weights(spec: BundleSpec = SPEC, seed: int | None = None) -> Weights:
    """Random weights, with a seed always the same, that move the arms but leave them in their workspace."""
    if seed is not None:
        torch.manual_seed(seed)
    return Actor(spec.shape()).weights()


def edit(bundle: Path, *, rehash: bool, **changes: Any) -> None:
    """Change the manifest, with a fitting content hash (a foreign program's) or without (a hand's)."""
    content = json.loads((bundle / MANIFEST).read_text())
    content.update(changes)
    if rehash:
        content["content_hash"] = agents.policy.bundle.content_hash(content)
    (bundle / MANIFEST).write_text(json.dumps(content))


class Exploit:
    """Its pickle, loaded, creates a file."""

    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> Any:
        return (Path.touch, (self.target,))


def halves(text: str) -> tuple[dict[str, Any], str]:
    """Front matter and Markdown of a card, parted where the Hub parts them."""
    empty, matter, body = text.split("---\n", 2)
    assert empty == ""
    return yaml.safe_load(matter), body
