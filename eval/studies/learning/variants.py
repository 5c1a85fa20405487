"""Variants that the ablations train: each changes one thing of `train/student.py`, or of `train/ppo.py`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple


class Factor(NamedTuple):
    """Something that is varied."""

    question: str
    default: str  # its setting in the run that its variants are compared with
    against: str = "default"  # name of that run


@dataclass(frozen=True)
class Variant:
    """Training run that changes one option of the default run, or learns in another way."""

    name: str  # its folder's
    factor: str  # key of `FACTORS`
    label: str
    options: tuple[str, ...] = ()
    script: str = "student"
    once: bool = False  # whether one seed is enough: what it shows is larger than what seeds differ by


FACTORS = {
    "learner": Factor("Which way of learning?", "student, on adaptive"),
    "sight": Factor("What must PPO be told of the arm?", "belief of the filter", "ppo"),
    "told": Factor("What must a student be told of the arm?", "belief of the filter"),
    "memory": Factor("What is its memory worth?", "GRU of 96"),
    "base": Factor("Which controller should it correct?", "adaptive"),
    "drive": Factor("Which arms should it be trained on?", "with drives as built"),
    "price": Factor("What should changes of the torque cost?", "5 times the task's price"),
}
"""Everything that is varied, by name."""
DEFAULT = Variant("default", "default", "default")
_ALL = ("--residual-limit", "1.0")
VARIANTS = (
    DEFAULT,
    Variant("rma", "learner", "RMA, on adaptive", script="rma", once=True),
    Variant("ppo", "learner", "PPO, on paper", script="ppo"),
    Variant("ppo-nothing", "sight", "nothing", ("--knowledge", "none"), "ppo", once=True),
    Variant("ppo-torsion", "sight", "true torsion, and belief", ("--sensors", "full"), "ppo", once=True),
    Variant("ppo-adaptive", "learner", "PPO, on adaptive", ("--base", "adaptive"), "ppo", once=True),
    Variant("ppo-price-1", "learner", "PPO, on paper, the task's price", ("--torque-price", "1"), "ppo", once=True),
    Variant("sac", "learner", "SAC, on paper", script="sac", once=True),
    Variant("nothing", "told", "nothing", ("--knowledge", "none")),
    Variant("torsion", "told", "true torsion, and belief", ("--sensors", "full")),
    Variant("gru-0", "memory", "none", ("--gru-width", "0")),
    Variant("base-paper", "base", "paper", ("--base", "paper", *_ALL), once=True),
    Variant("ideal", "drive", "with an ideal drive", ("--randomization", "ideal")),
    Variant("price-25", "price", "25 times the task's price", ("--torque-price", "25"), once=True),
)
