"""Variants of PPO's default run that the ablations train: each changes one thing of `train/ppo.py`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple


class Factor(NamedTuple):
    """Something that is varied."""

    question: str
    default: str  # its setting in the default run


@dataclass(frozen=True)
class Variant:
    """Training run that changes one option of the default run."""

    name: str  # its folder's
    factor: str  # key of `FACTORS`
    label: str
    options: tuple[str, ...] = ()
    script: str = "ppo"
    common_budget: bool = True  # False for a learner whose steps are not those of PPO


FACTORS = {
    "told": Factor("What must the agent know of the arm?", "belief of the filter"),
    "base": Factor("Which controller should it correct?", "paper"),
    "hold": Factor("How long should a residual be held?", "6 ms"),
    "discount": Factor("How far should it look ahead?", "0.988: 0.5 s"),
    "limit": Factor("How much torque may it add?", "the whole limit"),
    "exploration": Factor("How wildly should it explore?", "0.52 of the range"),
    "learning_rate": Factor("How fast should it learn?", "3.5e-4"),
    "network": Factor("How wide must the network be?", "256, 256"),
    "arms": Factor("How many arms at once?", "512"),
    "activation": Factor("Does the activation function matter?", "relu"),
    "teacher": Factor("Does a teacher help?", "none: PPO"),
}
"""Everything that is varied, by name."""
DEFAULT = Variant("default", "default", "default")
VARIANTS = (
    DEFAULT,
    Variant("nothing", "told", "nothing", ("--knowledge", "none")),
    Variant("lstm", "told", "nothing, with an LSTM", script="recurrent_ppo"),
    Variant("torsion", "told", "true torsion, no belief", ("--sensors", "full", "--knowledge", "none")),
    Variant("torsion-belief", "told", "true torsion and belief", ("--sensors", "full")),
    Variant("base-preview", "base", "preview", ("--base", "preview")),
    Variant("base-lqg", "base", "lqg", ("--base", "lqg")),
    Variant("base-adaptive", "base", "adaptive", ("--base", "adaptive")),
    Variant("small-on-adaptive", "base", "adaptive, 0.1 of limit", ("--base", "adaptive", "--residual-limit", "0.1")),
    Variant("base-none", "base", "none: from scratch", ("--base", "none")),
    Variant("hold-2", "hold", "3 ms, as far ahead", ("--hold", "2", "--gamma", "0.994")),
    Variant("hold-12", "hold", "18 ms, as far ahead", ("--hold", "12", "--gamma", "0.964")),
    Variant("gamma-0.95", "discount", "0.95: 0.12 s", ("--gamma", "0.95")),
    Variant("gamma-0.98", "discount", "0.98: 0.3 s", ("--gamma", "0.98")),
    Variant("gamma-0.995", "discount", "0.995: 1.2 s", ("--gamma", "0.995")),
    Variant("limit-0.3", "limit", "0.3 of the limit", ("--residual-limit", "0.3")),
    Variant("noise-small", "exploration", "0.14 of the range", ("--initial-log-std", "-2")),
    Variant("noise-large", "exploration", "1.0 of the range", ("--initial-log-std", "0")),
    Variant("entropy-1e-4", "exploration", "with hardly any entropy bonus", ("--entropy", "0.0001")),
    Variant("rate-1e-4", "learning_rate", "1e-4", ("--learning-rate", "0.0001")),
    Variant("rate-1e-3", "learning_rate", "1e-3", ("--learning-rate", "0.001")),
    Variant("width-64", "network", "64, 64", ("--hidden", "64", "64")),
    Variant("width-128", "network", "128, 128", ("--hidden", "128", "128")),
    Variant("arms-128", "arms", "128", ("--arms", "128")),
    Variant("tanh", "activation", "tanh", ("--activation", "tanh")),
    Variant("student", "teacher", "a student of a practised teacher", script="student", common_budget=False),
)
