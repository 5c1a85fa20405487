"""Folders that tasks read, carried with them to machines that do not have them."""

import atexit
import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import mkdtemp


@dataclass(frozen=True)
class Carried:
    """Files of a folder, pickled with tasks that read them on machines that may not have it."""

    folder: Path
    files: tuple[tuple[str, bytes], ...]  # path within the folder, and content

    def here(self) -> Path:
        """Return the folder if it has these files on this machine, or else a copy, for the life of this process."""
        paths = [self.folder / name for name, _ in self.files]
        same = all(path.is_file() for path in paths) and carry(self.folder, paths) == self
        return self.folder if same else _copy(self)


def carry(folder: Path, files: Iterable[Path]) -> Carried:
    """Read the files of a folder.

    Raises:
        OSError: If one cannot be read.
    """
    return Carried(folder, tuple((path.relative_to(folder).as_posix(), path.read_bytes()) for path in files))


@cache
def _copy(carried: Carried) -> Path:
    place = Path(mkdtemp(prefix="beltarm-"))
    atexit.register(shutil.rmtree, place, ignore_errors=True)
    for name, content in carried.files:
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        (place / name).write_bytes(content)
    return place
