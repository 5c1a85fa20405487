"""Weights of a policy's network: its layers, and their numbers as plain arrays.

    o <- clip((o - mean) / deviation, -5, 5)  if it is standardised
    z = o, LSTM(o) or [o, GRU(o)]
    u = W_n act(... act(W_1 z + b_1) ...) + b_n    residual = tanh(u) or clip(u, -1, 1)

This is all that a bundle holds and all that a policy needs to act: no critics, and nothing of what it was trained with,
not even PyTorch, whose names the arrays have.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from beltarm_env.arrays import Singles
from beltarm_env.batch import whole

ACTIVATIONS = ("tanh", "relu", "elu")
MAX_WIDTH = 1024
MAX_LAYERS = 8
FARTHEST = 5.0
"""Bound of a standardised input, in deviations."""


@dataclass(frozen=True, slots=True)
class ActorShape:
    """Layers of an actor.

    Raises:
        ValueError: If a layer is not of a size that is allowed.
    """

    inputs: int
    hidden: tuple[int, ...]  # width of the hidden layers
    activation: str = "tanh"
    squashed: bool = False  # tanh at the end instead of a cut
    lstm: int = 0  # width of an LSTM before the first layer, 0 for none
    gru: int = 0  # width of a GRU beside the inputs of the first layer, 0 for none
    standardised: bool = False  # whether inputs are, by the mean and deviation that they had in training

    def __post_init__(self) -> None:
        """Check the sizes before memory is allocated."""
        if len(self.hidden) > MAX_LAYERS:
            raise ValueError(f"an actor has at most {MAX_LAYERS} hidden layers, got {len(self.hidden)}")
        for width in self.hidden:
            whole("the width of hidden layers", width, 1, MAX_WIDTH)
        whole("the width of the LSTM", self.lstm, 0, MAX_WIDTH)
        whole("the width of the GRU", self.gru, 0, MAX_WIDTH)
        if self.lstm and self.gru:
            raise ValueError(f"an actor has an LSTM or a GRU, got both, of {self.lstm} and {self.gru}")
        if self.activation not in ACTIVATIONS:
            raise ValueError(f"activation must be one of {', '.join(ACTIVATIONS)}, got {self.activation!r}")

    @property
    def recurrent(self) -> str:
        """Name of the recurrent layer, empty for none."""
        return "lstm" if self.lstm else "gru" if self.gru else ""

    @property
    def memory_width(self) -> int:
        """Width of the recurrent layer, 0 for none."""
        return self.lstm or self.gru

    @property
    def gates(self) -> int:
        """Width of its gates side by side, 0 for none."""
        return 4 * self.lstm or 3 * self.gru

    @property
    def memory(self) -> tuple[int, ...]:
        """Shape of what it remembers of an arm: of an LSTM hidden and cell state."""
        return (2, self.lstm) if self.lstm else (self.gru,)

    @property
    def widths(self) -> tuple[int, ...]:
        """Widths of what the layers after the recurrent one take and give, from the first input on."""
        return (self.lstm or self.inputs + self.gru, *self.hidden, 1)

    def arrays(self) -> dict[str, tuple[int, ...]]:
        """Names of the arrays, and their shapes: of matrices, outputs first."""
        shapes: dict[str, tuple[int, ...]] = {}
        if self.standardised:
            shapes |= {"mean": (self.inputs,), "deviation": (self.inputs,)}
        if self.recurrent:
            for kind, inputs in (("ih", self.inputs), ("hh", self.memory_width)):
                shapes |= {f"{self.recurrent}.weight_{kind}_l0": (self.gates, inputs)}
                shapes |= {f"{self.recurrent}.bias_{kind}_l0": (self.gates,)}
        for k, (before, after) in enumerate(pairwise(self.widths)):
            shapes |= {f"layers.{2 * k}.weight": (after, before), f"layers.{2 * k}.bias": (after,)}
        return shapes


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """Layers of an actor with their numbers.

    Raises:
        ValueError: If an array is missing, there is one too many, or one has another shape or type, or numbers that are
            not finite.
    """

    shape: ActorShape
    arrays: dict[str, Singles]

    def __post_init__(self) -> None:
        """Check that these are the arrays of the layers."""
        wanted = self.shape.arrays()
        for name in (*wanted, *self.arrays):
            if name not in self.arrays:
                raise ValueError(f"there is no array {name!r}")
            if name not in wanted:
                raise ValueError(f"there is an array {name!r}, of no layer")
            kind, shape = self.arrays[name].dtype, self.arrays[name].shape
            if shape != wanted[name] or kind != np.float32:
                raise ValueError(f"{name} is {kind} of shape {shape}, and must be float32 of shape {wanted[name]}")
            if not np.isfinite(self.arrays[name]).all():
                raise ValueError(f"{name} has numbers that are not finite")

    def recurrent(self) -> list[tuple[Singles, Singles]]:
        """Matrices and biases of the recurrent layer, on its inputs and on what it remembers; empty for none."""
        kinds, name = ("ih", "hh") if self.shape.recurrent else (), self.shape.recurrent
        return [(self.arrays[f"{name}.weight_{kind}_l0"], self.arrays[f"{name}.bias_{kind}_l0"]) for kind in kinds]

    def layers(self) -> list[tuple[Singles, Singles]]:
        """Matrices and biases of the layers after it."""
        places = range(0, 2 * len(self.shape.widths) - 2, 2)
        return [(self.arrays[f"layers.{k}.weight"], self.arrays[f"layers.{k}.bias"]) for k in places]
