"""Small untrained policies, and changes to their files."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.numpy import save

from agents.policy.actor import Actor
from agents.policy.bundle import POLICY_FILE
from agents.policy.description import BundleSpec
from agents.policy.weights import Weights
from agents.residual.controller import ResidualSettings
from agents.tensor_file import digest_of, unpacked

SPEC = BundleSpec("ppo", "paper", ResidualSettings(), (4, 3), provenance={"seed": 1})


def new_weights(spec: BundleSpec = SPEC, seed: int | None = None) -> Weights:
    """Random weights, with a seed always the same, that move the arms but leave them in their workspace."""
    if seed is not None:
        torch.manual_seed(seed)
    return Actor(spec.shape()).weights()


def edit(bundle: Path, tensors: dict[str, np.ndarray] | None = None, *, rehash: bool = True, **changes: Any) -> None:
    """Change a policy, with a fitting hash (a foreign program's) or without (a hand's); `...` takes an entry away."""
    content, known = unpacked((bundle / POLICY_FILE).read_bytes(), "policy")
    content = {name: value for name, value in {**content, **changes}.items() if value is not ...}
    tensors = known if tensors is None else tensors
    if rehash:
        content["sha256"] = digest_of(content, tensors)
    (bundle / POLICY_FILE).write_bytes(save(tensors, metadata={"policy": json.dumps(content)}))


class Exploit:
    """Its pickle, loaded, creates a file."""

    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> Any:
        return (Path.touch, (self.target,))
