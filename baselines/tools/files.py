"""Atomic writing of files, and files that carry their hash."""

from __future__ import annotations

import hashlib
import os
import shutil
import stat
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from glob import escape
from pathlib import Path

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

_MARK = b"sha256:"  # before the hash at the end of a file
_ABANDONED = 3600.0  # age of a temporary file that nobody can be writing any more [s]


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Let `write` fill a temporary file beside `path`, whose folder is created, then rename it to `path`.

    Temporary files of processes that were killed meanwhile are removed by a later call for the same path.

    Raises:
        OSError: If the folder cannot be written to or is full, naming `path`, which is then as it was.
    """
    with errors_about(path):  # which it is to be, not a temporary name
        path.parent.mkdir(parents=True, exist_ok=True)
        prefix = f".{path.stem}-"
        for left in path.parent.glob(f"{escape(prefix)}*{path.suffix}"):
            with suppress(FileNotFoundError):
                if time.time() - left.stat().st_mtime > _ABANDONED:
                    left.unlink()
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=prefix, suffix=path.suffix)
        os.close(handle)
        temporary = Path(name)
        try:
            write(temporary)
            temporary.chmod(0o644)
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)


@contextmanager
def errors_about(path: Path) -> Iterator[None]:
    """Let errors of the system name a file, as those of writing, such as a full disk, do not by themselves."""
    try:
        yield
    except OSError as error:
        if error.errno is None or error.strerror is None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file atomically."""
    write_atomically(path, lambda temporary: temporary.write_bytes(data))


def write_sealed(path: Path, data: bytes) -> None:
    """Write a binary file atomically, with its SHA-256 at its end."""
    write_bytes(path, sealed(data))


def sealed(data: bytes) -> bytes:
    """Content of a file with its SHA-256 at its end."""
    return data + _MARK + hashlib.sha256(data).digest()


def read_sealed(path: Path) -> bytes:
    """Read what `write_sealed` wrote.

    Raises:
        OSError: If it cannot be read.
        ValueError: If it is not what was written.
    """
    whole = read_regular(path)
    data = whole[: -len(sealed(b""))]
    if sealed(data) != whole:
        raise ValueError("it does not end with the SHA-256 of its content: it is damaged, or of an older version")
    return data


def write_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays by name as safetensors, see `write_sealed`."""
    write_sealed(path, save({name: np.ascontiguousarray(array) for name, array in arrays.items()}))


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Read what `write_arrays` wrote; raises the errors of `read_sealed`."""
    try:
        return load(read_sealed(path))
    except SafetensorError as error:
        raise ValueError(f"it does not hold arrays: {error}") from None


def replace_folder(folder: Path, made: Path) -> None:
    """Put a finished folder, of the same file system, in the place of another one, where there is one.

    Raises:
        OSError: If that fails; the other one is then as it was.
    """
    if not folder.exists():
        made.rename(folder)
        return
    replaced = made.with_name(f"{made.name}-replaced")
    folder.rename(replaced)
    try:
        made.rename(folder)
    except BaseException:
        replaced.rename(folder)
        raise
    shutil.rmtree(replaced)


def require_writable(folder: Path) -> None:
    """Create `folder`, and check that files can be written there before any work is done.

    Raises:
        OSError: If not, naming the folder.
    """
    try:
        write_text(folder / ".writable", "")
        (folder / ".writable").unlink(missing_ok=True)  # another command may look, too
    except OSError as error:
        raise OSError(f"cannot write to {folder}: {error.strerror or error}; choose another folder") from None


def read_regular(path: Path, most: int = 1 << 34) -> bytes:
    """Read a file that others may have made: reading a device or a pipe need not come to an end.

    Raises:
        OSError: If it cannot be read, is no regular file, or has more than `most` bytes.
    """
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    with open(handle, "rb") as file:
        found = os.fstat(handle)
        if not stat.S_ISREG(found.st_mode):
            raise OSError(f"{path.name} is no regular file")
        data = file.read(min(found.st_size, most) + 1)  # for which memory is set aside beforehand
    if len(data) > most:
        raise OSError(f"{path.name} has more than {most} bytes")
    return data


def read_text(path: Path) -> str:
    """Read a text file that others may have made, see `read_regular`.

    Raises:
        OSError: If it cannot be read, or is no regular file.
        ValueError: If it is not text.
    """
    return read_regular(path).decode("utf-8")


def sha256_of(path: Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
