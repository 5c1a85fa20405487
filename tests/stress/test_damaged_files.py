"""Damaged and hostile files: each is read as what it is, or refused in one line.

A damaged file means what it did unless its hash was made to fit, or it is refused by ValueError, in one line of at most
300 characters, in less than two seconds. Files stay as they are, and nothing is executed.
"""

import time
from pathlib import Path
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples
from trainings import in_memory

from tests.stress import damage
from tests.stress.readers import READERS

LONGEST_MESSAGE = 300
LONGEST = 2.0  # of the processor's time [s]


@pytest.mark.parametrize("name", READERS)
def test_damage_is_refused(name: str):
    with in_memory() as scratch:
        folder = Path(scratch)
        reader = READERS[name](folder)
        sound, meaning = files(folder), reader.read()

        @examples(300)
        @given(st.randoms(use_true_random=True))
        def read(rng: Random) -> None:
            damaged, fits = reader.damaged(rng)
            written = sound | damaged
            restore(folder, written)
            try:
                check(reader.read, None if fits else meaning, scratch)
                left = files(folder)
                assert not (folder / damage.EXECUTED).exists(), "a pickle was executed"
                assert left == written, "files were changed or made"
            finally:
                restore(folder, sound)

        read()


def check(read: damage.Read, meaning: object, folder: str) -> None:
    """Check how a file is read: with this meaning, unless it is None, or refused."""
    began = time.process_time()
    try:
        result = read()
        assert meaning is None or result == meaning, "is accepted with another meaning"
    except ValueError as error:
        message = str(error).replace(folder, "FOLDER")
        assert len(message) <= LONGEST_MESSAGE and message.isprintable(), message
    assert time.process_time() - began < LONGEST


def restore(folder: Path, sound: dict[str, bytes]) -> None:
    for name in files(folder).keys() - sound.keys():
        (folder / name).unlink()
    for name, content in sound.items():
        (folder / name).write_bytes(content)


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
