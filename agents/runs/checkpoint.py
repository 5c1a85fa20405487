"""Folder of a run, and checkpoints from which it resumes bit for bit.

    config.json       every option, with which a resumed run goes on where it is told no others, what makes the run this
                      one, and the software that writes it
    checkpoint.pkl    everything that the next step depends on: the learner (its networks, optimisers, arms, memories
                      and data), random generators, the run's progress, and the software
                      that wrote it; a SHA-256 of all that stands at its end
    validation.csv    the learning curve
    best/, last/      policy bundles: lowest validation cost, and end of the run
    progress*.csv, events*   training log, as CSV and for TensorBoard
    .lock             locked as long as a run works in the folder, by the system: a process that is killed leaves none

A checkpoint is a pickle: loading it executes what it says. It is for the machine that wrote it; what is passed on to
others are bundles (`agents.policy.bundle`), which hold numbers alone.
"""

from __future__ import annotations

import json
import pickle
import random
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import torch
from filelock import FileLock, Timeout

from agents.runs.settings import RunConfig
from baselines.tools.files import Unsealed, read_sealed, read_text, require_writable, write_sealed, write_text
from baselines.tools.provenance import software
from baselines.tools.resuming import note_options
from baselines.tools.schema import in_a_line, loads

VERSION = 4
"""Format of checkpoints; raise it where a learner's snapshot changes, or a module whose classes are in it moves."""
CHECKPOINT, CONFIG = Path("checkpoint.pkl"), Path("config.json")
"""Within the folder of a run."""
_WRITTEN = ("config", "checkpoint", "validation", "policy", "weights", "README")
"""Beginnings of the names of files that a run writes."""
_PACKAGES = ("numpy", "torch", "stable-baselines3", "sb3-contrib")


def written_by() -> dict[str, Any]:
    """Versions of the software of this process, noted in what it writes."""
    return software(*_PACKAGES)


class RunFolder:
    """Files of one run."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.config = folder / CONFIG
        self.checkpoint = folder / CHECKPOINT
        self.curve = folder / "validation.csv"
        self.best = folder / "best"
        self.last = folder / "last"
        self._software = written_by()
        self._lock = FileLock(folder / ".lock", timeout=0)

    def begin(self, config: RunConfig) -> None:
        """Prepare the folder, which is locked, for a new run or for resuming the one that it holds.

        Raises:
            FileNotFoundError: If there is nothing to resume.
            ValueError: If it holds a run that is neither to be resumed nor to be overwritten, or another run.
            OSError: If it cannot be written.
        """
        self.check(config)
        if config.overwrite:
            self.delete_run()
        half_written = [*self.folder.glob(".*-*")]  # by a process that was killed
        half_written += [path for folder in (self.best, self.last) for path in folder.glob(".*-*")]
        for path in half_written:
            if path.name.lstrip(".").split("-")[0] in _WRITTEN:
                path.unlink(missing_ok=True)

    @contextmanager
    def locked(self, config: RunConfig) -> Iterator[None]:
        """Lock the folder, if its run may begin or go on.

        Raises:
            ValueError: As `begin` does, or if another run is under way there.
            OSError: If the folder cannot be written.
        """
        self.check(config)
        require_writable(self.folder)
        try:
            with self._lock:
                yield
        except Timeout:
            raise ValueError(f"another run works in {self.folder}: wait for its end, or choose another --out") from None

    def note(self, config: RunConfig, progress: dict[str, Any] | None = None) -> None:
        """Write config.json; when resuming, only after the checkpoint has been read.

        Args:
            config: Options.
            progress: Of the run that is resumed. Its learning curve is written too: a process that was killed may have
                left that of the checkpoint before.
        """
        note_options(self.config, config, identity=config.identity(), written_by=self._software)
        if progress is not None:
            self._write_curve(progress)

    def check(self, config: RunConfig) -> None:
        """Check that the folder is free, holds the run to resume, or may be overwritten; raises as `begin`."""
        if config.resume:
            self._require_same(config)
        elif config.overwrite and self.best.exists() and not self.config.exists():
            raise ValueError(f"{self.folder} is not the folder of a run, so nothing is deleted: choose another --out")
        elif not config.overwrite and self._holds_a_run():
            raise ValueError(
                f"{self.folder} already holds a run: continue it with --resume, delete it with "
                "--overwrite, or choose another --out"
            )

    def _holds_a_run(self) -> bool:
        """Whether there is something to lose; not where a run was killed before its first checkpoint."""
        only_begun = self.config.exists() and not self.curve.exists()
        return any(path.exists() for path in (self.checkpoint, self.last, *([] if only_begun else [self.best])))

    def _require_same(self, config: RunConfig) -> None:
        if not self.config.exists():
            raise FileNotFoundError(f"nothing to resume in {self.folder}: run once without --resume")
        if not self.checkpoint.exists() and self._holds_a_run():
            raise FileNotFoundError(f"{self.folder} has no {CHECKPOINT} to go on from: choose another --out")
        try:
            content = loads(read_text(self.config))
            before, options = content["identity"], dict(content["identity"]["options"])
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{self.config} is damaged ({in_a_line(repr(error))}): choose another --out") from None
        now = json.loads(json.dumps(config.identity(), default=str))
        if before.get("algorithm") != now["algorithm"]:
            known = in_a_line(before.get("algorithm"), 80)
            raise ValueError(
                f"the run in {self.folder} is of {known}, not of {now['algorithm']}: take its script, or another --out"
            )
        for name, value in now["options"].items():
            if options.get(name) != value:
                option = f"--{name.replace('_', '-')}"
                remedy = "give the same options, or choose another --out"
                known = in_a_line(options.get(name), 80)
                raise ValueError(f"the run in {self.folder} has {option} {known}, not {value}: {remedy}")
        for name in ("base_hash", "layout", "entries"):
            if before.get(name) != now[name]:
                known = "other gains of the base" if name == "base_hash" else "another observation layout"
                remedy = _remedy(content.get("written_by"))
                raise ValueError(f"the run in {self.folder} began with {known}: {remedy}")

    def delete_run(self) -> None:
        """Delete the files that runs write, and nothing else."""
        for folder in (self.best, self.last):
            if folder.exists():
                shutil.rmtree(folder)
        for pattern in ("config.json", "checkpoint.pkl", "validation.csv", "progress*.csv", "events.out.tfevents.*"):
            for path in self.folder.glob(pattern):
                path.unlink()

    def save(self, learner: dict[str, Any], progress: dict[str, Any]) -> None:
        """Write a checkpoint and the learning curve, each atomically.

        Args:
            learner: Its snapshot.
            progress: Of the run.

        Raises:
            OSError: If they cannot be written; the last checkpoint stays.
        """
        content = {"version": VERSION, "progress": progress, "learner": learner, "generators": _generators()}
        content["written_by"] = self._software
        try:
            write_sealed(self.checkpoint, pickle.dumps(content, pickle.HIGHEST_PROTOCOL))
            self._write_curve(progress)
        except OSError as error:
            kept = "the last good checkpoint stays, and --resume continues from it" if self.checkpoint.exists() else ""
            message = f"cannot save to {self.folder}: {error.strerror or error}; {kept or 'free some space'}"
            raise OSError(message) from None

    def _write_curve(self, progress: dict[str, Any]) -> None:
        write_text(self.curve, pandas.DataFrame(progress["curve"]).to_csv(index=False))

    def load(self, restore: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
        """Restore the last checkpoint.

        Args:
            restore: Restores a new learner from its snapshot.

        Returns:
            The run's progress.

        Raises:
            ValueError: If the checkpoint is damaged, or of a version that this one does not go on from.
        """
        content, origin = self._read(), None
        try:
            origin = content.get("written_by")
            if content["version"] != VERSION:
                raise ValueError(f"format {content['version']}, this version has {VERSION}")
            restore(content["learner"])
            _set_generators(content["generators"])
            return content["progress"]
        except (RuntimeError, ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
            raise self._misfit(error, origin) from error

    def _read(self) -> dict[str, Any]:
        """Unpickle the checkpoint, if it is what was written."""
        try:
            pickled = read_sealed(self.checkpoint)
        except ValueError as error:
            remedy = _remedy(self._noted()) if isinstance(error, Unsealed) else "choose another --out"
            raise ValueError(f"{self.checkpoint} cannot be read ({error}): {remedy}") from None
        try:
            content = pickle.loads(pickled)
        except (ImportError, AttributeError) as error:  # a class that this version does not have
            raise self._misfit(error, self._noted()) from error
        except (pickle.UnpicklingError, EOFError, RuntimeError, ValueError, KeyError, TypeError, IndexError) as error:
            raise ValueError(f"{self.checkpoint} cannot be read ({_words(error)}): choose another --out") from None
        if not (isinstance(content, dict) and "version" in content):
            raise ValueError(f"{self.checkpoint} cannot be read (no checkpoint of a run): choose another --out")
        return content

    def _misfit(self, error: Exception, origin: Any) -> ValueError:
        """Error about a checkpoint that another version wrote."""
        return ValueError(f"{self.checkpoint} does not fit this version ({_words(error)}): {_remedy(origin)}")

    def _noted(self) -> Any:
        """Software that wrote config.json, or None."""
        try:
            return loads(read_text(self.config))["written_by"]
        except (OSError, ValueError, KeyError, TypeError):
            return None


def _words(error: Exception) -> str:
    """Kind and first line of an error."""
    return in_a_line(f"{type(error).__name__}: {(str(error).splitlines() or ['no message'])[0]}", 80)


def _remedy(origin: Any) -> str:
    """Advice on a run of another version that keeps the run."""
    known = isinstance(origin, dict) and {"version", "commit"} <= set(origin)
    writer = (
        in_a_line(f"beltarm {origin['version']} at commit {origin['commit']}", 100)
        if known
        else "the version that wrote it"
    )
    return f"continue it with {writer}, or choose another --out"


def _generators() -> tuple[Any, ...]:
    """States of the random generators of Python, NumPy, PyTorch, and of PyTorch on GPUs if it uses any."""
    cuda = torch.cuda.get_rng_state_all() if torch.cuda.is_initialized() else []
    return random.getstate(), np.random.get_state(), torch.get_rng_state(), cuda  # noqa: NPY002


def _set_generators(states: tuple[Any, ...]) -> None:
    python, numpy, pytorch, cuda = states
    random.setstate(python)
    np.random.set_state(numpy)  # noqa: NPY002
    torch.set_rng_state(pytorch)
    if cuda:
        torch.cuda.set_rng_state_all(cuda)
