"""Archives of submissions: a ZIP of plain files, whose bytes depend on its content alone.

An archive comes from a stranger. It is read into memory, where no name leads anywhere, and nothing of it is executed;
it is unpacked only after all its names were found to stay within a folder.
"""

from __future__ import annotations

import io
import re
import stat
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path, PurePosixPath

from baselines.tools.files import read_regular
from baselines.tools.schema import in_a_line

MAX_FILES, MAX_BYTES = 200, 10_000_000
"""Of an archive; its files are counted as they are unpacked."""
_PART = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.+-]{0,99}")  # of a path: neither "..", nor hidden, nor with a separator
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the first time that a ZIP file can hold
_UNSOUND = (OSError, EOFError, IndexError, RuntimeError, NotImplementedError, zipfile.BadZipFile, zlib.error)


def require_plain(names: list[str], where: str) -> None:
    """Check names of files, so that they can be written below any folder, on any system, without leaving it.

    Raises:
        ValueError: Naming the first that is absolute, leads upwards, is hidden, has unusual characters or stands there
            twice, or if there are too many.
    """
    if len(names) > MAX_FILES:
        raise ValueError(
            f"{where} has {len(names)} files, at most {MAX_FILES} are allowed: leave out what is not needed"
        )
    seen: set[str] = set()
    for name in names:
        if not all(_PART.fullmatch(part) for part in name.split("/")):
            raise ValueError(
                f"{where} has a file {name[:100]!r}: its path may have letters, digits, '_', '-', '+' and '.' alone, "
                "no '..' and nothing hidden; rename it"
            )
        if name.lower() in seen:
            raise ValueError(f"{where} has the file {name!r} twice, or in capitals too: rename it")
        seen.add(name.lower())
    if inside := next((name for name in names if {*map(str, PurePosixPath(name.lower()).parents)} & seen), None):
        raise ValueError(f"{where} has the file {inside!r} inside another file: rename it")


def require_size(total: int, where: str) -> None:
    """Check the size of all files.

    Raises:
        ValueError: If it is too large.
    """
    if total > MAX_BYTES:
        raise ValueError(f"{where} has {total} bytes, at most {MAX_BYTES} are allowed: leave out what is not needed")


def archived(files: Mapping[str, bytes], where: str) -> bytes:
    """Archive of files; the same files give the same bytes.

    Raises:
        ValueError: If names or sizes are not allowed.
    """
    require_plain(list(files), where)
    require_size(sum(map(len, files.values())), where)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name in sorted(files):
            member = zipfile.ZipInfo(name, _EPOCH)
            member.create_system, member.external_attr = 3, (stat.S_IFREG | 0o644) << 16  # as on Unix, anywhere
            archive.writestr(member, files[name], zipfile.ZIP_DEFLATED, 9)
    return buffer.getvalue()


def read_archive(path: Path) -> dict[str, bytes]:
    """Read an archive's files by name.

    Raises:
        ValueError: If it cannot be read, or holds anything but plain files of allowed names and size.
    """
    try:
        require_size(path.stat().st_size, path.name)
        with zipfile.ZipFile(io.BytesIO(read_regular(path, MAX_BYTES))) as archive:
            members = archive.infolist()
            for member in members:
                _require_regular(member, path.name)
            require_plain([member.filename for member in members], path.name)
            require_size(sum(member.file_size for member in members), path.name)
            return {member.filename: archive.read(member) for member in members}
    except _UNSOUND as error:
        words = in_a_line(error)
        raise ValueError(f"{path} cannot be read ({words}): a submission is a ZIP file of eval/submit.py") from None


def _require_regular(member: zipfile.ZipInfo, where: str) -> None:
    kind = stat.S_IFMT(member.external_attr >> 16)
    if member.is_dir() or kind not in (0, stat.S_IFREG) or member.filename != member.orig_filename:
        raise ValueError(f"{where} has {member.orig_filename[:100]!r}, which is no regular file: pack it again")


def extract(files: Mapping[str, bytes], folder: Path) -> None:
    """Write files that were read below an empty folder."""
    require_plain(list(files), str(folder))
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
