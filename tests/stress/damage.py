"""Damage to files, by their structure: JSON, archives, arrays and weights."""

import copy
import json
import math
import pickle
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

from bundles import Exploit

Read = Callable[[], object]
EXECUTED = "executed"
"""Name of a file that only loading a pickle makes."""
_LONG, _DEEP = 100_000, 100_000
_WEIRD: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 3, 2**31, 2**63, -(2**63) - 1, 10**30, 10**400, 0.5, -0.0, 1e-320, 1e308, -1e308),
    *(math.nan, math.inf, -math.inf, "", "0", "nan", "a\nb", "\x1b[31m\x00", "\ud800", "🤖", "../../x", "/etc/passwd"),
    *([], {}, [[]], {"": {}}, [None], {"a": math.nan}, [1, "a", {}], "x" * _LONG, "é\n" * 500, ["a"] * 2000),
)
_NAMES = ("", "x", "a\nb", "\ud800", "__class__", "x" * 1000, "0", "seed\x00", "é", "format")
_NUMBERS = (b"1e999", b"-", b"0x10", b"NaN", b"-Infinity", b"01", b"1" * 5000, b"1e-999", b"1.", b"9" * 400)
_SIZES = (0, 1, 7, 2**16, 2**31 - 1, 2**32 - 1, 2**40, 2**62, 2**63 - 1, 2**64 - 1)


def damaged_content(rng: Random, content: Any) -> Any:
    content = copy.deepcopy(content)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        places = list(_places(content))
        if places:
            _change(rng, *rng.choice(places), places)
    return content


def _places(content: Any) -> list[tuple[Any, Any]]:
    places, waiting = [], [content]
    while waiting:
        inside = waiting.pop()
        keys = list(inside) if isinstance(inside, dict) else range(len(inside)) if isinstance(inside, list) else ()
        for key in keys[:50]:
            places.append((inside, key))
            if isinstance(inside[key], dict | list):
                waiting.append(inside[key])
    return places


def _change(rng: Random, inside: Any, key: Any, places: list[tuple[Any, Any]]) -> None:
    value, weird = inside[key], copy.deepcopy(rng.choice(_WEIRD))
    match rng.randrange(8):
        case 0 | 1:
            inside[key] = weird
        case 2:
            del inside[key]
        case 3 if isinstance(inside, dict):
            inside[rng.choice(_NAMES)] = weird
        case 3:
            inside.insert(key, weird)
        case 4:
            inside[key] = rng.choice(([value], {"a": value}, [value, value], repr(value)[:_LONG]))
        case 5:
            other, its = rng.choice(places)
            inside[key] = copy.deepcopy(other[its])
        case 6:
            for _ in range(rng.choice((3, 30, 150))):
                value = [value]
            inside[key] = value
        case _:
            number = isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300
            inside[key] = rng.choice((-value, value + 1, value * 1e6, float(value), value / 3)) if number else -1


def damaged_text(rng: Random, text: bytes, folder: Path) -> bytes:
    at = rng.choice([k for k, byte in enumerate(text[:20_000]) if 48 <= byte <= 57] or [0])
    match rng.randrange(6):
        case 0:
            return text.decode().encode(rng.choice(("utf-16", "utf-32", "utf-8-sig")))
        case 1:
            return rng.choice((b"[", b'{"a":', b'[{"":')) * _DEEP
        case 2:
            return text.replace(b"{", b'{"format": ' + rng.choice((b"1", b'"x"', b"{}")) + b", ", 1)  # a key twice
        case 3:
            return text[:at] + rng.choice(_NUMBERS) + text[at + 1 :]
        case 4:
            return text[:at] + rng.choice((b"\xff", b"\x00", b"\n", b'"', b"}", b",", b"\xed\xa0\x80")) + text[at:]
        case _:
            return damaged_bytes(rng, text, folder)


def damaged_bytes(rng: Random, data: bytes, folder: Path) -> bytes:
    """File with some other bytes, fewer, or more; or another file, such as a pickle that is run where it is read."""
    changed, at = bytearray(data), rng.randrange(max(1, len(data)))
    match rng.randrange(6):
        case 0 | 1:
            for _ in range(rng.choice((1, 1, 2, 8))):
                changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
        case 2:
            del changed[at : rng.choice((at + 1, at + 100, len(changed)))]
        case 3:
            changed[at:at] = rng.randbytes(rng.choice((1, 8, 100)))
        case 4:
            at = rng.choice((0, at, max(0, len(changed) - 22)))
            changed[at : at + 8] = rng.choice(_SIZES).to_bytes(8, "little")
        case _:
            exploit = pickle.dumps(Exploit(folder / EXECUTED))
            return rng.choice((b"", exploit, bytes(len(data)), rng.randbytes(len(data)), data + data))
    return bytes(changed)


def damaged_weights(rng: Random, data: bytes, folder: Path) -> bytes:
    if rng.random() < 0.4:
        return damaged_bytes(rng, data, folder)
    size = int.from_bytes(data[:8], "little")
    header = json.dumps(damaged_content(rng, json.loads(data[8 : 8 + size]))).encode()
    if rng.random() < 0.2:
        header = damaged_text(rng, header, folder)
    length = rng.choice(_SIZES) if rng.random() < 0.1 else len(header)
    return length.to_bytes(8, "little") + header + data[8 + size :]
