"""Optuna study of a search: its ranges, and the journal that stores it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, fields
from pathlib import Path

import optuna
from filelock import FileLock, Timeout
from optuna.distributions import BaseDistribution, FloatDistribution
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend, JournalFileOpenLock
from optuna.trial import TrialState

from baselines.gains import Gains
from baselines.loops.condition import MarginCondition


def space(kind: type[Gains]) -> dict[str, BaseDistribution]:
    """Distributions of all gains."""
    ranges = {gain.name: gain.metadata for gain in fields(kind)}
    return {name: FloatDistribution(of["low"], of["high"], log=of["log"]) for name, of in ranges.items()}


def rounded(params: dict[str, float], kind: type[Gains]) -> Gains:
    """Gains rounded to six significant digits, as they are written to the file."""
    near = {name: float(f"{value:.6g}") for name, value in params.items()}
    ranges = {gain.name: gain.metadata for gain in fields(kind)}
    return kind(**{name: min(max(near[name], of["low"]), of["high"]) for name, of in ranges.items()})


@contextmanager
def own(journal: Path) -> Iterator[None]:
    """Lock the journal for this process; the system releases the lock of a process that is killed.

    Raises:
        ValueError: If another process holds it.
    """
    journal.parent.mkdir(parents=True, exist_ok=True)
    lock = FileLock(f"{journal}.owner")
    try:
        lock.acquire(timeout=0)
    except Timeout:
        raise ValueError(f"another process tunes with {journal}: wait for it, or choose another --journals") from None
    try:
        Path(f"{journal}.lock").unlink(missing_ok=True)  # Optuna's own, left by a process that was killed
        yield
    finally:
        lock.release()


def begin_anew(journal: Path) -> None:
    """Delete a journal, unless another process tunes with it; raises as `own`."""
    with own(journal):
        journal.unlink(missing_ok=True)


def open_study(kind: type[Gains], seed: int, journal: Path, condition: MarginCondition | None = None) -> optuna.Study:
    """Open the study in a locked journal, or begin one with the untuned gains.

    Raises:
        ValueError: If the journal is damaged, or was begun with another seed, other gains or other margins.
    """
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    remedy = "tune anew, without --resume"
    try:
        _cut_half_line(journal)
        backend = JournalFileBackend(str(journal), JournalFileOpenLock(str(journal)))
        study = optuna.create_study(study_name="gains", storage=JournalStorage(backend), load_if_exists=True)
        trials = study.get_trials(deepcopy=False)
    except (KeyError, ValueError) as error:
        raise ValueError(f"{journal} is damaged ({error}): {remedy}") from None
    begun = {
        "seed": seed,
        "gains": {gain.name: [gain.default, *gain.metadata.values()] for gain in fields(kind)},
        "margins": None if condition is None else {**asdict(condition), "arms": list(condition.arms)},
    }
    if study.user_attrs.get("begun", begun) != begun:
        raise ValueError(f"{journal} was started with another seed, other margins or other ranges of gains: {remedy}")
    study.set_user_attr("begun", begun)
    for trial in trials:
        if trial.state is TrialState.RUNNING:  # when it was interrupted
            study.tell(trial.number, state=TrialState.FAIL)
    if not study.get_trials(deepcopy=False, states=(TrialState.COMPLETE, TrialState.WAITING)):
        study.enqueue_trial(asdict(kind()))
    study.sampler = optuna.samplers.TPESampler(seed=seed + len(trials), multivariate=True)
    return study


def _cut_half_line(journal: Path) -> None:
    """Take away the line in which a process was killed: Optuna would write on in it."""
    written = journal.read_bytes() if journal.exists() else b""
    if written and not written.startswith(b"{"):
        raise ValueError("it is no journal")
    whole = written.rfind(b"\n") + 1
    if whole < len(written):
        os.truncate(journal, whole)
