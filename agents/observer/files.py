"""Files of learned observers: weights and what they belong to, in one safetensors file; loading executes nothing.

The description in its header (`agents.tensor_file`) has format, version and edition of the arms, the observer's
settings, names of its inputs and quantities with units and scales, a hash of the filter's doubts that it was fitted
with, and how it came about.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch

from agents.observer.network import Observer, offered
from agents.observer.quantities import QUANTITIES
from agents.residual.bases import base_settings, settings_hash
from agents.tensor_file import packed, read_packed
from baselines.tools.command import this_python
from baselines.tools.files import write_atomically
from baselines.tools.schema import in_a_line
from beltarm_env.observation import LAYOUT
from beltarm_env.task.ranges import EDITION

FORMAT = "beltarm-observer"
VERSION = 1
SHIPPED = Path(__file__).resolve().parent / "shipped"
"""Folder of the shipped observers: `belief.safetensors` corrects the filter, `none.safetensors` has none."""


class ObserverError(ValueError):
    """Error about a file of an observer that is missing, damaged, or of another release."""


def _belongs_to(observer: Observer) -> dict[str, Any]:
    """What must be the same here for an observer to be used."""
    return {
        "format": FORMAT,
        "version": VERSION,
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
    write_atomically(path, lambda temporary: temporary.write_bytes(data))


def load_observer(path: Path = SHIPPED / "belief.safetensors") -> tuple[Observer, dict[str, Any]]:
    """Read an observer, and its metadata.

    Raises:
        ObserverError: If it is missing, damaged, or made for another release, observation or filter.
    """
    try:
        content, arrays = read_packed(path, "observer")
        observer = Observer(content["knowledge"], content["width"], content["hold"])
    except FileNotFoundError:
        raise ObserverError(f"no observer at {path}: `{this_python()} train/observer.py` fits one") from None
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise ObserverError(f"{path} is no observer of this release ({in_a_line(error)})") from None
    for name, value in _belongs_to(observer).items():
        if (found := content.get(name)) != value:
            raise ObserverError(f"{path} was made for another {name}, {in_a_line(repr(found), 80)}; fit it again")
    try:
        observer.load_state_dict({name: torch.from_numpy(value) for name, value in arrays.items()})
    except RuntimeError as error:
        raise ObserverError(f"{path} does not hold the weights of its observer: {in_a_line(error)}") from None
    if not all(np.isfinite(value).all() for value in arrays.values()) or not (arrays["deviation"] > 0).all():
        raise ObserverError(f"{path}: the observer has weights that are not finite, or inputs without a scale")
    return observer.requires_grad_(False), content
