"""Files of learned observers: weights and what they belong to, in one safetensors file; loading executes nothing.

Its metadata is one JSON text with format, version and edition of the arms, the observer's settings, names of its inputs
and quantities with units and scales, a hash of the filter's doubts that it was fitted with, how it came about, and a
SHA-256 of all that and of the weights.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load, save

from agents.observer.network import Observer, offered
from agents.observer.quantities import QUANTITIES
from agents.residual.bases import base_settings, settings_hash
from baselines.tools.command import this_python
from baselines.tools.files import read_regular, write_atomically
from baselines.tools.schema import in_a_line, parse
from beltarm_env.observation import LAYOUT
from beltarm_env.task.ranges import EDITION

FORMAT = "beltarm-observer"
VERSION = 1
MAX_BYTES = 1_000_000
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
        ObserverError: If its weights are not finite.
        OSError: If it cannot be written; a file of before stays.
    """
    _require_sound(observer, path)
    tensors = {name: value.contiguous() for name, value in observer.state_dict().items()}
    content = {
        **_belongs_to(observer),
        "knowledge": observer.knowledge,
        "width": observer.width,
        "hold": observer.hold,
        "provenance": provenance,
    }
    content["sha256"] = _digest(content, tensors)
    data = save(tensors, metadata={"observer": json.dumps(content)})
    write_atomically(path, lambda temporary: temporary.write_bytes(data))


def load_observer(path: Path = SHIPPED / "belief.safetensors") -> tuple[Observer, dict[str, Any]]:
    """Read an observer, and its metadata.

    Raises:
        ObserverError: If it is missing, damaged, or made for another release, observation or filter.
    """
    try:
        data = read_regular(path, MAX_BYTES)
        with safe_open(path, "pt") as file:
            content = parse((file.metadata() or {})["observer"].encode())
        tensors = load(data)
        made_for = {name: content[name] for name in ("format", "version", "layout", "edition")}
        observer = Observer(content["knowledge"], content["width"], content["hold"])
        belongs = _belongs_to(observer)
    except FileNotFoundError:
        raise ObserverError(f"no observer at {path}: `{this_python()} train/observer.py` fits one") from None
    except (OSError, KeyError, TypeError, ValueError, SafetensorError) as error:
        raise ObserverError(f"{path} is no observer of this release ({in_a_line(error)})") from None
    for name, value in belongs.items():
        if content.get(name) != value:
            found = f": it has {in_a_line(repr(made_for[name]), 80)}, here is {value!r}" if name in made_for else ""
            raise ObserverError(f"{path} was made for another {name}{found}; fit it again")
    if any(value.dtype != torch.float32 for value in tensors.values()):
        raise ObserverError(f"{path} has weights that are not in single precision; fit it again")
    if content.get("sha256") != _digest(content, tensors):
        raise ObserverError(f"{path} is damaged: it is not what was saved; copy it again")
    try:
        observer.load_state_dict(tensors)
    except RuntimeError as error:
        raise ObserverError(f"{path} does not hold the weights of its observer: {in_a_line(error)}") from None
    _require_sound(observer, path)
    return observer.requires_grad_(False), content


def _require_sound(observer: Observer, path: Path) -> None:
    weights = observer.state_dict()
    if not all(torch.isfinite(value).all() for value in weights.values()) or not (weights["deviation"] > 0).all():
        raise ObserverError(f"{path}: the observer has weights that are not finite, or inputs without a scale")


def _digest(content: dict[str, Any], tensors: dict[str, torch.Tensor]) -> str:
    rest = {name: value for name, value in content.items() if name != "sha256"}
    found = hashlib.sha256(json.dumps(rest, sort_keys=True).encode())
    for name in sorted(tensors):
        found.update(name.encode() + tensors[name].numpy().tobytes())
    return found.hexdigest()
