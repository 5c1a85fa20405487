"""Tensors with a description in one safetensors file: numbers and text, and loading it executes nothing.

The description is JSON, in the metadata of the file's header. Its entry "sha256" is the SHA-256 of the rest of it and
of the tensors. safetensors alone was not enough: it checks that shapes fit the bytes, but not that these are the bytes
that were saved, and it reads metadata only from a path, at which there may by then be another file, or a pipe.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from baselines.tools.schema import in_a_line, parse

MAX_BYTES = 1_000_000
"""Of a file; larger ones are neither written nor read."""


def packed(kind: str, description: Mapping[str, Any], tensors: Mapping[str, np.ndarray]) -> bytes:
    """Content of a file, whose metadata have the description, as JSON, by the name of its kind, such as "policy".

    Raises:
        ValueError: If the description is not JSON, or the file would have more than `MAX_BYTES`.
    """
    arrays = {name: np.ascontiguousarray(tensor) for name, tensor in tensors.items()}
    text = json.dumps({**description, "sha256": digest_of(description, arrays)}, allow_nan=False)
    data = save(arrays, metadata={kind: text})
    if len(data) > MAX_BYTES:
        raise ValueError(f"a {kind} may have at most {MAX_BYTES} bytes, this has {len(data)}: use smaller layers")
    return data


def unpacked(data: bytes, kind: str) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Take the content of a file apart: its description, with its "sha256", and its tensors.

    Raises:
        ValueError: If it is of another kind, or not what was saved.
    """
    try:
        tensors = load(data)
        header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
        description = parse(header["__metadata__"][kind].encode())
        if not isinstance(description, dict):
            raise TypeError("its description is no object")
    except (SafetensorError, AttributeError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"it is no {kind} as safetensors: {type(error).__name__}: {in_a_line(error, 80)}") from None
    if description.get("sha256") != digest_of(description, tensors):
        raise ValueError("it is damaged or was changed: its SHA-256 is not that of its content")
    return description, tensors


def digest_of(description: Mapping[str, Any], tensors: Mapping[str, np.ndarray]) -> str:
    """SHA-256 of a description, but for the entry "sha256" in it, and of tensors."""
    rest = {name: value for name, value in description.items() if name != "sha256"}
    digest = hashlib.sha256(json.dumps(rest, sort_keys=True).encode())
    for name in sorted(tensors):
        digest.update(name.encode() + tensors[name].tobytes())
    return digest.hexdigest()
