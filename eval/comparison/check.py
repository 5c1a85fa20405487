"""Checks that a user's own controller keeps the protocol on which the comparison relies, and time per action.

A controller is made without arguments and called as Stable-Baselines3 calls a policy, see
`beltarm_env.rollout.Controller`.
"""

import inspect
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode

from baselines.engines.isolated import run_isolated
from baselines.engines.parallel import BrokenOff
from baselines.tools.command import this_python
from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS, ArmParams, BeltArmVectorEnv
from beltarm_env.arrays import Flags, Singles
from beltarm_env.observation import Sensors
from beltarm_env.rollout import Controller
from beltarm_env.task.seeds import PROTOCOL_CHECK
from eval.comparison import custom
from eval.comparison.methods import Method
from eval.comparison.rollouts import Failure, place, run_controller, trace

ActionTimes = tuple[float, float]
"""Median and 99th percentile of the time per action for one arm [us]."""
PERIOD_US = 1e6 * CONTROL_PERIOD
_LATE = f": a 99th percentile beyond the period of {PERIOD_US:.0f} µs"

_SEED, _ARMS, _STEPS = *PROTOCOL_CHECK, EPISODE_STEPS
_CLOSE = 1e-5  # of the torque limit: what a batch's size may change in a network's last digits


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of a check."""

    check: str
    passed: bool
    detail: str = ""
    trace: str = ""  # of a failed one: the whole traceback

    @property
    def late(self) -> bool:
        """Whether it passed, but does not act within the control period."""
        return self.passed and self.detail.endswith(_LATE)


class Session(NamedTuple):
    """Recorded observations, episode starts and actions of some arms."""

    observations: Singles  # (T, n, size)
    starts: Flags  # which arms begin an episode     (T, n)
    actions: Singles  # (T, n, 1)


def record(controller: Controller) -> Session:
    """Record a controller that drives some arms of the training ranges.

    Raises:
        ValueError: If it returns anything but finite float32 of shape (n, 1), or changes what it observes.
    """
    samples = []
    for k, sample in enumerate(drive(controller, _ARMS, _STEPS, _SEED, randomization="train")):
        _require_torques(sample.action, k)
        if not np.array_equal(sample.given, sample.observation):
            raise ValueError(f"it changes the observation that it is given, in sample {k}")
        samples.append((sample.observation, sample.start, sample.action.copy()))
    return Session(*map(np.array, zip(*samples, strict=True)))


def _require_torques(action: object, sample: int) -> None:
    if not isinstance(action, np.ndarray) or action.shape != (_ARMS, 1) or action.dtype != np.float32:
        got = f"{action.dtype} of shape {action.shape}" if isinstance(action, np.ndarray) else type(action).__name__
        raise ValueError(f"for {_ARMS} arms it must return an array of float32 of shape ({_ARMS}, 1), got {got}")
    if not np.isfinite(action).all():
        raise ValueError(f"in sample {sample} it returns {action.ravel().tolist()}: torques must be finite")


def replayed(controller: Controller, observations: Singles, starts: Iterable[Flags | None]) -> Singles:
    """Actions on given observations; `starts` says in which samples which arms begin an episode, None for none."""
    memory, actions = None, list[Singles]()
    for observation, start in zip(observations, starts, strict=True):
        action, memory = controller.predict(observation.copy(), memory, start, deterministic=True)
        actions.append(np.array(action))
    return np.array(actions)


def _same(actions: Singles, expected: Singles, close: float = 0.0) -> str:
    """Words for actions that agree bit for bit, or within `close`; raises ValueError if they do not."""
    if np.array_equal(actions, expected):
        return "bit for bit"
    difference = np.abs(actions.astype(np.float64) - expected)
    if not difference.max() <= close:
        step = int(np.argmax(np.any(difference > close, axis=(1, 2))))
        raise ValueError(f"torques differ from sample {step} on, by up to {difference.max():.3g} of the limit")
    return f"within {difference.max():.1g} of the limit, not bit for bit"


def _again(make: Callable[[], Controller], known: Session) -> str:
    """Check the same samples once more, without `episode_start` at first and where no arm begins an episode."""
    starts = [start if start.any() else None for start in known.starts]
    return _same(replayed(make(), known.observations, [None, *starts[1:]]), known.actions)


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
    for values in mixed:
        values[half:, 1] = values[:half, 1]
    _same(replayed(make(), mixed.observations, mixed.starts), mixed.actions)
    return said


def _in_the_state(make: Callable[[], Controller], known: Session) -> str:
    """Check that two runs that take turns with one controller do not influence each other."""
    controller, actions = make(), list[Singles]()
    memories: list[Any] = [None, None]
    for observation, start in zip(known.observations, known.starts, strict=True):
        first, memories[0] = controller.predict(observation.copy(), memories[0], start, deterministic=True)
        actions.append(np.array(first))
        backwards, started = observation[::-1].copy(), start[::-1].copy()
        _, memories[1] = controller.predict(backwards, memories[1], started, deterministic=True)
    return _same(np.array(actions), known.actions)


def _in_time(make: Callable[[], Controller], _: Session) -> str:
    median, slow = action_times(make(), seed=_SEED)
    return f"{median:.0f} µs median, {slow:.0f} µs 99 %{_LATE if slow > PERIOD_US else ''}"


_CHECKS = {
    "the same observations give the same torques": _again,
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
    """Check a controller, as `findings_of` does, in a process of its own.

    If that process ends, or takes longer than `time_limit` [s], a check has failed.
    """
    spec = custom.absolute(spec)
    try:
        return run_isolated(partial(findings_of, spec), spec, time_limit)
    except BrokenOff as end:
        return [Finding("runs to the end", False, str(end))]


def first_failures(methods: Iterable[Method]) -> dict[str, Failure]:
    """Return what makes a user's controllers fail for one arm, by method: the others are the project's own."""
    added = [method for method in methods if method.kind == "added"]
    found = {method.name: run_controller(method, "", partial(_first_failure, method)) for method in added}
    return {name: failure for name, failure in found.items() if failure is not None}


def times_of(methods: Iterable[Method]) -> dict[str, ActionTimes | Failure]:
    """Time the actions of controllers for one arm; a failure says that there is none."""
    return {method.name: run_controller(method, "", partial(_time, method), "one arm") for method in methods}


def _time(method: Method) -> ActionTimes:
    return action_times(method.controller(0, [ArmParams()]), method.sensors)


def _first_failure(method: Method) -> Failure | None:
    (spec,) = method.sources
    for finding in findings_of(spec):
        if not finding.passed:
            words = f"it does not keep the protocol ({finding.check}): {finding.detail}; "
            words += f"see `{this_python()} eval/check_controller.py {spec}`"
            return Failure(method.name, "", words, finding.trace)
    return None


# Time per action


class Sample(NamedTuple):
    """One call of a controller."""

    observation: Singles
    given: Singles  # copy of the observation that the controller had
    start: Flags  # which arms begin an episode
    action: Singles
    seconds: float  # that the call took


def drive(controller: Controller, num_arms: int, steps: int, seed: int, **settings: Any) -> Iterator[Sample]:
    """Yield each sample of some arms, before they move, for at most an episode; `seed` and settings as of `rollout`.

    An arm that leaves its workspace begins a new episode.

    Raises:
        ValueError: If `predict` cannot be called as `Controller` is, or does not return two things.
    """
    try:
        inspect.signature(controller.predict).bind(None, None, None, deterministic=True)
    except TypeError as error:
        raise ValueError(f"predict must take (observation, state, episode_start, deterministic): {error}") from None
    env = BeltArmVectorEnv(num_arms, autoreset_mode=AutoresetMode.DISABLED, **settings)
    observation, _ = env.reset(seed=seed)
    memory: Any = None
    start = np.ones(num_arms, np.bool_)
    for _ in range(steps):
        given, began = observation.copy(), time.perf_counter()
        answer = controller.predict(given, memory, start, deterministic=True)
        seconds = time.perf_counter() - began
        if not isinstance(answer, tuple) or len(answer) != 2:
            got = type(answer).__name__
            raise ValueError(f"predict must return (torques, state), where state is None without a memory; got {got}")
        action, memory = answer
        yield Sample(observation, given, start, action, seconds)
        observation, _, start, truncated, _ = env.step(action)
        if start.any() and not truncated.any():
            observation, _ = env.reset(options={"reset_mask": start})


def action_times(controller: Controller, sensors: Sensors = "encoder", seed: int = 0) -> ActionTimes:
    """Time the actions of a controller for one nominal arm, over a whole move: plans near its end take the longest."""
    samples = drive(controller, 1, EPISODE_STEPS, seed, sensors=sensors)
    median, slow = np.percentile([1e6 * sample.seconds for sample in samples], [50, 99])
    return float(median), float(slow)
