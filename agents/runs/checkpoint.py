"""Folder of a run, and checkpoints from which it resumes bit for bit.

    config.json       every option, the defaults of a resumed run; what identifies the run; the software that writes it
    checkpoint.pkl    everything that the next step depends on: the learner (its networks, optimisers, arms, memories
                      and data), random generators, the run's progress; a SHA-256 of all that stands at its end
    validation.csv    the learning curve
    best/, last/      policies: lowest validation cost, and end of the run
    progress*.csv, events*   training log, as CSV and for TensorBoard
    .lock             locked as long as a run works in the folder, by the system: a process that is killed leaves none

A checkpoint is a pickle: loading it executes what it says. It is for the machine that wrote it; what is passed on to
others are policies (`agents.policy.bundle`), which hold numbers and text alone. A model that Stable-Baselines3 saves is
a part of it, and not enough: it lacks arms, generators and the run's progress, and it is written in place, so that a
kill can leave half of one and no other.
"""

from __future__ import annotations

import json
import pickle
import random
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import torch
from filelock import FileLock, Timeout

from agents.runs.settings import RunConfig
from baselines.tools.files import read_sealed, read_text, require_writable, write_sealed, write_text
from baselines.tools.options import note_options
from baselines.tools.provenance import software
from baselines.tools.schema import in_a_line, loads

VERSION = 11
"""Format of checkpoints; raise it where a snapshot, what is learned from, or the place of a pickled class changes."""
CHECKPOINT, CONFIG, COMMAND = Path("checkpoint.pkl"), Path("config.json"), Path("command.json")
"""Within the folder of a run; that of several has the last, the options of their command."""
_WRITTEN = (*map(str, (CHECKPOINT, CONFIG, COMMAND)), "validation.csv", "progress*.csv", "events.out.tfevents.*")
_PACKAGES = ("numpy", "torch", "stable-baselines3", "sb3-contrib")
_BEGUN_WITH = {
    "base_hash": "other gains of the base",
    **dict.fromkeys(("layout", "entries"), "another observation layout"),
}


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
        self._lock = FileLock(folder / ".lock", timeout=0)

    @contextmanager
    def locked(self, config: RunConfig) -> Iterator[None]:
        """Lock the folder for a run that may begin or go on there; one that is to be overwritten is deleted.

        Raises:
            ValueError: As `check` does, or if another run is under way there.
            OSError: As `check` does, or if the folder cannot be written.
        """
        self.check(config)
        require_writable(self.folder)
        try:
            with self._lock:
                self.check(config)  # again: another run may have ended meanwhile
                if config.overwrite:
                    self._delete_run()
                yield
        except Timeout:
            raise ValueError(f"another run works in {self.folder}: wait for its end, or choose another --out") from None

    def note(self, config: RunConfig, curve: list[dict[str, Any]] | None = None) -> None:
        """Write config.json and, of a run that is resumed, the learning curve of its checkpoint.

        A process that was killed may have left the curve of the checkpoint before.
        """
        note_options(self.config, config, identity=config.identity(), written_by=written_by())
        if curve is not None:
            self._write_curve(curve)

    def check(self, config: RunConfig) -> None:
        """Check that the folder is free, holds the run to resume, or may be overwritten.

        Raises:
            FileNotFoundError: If there is nothing to resume.
            ValueError: If it holds a run that is neither to be resumed nor to be overwritten, or another run.
        """
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
            before = loads(read_text(self.config))["identity"]
            options = {"algorithm": before["algorithm"], **before["options"]}
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{self.config} is damaged ({in_a_line(repr(error))}): choose another --out") from None
        now, run = json.loads(json.dumps(config.identity(), default=str)), f"the run in {self.folder}"
        for name, value in {"algorithm": now["algorithm"], **now["options"]}.items():
            if options.get(name) != value:
                option = f"--{name.replace('_', '-')}" if name in now["options"] else name
                known = f"{option} {in_a_line(options.get(name), 80)}"
                raise ValueError(f"{run} has {known}, not {value}: give the same options, or choose another --out")
        for name, change in _BEGUN_WITH.items():
            if before.get(name) != now[name]:
                raise ValueError(f"{run} began with {change}: {self._remedy()}")

    def _delete_run(self) -> None:
        """Delete the files that runs write, and nothing else."""
        for folder in filter(Path.exists, (self.best, self.last)):
            shutil.rmtree(folder)
        for pattern in _WRITTEN:
            for path in self.folder.glob(pattern):
                path.unlink()

    def save(self, learner: dict[str, Any], progress: dict[str, Any]) -> None:
        """Write a checkpoint, of a learner's snapshot and the run's progress, and the learning curve, each atomically.

        Raises:
            OSError: If they cannot be written; the last checkpoint stays.
        """
        content = {
            "version": VERSION,
            "progress": progress,
            "learner": learner,
            "generators": [get() for get, _ in _GENERATORS],
        }
        try:
            write_sealed(self.checkpoint, pickle.dumps(content, pickle.HIGHEST_PROTOCOL))
            self._write_curve(progress["curve"])
        except OSError as error:
            hint = "the last good checkpoint stays, and --resume continues from it" if self.checkpoint.exists() else ""
            message = f"cannot save to {self.folder}: {error.strerror or error}; {hint or 'free some space'}"
            raise OSError(message) from None

    def _write_curve(self, curve: list[dict[str, Any]]) -> None:
        write_text(self.curve, pandas.DataFrame(curve).to_csv(index=False))

    def load(self, restore: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
        """Restore the last checkpoint: a new learner, by `restore`, and the generators. Return the run's progress.

        Raises:
            ValueError: If the checkpoint is damaged, or of a version that this one does not go on from.
        """
        try:
            data = read_sealed(self.checkpoint)
        except ValueError as error:
            raise ValueError(f"{self.checkpoint} cannot be read ({error}): {self._remedy()}") from None
        try:
            content = pickle.loads(data)
            if content["version"] != VERSION:
                raise ValueError(f"format {content['version']}, this version has {VERSION}")
            restore(content["learner"])
            for (_, restore_generator), state in zip(_GENERATORS, content["generators"], strict=True):
                restore_generator(state)
            return content["progress"]
        except Exception as error:  # whatever unpickling, and classes of another version, stumble over
            reason = in_a_line(f"{type(error).__name__}: {(str(error).splitlines() or ['no message'])[0]}", 80)
            raise ValueError(f"{self.checkpoint} does not fit this version ({reason}): {self._remedy()}") from error

    def _remedy(self) -> str:
        """Advice that keeps the run, which this version does not go on with."""
        writer = "the version that wrote it"
        with suppress(OSError, ValueError, KeyError, TypeError):
            origin = loads(read_text(self.config))["written_by"]
            writer = in_a_line(f"beltarm {origin['version']} at commit {origin['commit']}", 100)
        return f"continue it with {writer}, or choose another --out"


_GENERATORS = (  # of Python, NumPy, PyTorch, and PyTorch on GPUs, if it uses any
    (random.getstate, random.setstate),
    (np.random.get_state, np.random.set_state),
    (torch.get_rng_state, torch.set_rng_state),
    (lambda: torch.cuda.get_rng_state_all() if torch.cuda.is_initialized() else [], torch.cuda.set_rng_state_all),
)
