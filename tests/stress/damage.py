"""Damage to files, by their structure: JSON, archives, arrays and weights."""

from __future__ import annotations

import copy
import io
import json
import math
import os
import pickle
import re
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

Read = Callable[[], object]
_IN_MEMORY = Path("/dev/shm")  # on Linux
EXECUTED = "executed"
"""Name of a folder that only loading a pickle makes."""
_LONG, _DEEP = 100_000, 100_000
_WEIRD: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 3, 2**31, 2**63, -(2**63) - 1, 10**30, 10**400, 0.5, -0.0, 1e-320, 1e308, -1e308),
    *(math.nan, math.inf, -math.inf, "", "0", "nan", "a\nb", "\x1b[31m\x00", "\ud800", "🤖", "../../x", "/etc/passwd"),
    *([], {}, [[]], {"": {}}, [None], {"a": math.nan}, [1, "a", {}], "x" * _LONG, "é\n" * 500, ["a"] * 2000),
)
_NAMES = ("", "x", "a\nb", "\ud800", "__class__", "x" * 1000, "0", "seed\x00", "é", "format")
_NUMBERS = (b"1e999", b"-", b"0x10", b"NaN", b"-Infinity", b"01", b"1" * 5000, b"1e-999", b"1.", b"9" * 400)
_SIZES = (0, 1, 7, 2**16, 2**31 - 1, 2**32 - 1, 2**40, 2**62, 2**63 - 1, 2**64 - 1)


def scratch() -> tempfile.TemporaryDirectory[str]:
    """Make an empty folder for damaged files, in memory if the system has a place there: a disk takes as long again."""
    return tempfile.TemporaryDirectory(dir=_IN_MEMORY if os.access(_IN_MEMORY, os.W_OK) else None)


class Exploit:
    """Its pickle, loaded, makes a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __reduce__(self) -> Any:
        """What a loaded pickle does."""
        return os.mkdir, (str(self.folder / EXECUTED),)


def exploit(folder: Path) -> bytes:
    """Pickle that makes a folder as it is loaded."""
    return pickle.dumps(Exploit(folder))


def damaged_content(rng: Random, content: Any) -> Any:
    """JSON content with one to three changes at random places."""
    content = copy.deepcopy(content)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        places = list(_places(content))
        if places:
            _change(rng, content, *rng.choice(places), places)
    return content


def _places(content: Any) -> list[tuple[Any, Any]]:
    """Containers and keys of all that is in JSON content."""
    places, waiting = [], [content]
    while waiting:
        inside = waiting.pop()
        keys = list(inside) if isinstance(inside, dict) else range(len(inside)) if isinstance(inside, list) else ()
        for key in keys[:50]:
            places.append((inside, key))
            if isinstance(inside[key], dict | list):
                waiting.append(inside[key])
    return places


def _change(rng: Random, content: Any, inside: Any, key: Any, places: list[tuple[Any, Any]]) -> None:
    value = inside[key]
    match rng.randrange(8):
        case 0 | 1:
            inside[key] = copy.deepcopy(rng.choice(_WEIRD))
        case 2:
            del inside[key]
        case 3:
            if isinstance(inside, dict):
                inside[rng.choice(_NAMES)] = copy.deepcopy(rng.choice(_WEIRD))
            else:
                inside.insert(key, copy.deepcopy(rng.choice(_WEIRD)))
        case 4:
            inside[key] = rng.choice(([value], {"a": value}, str(value)[:_LONG], [value, value], repr(value)[:_LONG]))
        case 5:
            other, its = rng.choice(places)
            inside[key] = copy.deepcopy(other[its])
        case 6:
            nested: Any = value
            for _ in range(rng.choice((3, 30, 150))):
                nested = [nested] if rng.random() < 0.5 else {"a": nested}
            inside[key] = nested
        case _:
            number = isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300
            inside[key] = rng.choice((-value, value + 1, value * 1e6, float(value), value / 3)) if number else -1


def damaged_text(rng: Random, text: bytes, folder: Path) -> bytes:
    """Text of JSON that is damaged as a text."""
    match rng.randrange(8):
        case 0:
            return text.decode().encode(rng.choice(("utf-16", "utf-32", "utf-8-sig")))
        case 1:
            return rng.choice((b"[", b'{"a":', b'[{"":')) * _DEEP
        case 2:
            return text.replace(b"{", b'{"format": ' + rng.choice((b"1", b'"x"', b"{}")) + b", ", 1)  # a key twice
        case 3:
            digits = [k for k, byte in enumerate(text[:20_000]) if 48 <= byte <= 57] or [0]
            at = rng.choice(digits)
            return text[:at] + rng.choice(_NUMBERS) + text[at + 1 :]
        case 4:
            return exploit(folder)
        case 5:
            at = rng.randrange(len(text))
            return text[:at] + rng.choice((b"\xff", b"\x00", b"\n", b'"', b"}", b",", b"\xed\xa0\x80")) + text[at:]
        case _:
            return damaged_bytes(rng, text, folder)


def damaged_bytes(rng: Random, data: bytes, folder: Path) -> bytes:
    """File with some other bytes, fewer, or more."""
    changed, at = bytearray(data), rng.randrange(max(1, len(data)))
    match rng.randrange(8):
        case 0 | 1 | 2:
            for _ in range(rng.choice((1, 1, 2, 8))):
                changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
        case 3:
            del changed[at:]
        case 4:
            del changed[at : at + rng.choice((1, 8, 100))]
        case 5:
            changed[at:at] = rng.randbytes(rng.choice((1, 8, 100)))
        case 6:
            at = rng.choice((0, at, max(0, len(changed) - 22)))
            changed[at : at + 8] = rng.choice(_SIZES).to_bytes(8, "little")
        case _:
            return rng.choice((b"", exploit(folder), bytes(len(data)), rng.randbytes(len(data)), data + data))
    return bytes(changed)


def damaged_weights(rng: Random, data: bytes, folder: Path) -> bytes:
    """Safetensors whose header, or any part, is damaged."""
    if rng.random() < 0.4:
        return damaged_bytes(rng, data, folder)
    size = int.from_bytes(data[:8], "little")
    header = json.dumps(damaged_content(rng, json.loads(data[8 : 8 + size]))).encode()
    if rng.random() < 0.2:
        header = damaged_text(rng, header, folder)
    length = rng.choice(_SIZES) if rng.random() < 0.1 else len(header)
    return length.to_bytes(8, "little") + header + data[8 + size :]


def damaged_archive(
    rng: Random, data: bytes, folder: Path, member: Callable[[Random, bytes, Path], bytes]
) -> tuple[bytes, bool]:
    """ZIP in which any byte is damaged, or a file; and whether its checksums fit.

    Args:
        rng: Draws the damage.
        data: The archive.
        folder: See `exploit`.
        member: Damages a file in it.
    """
    if rng.random() < 0.5:
        return damaged_bytes(rng, data, folder), False
    buffer = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as sound, zipfile.ZipFile(buffer, "w") as archive:
        names = sound.namelist()
        chosen, way = rng.choice(names), rng.randrange(6)
        for name in names:
            content = sound.read(name)
            if name == chosen:
                if way == 0:
                    continue
                content = member(rng, content, folder) if way > 1 else content
                name = rng.choice((*_NAMES[1:3], "../x", "/x", f"{name}/", name.upper())) if way == 1 else name
            archive.writestr(name, content, rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2)))
    return buffer.getvalue(), True


def damaged_array(rng: Random, data: bytes, folder: Path) -> bytes:
    """File of an array (npy) with another header, other numbers, or objects."""
    array: Any = np.load(io.BytesIO(data))
    match rng.randrange(6):
        case 0:
            kind = rng.choice(("<i8", "<f4", "<c16", "|b1", "<U3", "|S8", "<M8[s]", "|V8", ">f8", "<f8, <i4"))
            array = np.zeros(array.shape, kind)
        case 1:
            array = np.array([Exploit(folder)] * array.size, dtype=object)
        case 2:
            array = array.reshape(rng.choice((-1, (1, *array.shape), (*array.shape, 1))))
        case 3:
            array = np.where(np.arange(array.size).reshape(array.shape) == 0, rng.choice((math.nan, math.inf)), array)
        case 4:
            shape = rng.choice(("(10,)", "(-1,)", "(1000000000000,)", "(2**40,)", "(1, 4, 'a')", "[" * 500, "((1,),)"))
            return re.sub(rb"'shape': \([^)]*\)", f"'shape': {shape}".encode(), data)  # in a header of another length
        case _:
            return damaged_bytes(rng, data, folder)
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=True)
    return buffer.getvalue()
