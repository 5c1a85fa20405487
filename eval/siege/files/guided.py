"""Damage to files that is guided by coverage: atheris looks for what takes a reader where it has not been yet.

What atheris changes are not the files, most of which would be refused for their first bytes, but the choices of
`eval.siege.files.damage`, in a process of their own whose readers are instrumented.
"""

from __future__ import annotations

import os
import subprocess
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from random import Random

from eval.siege.files.damage import scratch
from eval.siege.report import Siege

INSTRUMENTED = (
    *("agents.policy.bundle", "agents.policy.manifest", "agents.policy.weights", "agents.runs.checkpoint"),
    *("agents.observer.files", "baselines.tools.schema", "baselines.tools.files", "baselines.gains"),
    *("eval.comparison.pairs", "eval.comparison.scenarios", "eval.comparison.schema"),
)
"""Modules whose branches count. Those with kernels cannot be instrumented."""
_LENGTH = 256  # of choices [bytes]
_PATIENCE = 3600  # [s]
_ROOT = Path(__file__).resolve().parents[3]
_FOUND = "found "


class Choices(Random):
    """Random numbers that are read from bytes, and those of a constant seed after their end."""

    def __init__(self, data: bytes) -> None:
        super().__init__(0)
        self._data, self._at = data, 0

    def getrandbits(self, k: int, /) -> int:
        """Take k bits."""
        size = (k + 7) // 8
        taken = self._data[self._at : self._at + size]
        self._at += size
        return int.from_bytes(taken, "little") % 2**k if len(taken) == size else super().getrandbits(k)

    def random(self) -> float:
        """Return a number from 0 up to 1, of one byte: small changes of the bytes are to be small changes of it."""
        return self.getrandbits(8) / 256


def installed() -> bool:
    """Whether atheris is there: the extra `siege` brings it where it runs."""
    return find_spec("atheris") is not None


def add(siege: Siege, name: str, seed: int, inputs: int) -> None:
    """Read files whose damage is guided, in a process of its own; none where atheris is not installed.

    Args:
        siege: Gets the number of inputs, and a line for each that breaks another promise.
        name: Of the reader, see `eval.siege.files.readers.READERS`.
        seed: Of atheris.
        inputs: How many.
    """
    if not installed():
        return
    code = f"from {__name__} import look; look({name!r}, {seed % 2**31 + 1}, {inputs})"
    command = [sys.executable, "-c", code]
    with scratch() as folder:  # atheris ends its process without coming back, and leaves all that is there
        done = subprocess.run(
            command,
            cwd=folder,
            env={**os.environ, "PYTHONPATH": str(_ROOT)},
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_PATIENCE,
            check=False,
        )
    siege.count += inputs
    siege.found += [line.removeprefix(_FOUND) for line in done.stdout.splitlines() if line.startswith(_FOUND)]
    if done.returncode:
        told = " ".join(done.stderr[-200:].split())
        siege.found.append(f"python -c '{code}' ends with status {done.returncode}: {told}")


def look(name: str, seed: int, count: int) -> None:
    """Let atheris look for inputs of a reader, and print those that break a promise in a way not seen before.

    Files are made in the current folder, and left there: atheris ends the process.
    """
    atheris = import_module("atheris")  # untyped, and not everywhere
    with atheris.instrument_imports(include=list(INSTRUMENTED)):
        from eval.siege.files.inputs import Target
    known: set[str] = set()
    folder = Path("files").resolve()
    folder.mkdir()
    target = Target(name, folder)

    def read(data: bytes) -> None:
        words = target.broken(Choices(data))
        if words and words not in known:
            known.add(words)
            print(f"{_FOUND}eval.siege.files.inputs.again_by({name!r}, {data.hex()!r}): {words}", flush=True)

    options = (f"-seed={seed}", f"-runs={count}", f"-max_len={_LENGTH}", "-len_control=0")
    atheris.Setup([sys.argv[0], *options], read)
    atheris.Fuzz()
