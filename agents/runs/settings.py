"""Options of all training scripts; `beltarm_env.task.seeds` says which arms a training seed draws."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import torch

from agents.policy.bundle import POLICY_FILE
from agents.policy.description import NO_SETTINGS, BundleSpec
from agents.residual.bases import base_settings, make_base, settings_hash
from agents.residual.controller import ResidualSettings
from agents.residual.knowledge import Knowledge
from baselines.engines.workplace import WithStorage
from baselines.tools.command import require_bounds
from baselines.tools.options import Groups
from baselines.tools.schema import in_a_line
from beltarm_env.observation import LAYOUT, Sensors
from beltarm_env.task.seeds import MAX_TRAINING_SEED, SEED_SPACING
from beltarm_env.task.shift import MOST_MOVES

if TYPE_CHECKING:
    from agents.runs.training import Learner

MAY_CHANGE = (*NO_SETTINGS, "total_steps", "validation_every", "rounds")
"""Options that may differ when a run is resumed; all others identify the run."""


@dataclass(frozen=True)
class RunConfig(WithStorage):
    """Options of all training scripts; each script adds its algorithm's own."""

    algorithm: ClassVar[str]
    groups: ClassVar[Groups] = {
        "basic": ("out", "base", "total_steps", "rounds", "seed", "seeds", "resume", "overwrite"),
        "algorithm": (),
        "run": ("jobs", "engine", "address", "storage", "validation_every", "validation_arms", "threads", "device"),
    }

    out: Path
    """Folder of the run. With --seeds, each run has its own folder there: seed0, seed1, ..."""
    seed: int = 0
    """Random seed, 0 to 99. It determines arms, moves, weights and exploration."""
    seeds: int = 1
    """Number of runs, with this seed and the next ones. Each run has its own process."""
    base: str = "paper"
    """Controller that the agent corrects: any classical one, or "none" to learn torques from scratch."""
    knowledge: Knowledge = "belief"
    """What the agent sees besides the observation: what the identification believes of the arm ("belief"), or nothing
    ("none")."""
    sensors: Sensors = "encoder"
    """Sensors of the arm. "accelerometer" is read by the filters of `adaptive` and `preview` too. "full" measures the
    true torsion: its results are an upper bound, and do not compare with others."""
    randomization: Literal["train", "ideal"] = "train"
    """Arms for training: from the training ranges ("train"), or the same with an ideal drive ("ideal"). Validation
    always uses the training ranges."""
    moves: int = 1
    """Moves of an episode, in training and validation. With several it is a working shift: parts are carried, friction
    goes on drifting, and motors give before they slip."""
    arms: int = 512
    """Arms simulated at the same time."""
    learning_rate: float = 5e-4
    """Learning rate of the optimiser."""
    hidden: tuple[int, ...] = (64, 64)
    """Widths of the hidden layers of all networks."""
    activation: Literal["relu", "tanh", "elu"] = "relu"
    """Activation function. tanh takes twice as long."""
    residual_limit: float = 1.0
    """Largest residual, as a share of the torque limit."""
    hold: int = 12
    """Samples for which a residual is held. 12 samples are 18 ms, long enough for exploration to move the arm."""
    validation_arms: int = 128
    """Arms in each validation."""
    threads: int = 1
    """Threads of PyTorch. Two take a quarter off the time of a run of PPO that has two cores to itself, and change its
    numbers in their last digits; small networks become slower. Kernels use all cores, or as many threads as
    OMP_NUM_THREADS says, which changes no number."""
    device: str = "cpu"
    """Device of the networks: cpu, cuda, cuda:1, ..."""
    resume: bool = False
    """Continue the run in --out from its last checkpoint."""
    overwrite: bool = False
    """Delete the run in --out and start again."""

    def usual(self) -> dict[str, Any]:
        """Options that stand, on the command line, for those not given, because of one that is; else its defaults."""
        return {}

    def make_learner(self) -> Learner:
        """Make an untrained learner."""
        raise NotImplementedError

    @property
    def length(self) -> int:
        """Agent steps of the whole run."""
        raise NotImplementedError

    @property
    def residual(self) -> ResidualSettings:
        """Settings of the residual."""
        return ResidualSettings(self.residual_limit, self.hold, self.knowledge)

    @property
    def layers(self) -> dict[str, Any]:
        """What the actor has besides hidden layers, as `BundleSpec` names it."""
        return {}

    def learning_rate_left(self, remaining: float) -> float:
        """Linearly decaying learning rate, at a share `remaining` of the run, which a last rollout takes below 0."""
        return self.learning_rate * max(remaining, 0.0)

    def check(self) -> None:
        """Check the options.

        Raises:
            ValueError: Naming the option, its value and what is allowed.
        """
        require_bounds(self, arms=(1, SEED_SPACING), validation_arms=(1, None), threads=(1, None), seeds=(1, None))
        require_bounds(self, moves=(1, MOST_MOVES))
        self.check_engine()
        self.positive("learning_rate")
        if not 0 <= self.seed <= self.seed + self.seeds - 1 <= MAX_TRAINING_SEED:
            raise ValueError(
                f"--seed must lie within 0 and {MAX_TRAINING_SEED}, with --seeds more too, got {self.seed}"
            )
        if (self.out / POLICY_FILE).exists():
            raise ValueError(f"{self.out} is the folder of a policy, not of a run: choose another --out")
        if self.resume and self.overwrite:
            raise ValueError("--resume continues a run and --overwrite deletes it: give only one of them")
        self.residual.check_moves(self.moves)
        make_base(self.base)
        self.spec().shape()
        try:
            torch.empty(0, device=self.device).cpu()
        except (RuntimeError, AssertionError) as error:  # the latter where PyTorch was built without CUDA
            raise ValueError(f"--device {self.device} is not there ({in_a_line(error)}): use --device cpu") from None

    def fill_in(self, **values: Any) -> None:
        """Give values to those of these options that are None, as their defaults follow from other options."""
        for name, value in values.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, value)

    def positive(self, *names: str) -> None:
        """Raise ValueError unless these options are finite and above 0."""
        for name in names:
            if not 0 < getattr(self, name) < math.inf:
                option = name.replace("_", "-")
                raise ValueError(f"--{option} must be finite and above 0, got {getattr(self, name)}")

    def spec(self, **provenance: Any) -> BundleSpec:
        """Specification of the trained policy."""
        parts = self.algorithm, self.base, self.residual, self.hidden, self.activation, self.sensors
        return BundleSpec(*parts, **self.layers, provenance=provenance)

    def identity(self) -> dict[str, Any]:
        """Identity of a run: its options, the gains of its base, and the observation layout."""
        options = {name: value for name, value in asdict(self).items() if name not in MAY_CHANGE}
        return {
            "algorithm": self.algorithm,
            "options": options,
            "base_hash": settings_hash(base_settings(self.base, self.knowledge)),
            "layout": LAYOUT,
            "entries": self.spec().entries(),
        }
