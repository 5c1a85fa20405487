"""Optuna studies in journals that go on after an interruption as if there had been none.

Three things are added to Optuna. A process locks its journal, since Optuna lets several write to one. A line that was
cut off is taken away, since Optuna would write on in it. And a trial that was interrupted is run again: Optuna's
`RetryHeartbeatStaleTrialCallback` does that in databases alone, after a wait for a heartbeat.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from filelock import FileLock, Timeout
from optuna.distributions import BaseDistribution
from optuna.pruners import BasePruner
from optuna.storages import BaseStorage, JournalStorage
from optuna.storages.journal import JournalFileBackend, JournalFileOpenLock
from optuna.trial import FrozenTrial, Trial, TrialState

from beltarm_env.sources import sources_digest

_ROOT = Path(__file__).resolve().parents[2]
_REPEATS = "repeats"  # attribute of a trial that repeats an interrupted one: the place of that
_WORKER = "worker"


@contextmanager
def own(journal: Path) -> Iterator[None]:
    """Lock a journal for this process and its workers; the system releases the lock of a process that is killed.

    Raises:
        ValueError: If another process holds it.
    """
    journal.parent.mkdir(parents=True, exist_ok=True)
    lock = FileLock(f"{journal}.owner")
    try:
        lock.acquire(timeout=0)
    except Timeout:
        raise ValueError(f"another process tunes with {journal}: wait for it, or choose another folder") from None
    try:
        Path(f"{journal}.lock").unlink(missing_ok=True)  # Optuna's own, left by a process that was killed
        if journal.exists() and _is_journal(journal):
            os.truncate(journal, journal.read_bytes().rfind(b"\n") + 1)  # without the line in which it was killed
        yield
    finally:
        lock.release()


def begin_anew(journal: Path) -> None:
    """Delete a journal, unless another process tunes with it; raises as `own`."""
    with own(journal):
        journal.unlink(missing_ok=True)


def storage_in(journal: Path) -> JournalStorage:
    """Storage in a journal.

    Raises:
        ValueError: If the file is none.
    """
    if not _is_journal(journal):
        raise ValueError("it is no journal")
    return JournalStorage(JournalFileBackend(str(journal), JournalFileOpenLock(str(journal))))


def open_study(
    journal: Path,
    begun: Mapping[str, Any],
    pruner: BasePruner,
    *,
    packages: Sequence[str],
    remedy: str,
    storage: BaseStorage | None = None,
) -> optuna.Study:
    """Open the study in a journal, or begin one.

    Args:
        journal: Its file.
        begun: What must be the same whenever the study goes on, as JSON has it.
        pruner: Ends trials early.
        packages: Of this project, whose code must be the same too.
        remedy: What to do about a journal that is damaged or of another study.
        storage: Where the study is instead, for a machine that does not see the file.

    Raises:
        ValueError: If the journal is damaged, or was begun with something else.
    """
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    try:
        storage = storage or storage_in(journal)
        study = optuna.create_study(study_name="tuning", storage=storage, load_if_exists=True, pruner=pruner)
    except (KeyError, ValueError) as error:
        raise ValueError(f"{journal} is damaged ({error}): {remedy}") from None
    begun = {"code": sources_digest(*(_ROOT / package for package in packages))[:12], **begun}
    noted = study.user_attrs.get("begun", begun)
    if noted != begun:
        other = [name for name in begun if noted.get(name) != begun[name]]
        differing = ", ".join(f"{name} {noted.get(name)}, not {begun[name]}" for name in other)
        raise ValueError(f"{journal} was started with {differing}: {remedy}")
    study.set_user_attr("begun", dict(begun))
    return study


def ask(
    study: optuna.Study,
    space: Mapping[str, BaseDistribution],
    seed: int,
    worker: int = 0,
    first: Sequence[dict[str, float]] = (),
) -> Trial:
    """Begin the next trial: one that waits, one of the first, or what follows from those before and the seed alone."""
    at = _places(study)
    if at < len(first) and not study.get_trials(deepcopy=False, states=(TrialState.WAITING,)):
        study.enqueue_trial(first[at])
    seeds = np.random.SeedSequence([seed, worker, at])
    study.sampler = optuna.samplers.TPESampler(seed=int(seeds.generate_state(1)[0]), multivariate=True)
    trial = study.ask(dict(space))
    trial.set_user_attr(_WORKER, worker)
    return trial


def repeat_interrupted(study: optuna.Study, worker: int | None = None) -> list[int]:
    """Mark running trials, of a worker that died or of all, as failed; others wait with their settings and places.

    Returns:
        The places.
    """
    running = study.get_trials(deepcopy=False, states=(TrialState.RUNNING,))
    left = [trial for trial in running if worker in (None, trial.user_attrs.get(_WORKER))]
    places = [place(study, trial) for trial in left]
    for trial, at in zip(left, places, strict=True):
        study.tell(trial.number, state=TrialState.FAIL)
        study.enqueue_trial(trial.params, user_attrs={_REPEATS: at})
    return places


def place(study: optuna.Study, trial: FrozenTrial | Trial) -> int:
    """Place of a trial in a study that is never interrupted, in which none is repeated."""
    return trial.user_attrs.get(_REPEATS, _places(study, trial.number))


def _places(study: optuna.Study, before: int | None = None) -> int:
    """How many trials there are, or were before one; repeats do not count."""
    return sum(_REPEATS not in trial.user_attrs for trial in study.get_trials(deepcopy=False)[:before])


def _is_journal(file: Path) -> bool:
    """Whether a file holds the lines of a journal, or nothing yet."""
    if not file.exists():
        return True
    with file.open("rb") as content:
        return content.read(1) in (b"", b"{")
