"""Network of a learned observer: a GRU that corrects what a filter believes, and says how far it may be off.

    o      = clip((inputs - mean) / deviation, -5, 5)
    (g, s) = W [o, GRU(o)] + c
    q      = b + e g,    sigma = e exp(s)

with the estimates q of `QUANTITIES`, their standard deviations sigma, the filter's belief b and e, the root mean square
of what b is wrong by in training. Without a filter b is 0, and the network has the measurements alone. It is fitted by
the likelihood of the truth under a normal distribution with these two, so that sigma is as large as the errors are.

A file of an observer (`agents.tensor_file`) has its weights and, in the header, its settings, what it belongs to, and
how it came about.

D. Nix, A. Weigend: Estimating the Mean and Variance of the Target Probability Distribution, ICNN 1994.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import nn

from agents.observer.quantities import BELIEVED, NAMES, QUANTITIES, SCALES
from agents.policy.actor import Standardised
from agents.policy.network import begun
from agents.residual.bases import base_settings, settings_hash
from agents.residual.knowledge import Knowledge, offered
from agents.tensor_file import MAX_BYTES, packed, unpacked
from baselines.tools.command import this_python
from baselines.tools.files import read_regular, write_bytes
from baselines.tools.schema import in_a_line
from beltarm_env.arrays import Flags, Floats, Singles
from beltarm_env.batch import whole
from beltarm_env.observation import LAYOUT
from beltarm_env.task.ranges import EDITION

SHIPPED = Path(__file__).resolve().parent / "shipped"
"""Folder of the shipped observers: `belief.safetensors` corrects the filter, `none.safetensors` has none."""
MAX_WIDTH = 128
_SMALLEST, _LARGEST = -4.0, 2.0  # s


class Estimate(NamedTuple):
    """What an observer estimates, columns as `QUANTITIES`, in their units."""

    mean: Floats  # (n, quantities)
    deviation: Floats  # (n, quantities)


class Observer(Standardised):
    """Learned observer; its inputs are all that an agent observes but the torque that its base is about to give.

    Args:
        knowledge: "belief" to correct that of the filter, "none" to see the measurements alone.
        width: Of the GRU.
        hold: Samples from one of its estimates to the next.

    Raises:
        ValueError: If a value is out of range.
    """

    error: torch.Tensor
    _units: torch.Tensor

    def __init__(self, knowledge: Knowledge = "belief", width: int = 32, hold: int = 4) -> None:
        entries = offered(knowledge)
        columns = [k for k, entry in enumerate(entries) if entry.name != "base_torque"]
        names = [entries[k].name for k in columns]
        super().__init__(len(names))
        self.knowledge: Knowledge = knowledge
        self.width, self.hold = whole("width", width, 1, MAX_WIDTH), whole("hold [samples]", hold, 1, 100)
        self.columns = np.array(columns)
        self._offered = len(entries)
        self._believed = [names.index(name) for name in BELIEVED] if knowledge == "belief" else None
        self.register_buffer("_units", torch.as_tensor(SCALES, dtype=torch.float32), persistent=False)
        self.register_buffer("error", torch.ones(len(NAMES)))
        self.gru = nn.GRU(len(names), width)
        self.heads = nn.Linear(len(names) + width, 2 * len(NAMES))

    def believed(self, inputs: torch.Tensor) -> torch.Tensor:
        """Belief b in the quantities' units, shape (..., quantities), of inputs of shape (..., inputs)."""
        if self._believed is None:
            return torch.zeros(*inputs.shape[:-1], len(NAMES))
        return inputs[..., self._believed] * self._units

    def estimated(self, inputs: torch.Tensor, g: torch.Tensor, s: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Estimates q and their deviations sigma in the quantities' units."""
        return self.believed(inputs) + self.error * g, self.error * s.exp()

    def forward(
        self, inputs: torch.Tensor, memory: torch.Tensor | None = None
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Corrections g and logarithms s, shape (T, n, quantities), and the GRU's memory after T steps of n episodes.

        Inputs have shape (T, n, inputs); the memory is None where episodes begin.
        """
        features = self.standardised(inputs)
        remembered, following = self.gru(features, memory)
        g, s = self.heads(torch.cat([features, remembered], dim=-1)).chunk(2, dim=-1)
        return g, s.clamp(_SMALLEST, _LARGEST), following

    def observe(
        self, seen: Singles, memory: Singles | None = None, episode_start: Flags | None = None
    ) -> tuple[Estimate, Singles]:
        """Estimate from what an agent observes, shape (n, offered); the memory has shape (n, width).

        Args:
            seen: As `agents.residual.knowledge.InformedBase.seen` returns it for an encoder.
            memory: What the last call returned; None at the beginning.
            episode_start: Which rows begin a new episode, shape (n,).

        Raises:
            ValueError: If what is seen has another shape.
        """
        if seen.ndim != 2 or seen.shape[1] != self._offered:
            raise ValueError(f"the observer chooses from {self._offered} entries, got shape {seen.shape}")
        with torch.no_grad():
            inputs = torch.as_tensor(np.ascontiguousarray(seen[:, self.columns]))
            before = torch.as_tensor(begun(memory, episode_start, (len(seen), self.width)))
            g, s, following = self(inputs[None], before[None])
            mean, deviation = self.estimated(inputs, g[0], s[0])
        return Estimate(mean.numpy().astype(np.float64), deviation.numpy().astype(np.float64)), following[0].numpy()


def _belongs_to(observer: Observer) -> dict[str, Any]:
    """What must be the same here for an observer to be used."""
    return {
        "format": "beltarm-observer",
        "version": 1,
        "layout": LAYOUT,
        "edition": EDITION,
        "entries": [list(entry) for entry in offered(observer.knowledge)],
        "quantities": [list(quantity) for quantity in QUANTITIES],
        "filter": settings_hash(base_settings("none", observer.knowledge)),
    }


def save_observer(path: Path, observer: Observer, provenance: dict[str, Any]) -> None:
    """Write an observer.

    Raises:
        OSError: If it cannot be written; a file of before stays.
    """
    tensors = {name: value.numpy() for name, value in observer.state_dict().items()}
    content = {
        **_belongs_to(observer),
        "knowledge": observer.knowledge,
        "width": observer.width,
        "hold": observer.hold,
        "provenance": provenance,
    }
    data = packed("observer", content, tensors)
    write_bytes(path, data)


def load_observer(path: Path = SHIPPED / "belief.safetensors") -> tuple[Observer, dict[str, Any]]:
    """Read an observer, and its metadata.

    Raises:
        ValueError: If it is missing, damaged, or made for another release, observation or filter.
    """
    try:
        content, arrays = unpacked(read_regular(path, MAX_BYTES), "observer")
        observer = Observer(content["knowledge"], content["width"], content["hold"])
    except FileNotFoundError:
        raise ValueError(f"no observer at {path}: `{this_python()} train/observer.py` fits one") from None
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} is no observer of this release ({in_a_line(error)})") from None
    for name, value in _belongs_to(observer).items():
        if (found := content.get(name)) != value:
            raise ValueError(f"{path} was made for another {name}, {in_a_line(repr(found), 80)}; fit it again")
    try:
        observer.load_state_dict({name: torch.from_numpy(value) for name, value in arrays.items()})
    except RuntimeError as error:
        raise ValueError(f"{path} does not hold the weights of its observer: {in_a_line(error)}") from None
    if not all(np.isfinite(value).all() for value in arrays.values()) or not (arrays["deviation"] > 0).all():
        raise ValueError(f"{path}: the observer has weights that are not finite, or inputs without a scale")
    return observer.requires_grad_(False), content
