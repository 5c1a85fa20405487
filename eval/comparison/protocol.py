"""Checks that a user's own controller keeps the protocol on which the comparison relies.

A controller is made without arguments and called as Stable-Baselines3 calls a policy, see
`beltarm_env.rollout.Controller`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.engines.isolated import run_isolated
from baselines.engines.parallel import BrokenOff
from baselines.tools.command import this_python
from beltarm_env.rollout import Controller
from beltarm_env.task.seeds import PROTOCOL_CHECK
from eval.comparison import custom
from eval.comparison.failures import Failure, place, run_controller, trace
from eval.comparison.methods import Method
from eval.comparison.timing import PERIOD_US, action_times, drive

Singles = NDArray[np.float32]
Flags = NDArray[np.bool_]

_SEED, _ARMS = PROTOCOL_CHECK
_STEPS = 600
_CLOSE = 1e-5  # of the torque limit: what a batch's size may change in a network's last digits


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of one check."""

    check: str
    passed: bool
    detail: str = ""
    trace: str = ""  # of a failed one: the whole traceback


@dataclass(frozen=True, slots=True)
class Session:
    """Recorded observations, episode starts and actions of some arms."""

    observations: Singles  # (T, n, size)
    starts: Flags  # which arms begin an episode     (T, n)
    actions: Singles  # (T, n, 1)


class _Strict:
    """Controller that must return finite float32 of shape (n, 1) and leave its observations as they are."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._sample = -1

    def predict(self, observation: Singles, *rest: Any, **options: Any) -> Any:
        """Call the controller; see `Controller`."""
        self._sample += 1
        given = observation.copy()
        action, memory = self._controller.predict(given, *rest, **options)
        self._check(action)
        if not np.array_equal(given, observation):
            raise ValueError(f"it changes the observation that it is given, in sample {self._sample}")
        return action, memory

    def _check(self, action: object) -> None:
        if not isinstance(action, np.ndarray) or action.shape != (_ARMS, 1) or action.dtype != np.float32:
            what = (
                f"{action.dtype} of shape {action.shape}" if isinstance(action, np.ndarray) else type(action).__name__
            )
            raise ValueError(f"for {_ARMS} arms it must return an array of float32 of shape ({_ARMS}, 1), got {what}")
        if not np.isfinite(action).all():
            found = action.ravel().tolist()
            raise ValueError(f"in sample {self._sample} it returns {found}: torques must be finite")


def record(controller: Controller) -> Session:
    """Record a controller that drives some arms of the training ranges.

    Raises:
        ValueError: If it returns anything but finite float32 of shape (n, 1), or changes what it observes.
    """
    driven = drive(_Strict(controller), _ARMS, _STEPS, _SEED, randomization="train")
    samples = [(observation, start, action.copy()) for observation, start, action in driven]
    return Session(*map(np.array, zip(*samples, strict=True)))


def replayed(controller: Controller, observations: Singles, starts: Flags) -> Singles:
    """Actions on given observations; `starts` says in which samples which arms begin an episode."""
    memory: Any = None
    actions = []
    for observation, start in zip(observations, starts, strict=True):
        action, memory = controller.predict(observation.copy(), memory, start)
        actions.append(np.array(action))
    return np.array(actions)


def _same(actions: Singles, expected: Singles, close: float = 0.0) -> str:
    """Words for actions that should agree bit for bit, or within `close`.

    Raises:
        ValueError: If they are not.
    """
    if np.array_equal(actions, expected):
        return "bit for bit"
    difference = np.abs(actions.astype(np.float64) - expected)
    if not difference.max() <= close:
        step = int(np.argmax(np.any(difference > close, axis=(1, 2))))
        raise ValueError(f"torques differ from sample {step} on, by up to {difference.max():.3g} of the limit")
    return f"within {difference.max():.1g} of the limit, not bit for bit"


def _repeats(make: Callable[[], Controller], known: Session) -> str:
    return _same(replayed(make(), known.observations, known.starts), known.actions)


def _alone(make: Callable[[], Controller], known: Session) -> str:
    arms = [slice(k, k + 1) for k in range(_ARMS)]
    alone = [replayed(make(), known.observations[:, arm], known.starts[:, arm]) for arm in arms]
    return _same(np.concatenate(alone, axis=1), known.actions, _CLOSE)


def _afresh(make: Callable[[], Controller], known: Session) -> str:
    """Check a new episode that follows another arm's, and one that begins amid those of the others."""
    half = _STEPS // 2
    observations = np.concatenate([known.observations[half:, ::-1], known.observations[:half]])
    starts = np.concatenate([known.starts[half:, ::-1], known.starts[:half]])
    starts[0] = True
    said = _same(replayed(make(), observations, starts)[half:], known.actions[:half])
    mixed = Session(known.observations.copy(), known.starts.copy(), known.actions.copy())
    for values in (mixed.observations, mixed.starts, mixed.actions):
        values[half:, 1] = values[:half, 1]
    _same(replayed(make(), mixed.observations, mixed.starts), mixed.actions)
    return said


def _in_the_state(make: Callable[[], Controller], known: Session) -> str:
    """Check that two runs that take turns with one controller do not influence each other."""
    controller = make()
    actions = []
    memories: list[Any] = [None, None]
    for observation, start in zip(known.observations, known.starts, strict=True):
        first, memories[0] = controller.predict(observation.copy(), memories[0], start)
        actions.append(np.array(first))
        _, memories[1] = controller.predict(observation[::-1].copy(), memories[1], start[::-1].copy())
    return _same(np.array(actions), known.actions)


def _in_time(make: Callable[[], Controller], _: Session) -> str:
    median, slow = action_times(make(), seed=_SEED)
    late = f": a 99th percentile beyond the period of {PERIOD_US:.0f} µs" if slow > PERIOD_US else ""
    return f"{median:.0f} µs median, {slow:.0f} µs 99 %{late}"


_CHECKS = {
    "the same observations give the same torques": _repeats,
    "an arm of a batch is driven as if alone": _alone,
    "an episode begins without memory of the last": _afresh,
    "all memory is in the state that is returned": _in_the_state,
    "time per action, one arm": _in_time,
}


def findings(make: Callable[[], Controller]) -> Iterator[Finding]:
    """Check a controller, step by step; the first failure to drive the arms ends the checks."""
    first = f"drives {_ARMS} arms with finite float32 torques"
    try:
        known = record(make())
    except (Exception, SystemExit) as error:
        yield _failed(first, error)
        return
    yield Finding(first, True, f"{_STEPS} samples")
    for name, check in _CHECKS.items():
        try:
            yield Finding(name, True, check(make, known))
        except (Exception, SystemExit) as error:
            yield _failed(name, error)


def _failed(check: str, error: BaseException) -> Finding:
    words = " ".join((str(error) if type(error) is ValueError else f"{type(error).__name__}: {error}").split())
    return Finding(check, False, words + place(error), trace(error))


def findings_of(spec: str) -> list[Finding]:
    """Check a controller by its name, up to the first failure to drive the arms.

    Raises:
        ValueError: If it cannot be imported or made.
    """
    try:
        custom.make(spec)
    except ValueError as error:
        error.add_note(trace(error))  # which is all that another process sees of it
        raise
    return list(findings(custom.factory(spec)))


def isolated_findings(spec: str, time_limit: float) -> list[Finding]:
    """Check a controller in a process of its own; the end of that is a failed check.

    Args:
        spec: See `eval.comparison.custom`.
        time_limit: Time that all checks together may take [s].

    Raises:
        ValueError: If it cannot be imported or made.
    """
    spec = custom.absolute(spec)
    try:
        return run_isolated(partial(findings_of, spec), spec, time_limit)
    except BrokenOff as end:
        return [Finding("runs to the end", False, str(end))]


def failures(methods: Iterable[Method]) -> dict[str, Failure]:
    """Check the added ones of some methods; by name the first failure of each that cannot be run as the others are."""
    found = {one.name: run_controller(one, "", partial(_first_failure, one)) for one in methods if one.kind == "added"}
    return {name: failure for name, failure in found.items() if failure is not None}


def _first_failure(method: Method) -> Failure | None:
    (spec,) = method.sources
    for finding in findings_of(spec):
        if not finding.passed:
            words = f"it does not keep the protocol ({finding.check}): {finding.detail}"
            return Failure(
                method.name, "", f"{words}; see `{this_python()} eval/check_controller.py {spec}`", finding.trace
            )
    return None
