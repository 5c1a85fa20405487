"""Damaged and hostile files for what reads them: each is taken for what it is, or refused in one line.

`again` and `again_by` read one of the inputs once more.
"""

from __future__ import annotations

import time
from pathlib import Path
from random import Random

from eval.siege.files import damage, guided
from eval.siege.files.readers import READERS, Reader
from eval.siege.report import Siege

INPUTS, GUIDED = 980_000, 20_000
"""Of a whole siege: drawn at random, and guided by the coverage that they reach."""
_LONGEST_MESSAGE = 300
_LONGEST = 2.0  # that an input may take of the processor's time [s]


def besiege(share: float, seed: int) -> Siege:
    """Read files that are not as they should be.

    A file is accepted, and means what it did unless its hash was made to fit, or it is refused by the error that is
    documented, in one line of at most 300 characters, in less than two seconds. Files stay as they are, and nothing is
    executed.

    Args:
        share: Of a whole siege.
        seed: Of all damage.
    """
    blind = "inputs that never come to an end, and what a learner makes of a damaged checkpoint whose hash fits"
    blind += "" if guided.installed() else "; and, for want of atheris, what coverage would have led to"
    siege = Siege("inputs", "inputs", blind)
    for name in READERS:
        with damage.scratch() as folder:
            target = Target(name, Path(folder))
            for number in range(round(share * INPUTS / len(READERS)) + 1):
                siege.count += 1
                if words := target.broken(_drawn(name, seed, number)):
                    siege.found.append(f"eval.siege.files.inputs.again({name!r}, {seed}, {number}): {words}")
        guided.add(siege, name, seed, round(share * GUIDED / len(READERS)) + 1)
    return siege


def again(name: str, seed: int, number: int) -> str:
    """Read one input of a siege again: words for what is wrong, empty if nothing is.

    Args:
        name: Of what reads it, see `READERS`.
        seed: Of the siege.
        number: Of the input.
    """
    with damage.scratch() as folder:
        return Target(name, Path(folder)).broken(_drawn(name, seed, number))


def again_by(name: str, choices: str) -> str:
    """Read one guided input again, see `again`, by its choices in hexadecimal digits."""
    with damage.scratch() as folder:
        return Target(name, Path(folder)).broken(guided.Choices(bytes.fromhex(choices)))


def _drawn(name: str, seed: int, number: int) -> Random:
    return Random(f"{seed}/{name}/{number}")


class Target:
    """Something that reads files, with sound ones.

    Args:
        name: Of the reader.
        folder: Empty one for its files.
    """

    def __init__(self, name: str, folder: Path) -> None:
        self._reader, self._folder = READERS[name](folder), folder
        self._sound, self._meaning = _files(folder), self._reader.read()

    def broken(self, rng: Random) -> str:
        """Read files with damage that is drawn: words for what is wrong, empty if nothing is."""
        reader, folder, sound = self._reader, self._folder, self._sound
        files, fits = reader.damaged(rng)
        given = sound | files
        for path, content in given.items():
            (folder / path).write_bytes(content)
        wrong = _misread(reader, self._meaning, fits, str(folder)), _changed(folder, given, reader.removes)
        _restore(folder, sound)
        return ", and ".join(filter(None, wrong))


def _misread(reader: Reader, meaning: object, fits: bool, folder: str) -> str:
    """Words for what is wrong with how files are read; empty if nothing is."""
    began = time.process_time()
    try:
        found = reader.read()
        words = "" if fits or found is None or found == meaning else "is accepted with another meaning"
    except ValueError as error:
        message = str(error).replace(folder, "FOLDER")
        words = "" if len(message) <= _LONGEST_MESSAGE else f"a message of {len(message)} characters: {message[:200]!r}"
        words = words or ("" if message.isprintable() else f"a message that is no line: {message!r}")
    except Exception as error:
        words = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
    took = time.process_time() - began
    return words or (f"takes {took:.1f} s" if took > _LONGEST else "")


def _changed(folder: Path, given: dict[str, bytes], removes: bool) -> str:
    """Words for files that were changed, made or, unless that is meant, removed; empty if none were."""
    found = _files(folder)
    if (folder / damage.EXECUTED).exists():
        return "a pickle was executed"
    if made := sorted(found.keys() - given.keys()):
        return f"leaves {', '.join(made)}"
    changed = [name for name, content in given.items() if found.get(name, content if removes else None) != content]
    return f"changes {', '.join(changed)}" if changed else ""


def _restore(folder: Path, sound: dict[str, bytes]) -> None:
    """Make the files of a folder sound again, and remove others."""
    found = _files(folder)
    for name in found.keys() - sound.keys():
        (folder / name).unlink()
    if (folder / damage.EXECUTED).is_dir():
        (folder / damage.EXECUTED).rmdir()
    for name, content in sound.items():
        if found.get(name) != content:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)


def _files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
