"""A batch of arms as a Gymnasium vector environment: one compiled loop over all of them."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from beltarm_env import observation
from beltarm_env.arguments import Arguments, fixed
from beltarm_env.arm import ArmParams
from beltarm_env.arrays import Flags, Floats, Integers, Singles
from beltarm_env.batch import AT_ONCE, ArmBatch, new_renderer, whole
from beltarm_env.engine import in_threads
from beltarm_env.engine.blocks import SOON, none_taken, threads_for
from beltarm_env.env import BeltArmEnv
from beltarm_env.info import TERMS, TOTALS, Ended, masked, of_moves
from beltarm_env.kernels.layout import IDEAL
from beltarm_env.kernels.step import HUGE, Exchange, step_arms
from beltarm_env.observation import Sensors
from beltarm_env.physics.models import ModelName
from beltarm_env.task.draws import DRAWS
from beltarm_env.task.ranges import Randomization
from beltarm_env.task.reference import Profile, Reference
from beltarm_env.task.sensors import ENCODER_COUNTS
from beltarm_env.task.streams import Streams, checked_seed, drawn, seeded
from beltarm_env.timing import EPISODE_STEPS

_NONE = np.empty(0, dtype=np.intp)


def _no_generator(*_: object) -> None:
    raise AttributeError("arms of a batch draw from streams of their own, no np_random: reset(seed=...) seeds them")


class BeltArmVectorEnv(Arguments, VectorEnv[Singles, Singles, NDArray[Any]]):  # pyright: ignore[reportIncompatibleVariableOverride]
    """`num_envs` belt arms stepped by one compiled loop; arm *i* behaves bit for bit as a `BeltArmEnv` of its own.

    `reset(seed=s)` seeds arm *i* as `BeltArmEnv.reset(seed=s + i)` would. `autoreset_mode` is as in Gymnasium:
    next-step (default), same-step (`final_obs` and `final_info` in the info), or disabled
    (`reset(options={"reset_mask": mask})`).
    """

    num_envs: Any = fixed("num_envs")
    num_threads: Any = fixed("num_threads")
    autoreset_mode: Any = fixed("autoreset_mode")

    np_random: Any = property(_no_generator, _no_generator)

    _renderers: list[Any] | None = None  # known to one whose arguments are refused, too: Gymnasium closes it

    def __init__(  # noqa: PLR0913  options by keyword
        self,
        num_envs: int = 1,
        *,
        sensors: Sensors = "encoder",
        profile: Profile = "trapezoid",
        model: ModelName = "lumped",
        randomization: Randomization = "off",
        encoder_counts: int = ENCODER_COUNTS,
        delay: ArrayLike = 0,
        moves: int = 1,
        num_threads: int = 1,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: Literal["rgb_array"] | None = None,
    ) -> None:
        """Create the batch.

        Args:
            num_envs: Number of arms.
            sensors: As in `BeltArmEnv`.
            profile: As in `BeltArmEnv`.
            model: As in `BeltArmEnv`.
            randomization: As in `BeltArmEnv`; every arm draws its own parameters.
            encoder_counts: As in `BeltArmEnv`.
            delay: As in `BeltArmEnv`, for all arms or one each, shape (num_envs,).
            moves: As in `BeltArmEnv`.
            num_threads: Threads that may step the arms, at most 256. Their number changes no result; batches so small
                that they would be slower with them use fewer.
            max_episode_steps: Steps after which an episode is truncated, at most 1200 for each move, as by default.
            autoreset_mode: What happens to an arm whose episode is over.
            render_mode: "rgb_array" or None.

        Raises:
            ValueError: If an argument is unknown or out of range.
            TypeError: If `randomization` is neither a word nor a mapping of pairs.
        """
        if isinstance(num_envs, bool) or not isinstance(num_envs, int | np.integer) or num_envs < 1:
            raise ValueError(f"num_envs must be a whole number of at least 1, got {num_envs!r}")
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode must be None or 'rgb_array', got {render_mode!r}")
        self._num_envs = int(num_envs)
        try:
            self._autoreset_mode = AutoresetMode(autoreset_mode)
        except ValueError:
            allowed = ", ".join(repr(mode.value) for mode in AutoresetMode)
            raise ValueError(f"autoreset_mode must be one of {allowed}, got {autoreset_mode!r}") from None
        self.metadata = {**BeltArmEnv.metadata, "render_modes": ["rgb_array"], "autoreset_mode": self._autoreset_mode}
        arguments: dict[str, Any] = {
            "sensors": sensors,
            "profile": profile,
            "model": model,
            "randomization": randomization,
            "encoder_counts": encoder_counts,
            "delay": delay,
            "moves": moves,
        }
        self._batch = ArmBatch(self._num_envs, **arguments, num_threads=num_threads)
        most = EPISODE_STEPS * self._batch.num_moves
        given = most if max_episode_steps is None else max_episode_steps
        self._max_episode_steps = whole("max_episode_steps", given, 1, most)
        self._hold(**arguments, render_mode=render_mode)
        self._num_threads = self._batch.num_threads
        self.single_observation_space = self._batch.observation_space
        self.single_action_space = self._batch.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._size = observation.size(sensors)
        self._streams: Streams | None = None  # of random numbers, one per arm, from the first reset on
        self._seeds: list[int] = []  # that they began with
        self._ready = False  # all arms reset at least once
        self._ended = _NONE  # arms whose episode ended in the last step
        self._stepped = 0.0  # when the last step was done [s]
        self._least_left = EPISODE_STEPS  # no arm has fewer steps of its move left

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Singles, dict[str, Any]]:
        """Begin new episodes.

        Args:
            seed: Arm *i* is seeded with `seed + i`, or with `seed[i]`; None goes on with the arms' own generators.
            options: As in `BeltArmEnv.reset`, each value a scalar or one per arm that is reset (`state`: shape (4,) or
                (arms, 4)); and `reset_mask`, a bool array of shape (num_envs,): which arms to reset.

        Raises:
            ValueError: On an unknown name, a value out of range or a wrong shape.
            TypeError: If a value has a wrong type.
        """
        if options is not None and not isinstance(options, Mapping):
            raise TypeError(f"options must be a mapping, got {options!r}")
        options = dict(options or {})
        arms = np.arange(self.num_envs)
        if "reset_mask" in options:
            arms = np.flatnonzero(self._checked_mask(options.pop("reset_mask")))
            if not self._ready:
                raise ResetNeeded("reset_mask needs all arms to have been reset once: call reset() first")
        streams, seeds = self._seeded(seed, arms)
        if options:
            self._batch.reset(arms, drawn(streams, arms, DRAWS), options)
        else:
            self._batch.restart(arms, streams)  # the same, and needs no memory for the draws
        self._streams, self._seeds = streams, seeds
        self._ready = True
        self._ended = np.setdiff1d(self._ended, arms)
        self._forget_traces(arms)
        result = np.empty((self.num_envs, self._size), np.float32)
        self._batch.observe(result)
        return result, {}

    def step(self, actions: Singles) -> tuple[Singles, Floats, Flags, Flags, dict[str, Any]]:
        """Hold a torque for one control period in every arm.

        Args:
            actions: Torque over the torque limit, shape (num_envs, 1); cut to [-1, 1].

        Raises:
            ResetNeeded: Before the first reset, or, with autoreset disabled, if an episode is over.
            ValueError: If the actions have another shape or are not finite.
        """
        if not self._ready:
            raise ResetNeeded("no episode is running: call reset() before step()")
        if self._autoreset_mode is AutoresetMode.DISABLED and len(self._ended):
            raise ResetNeeded(
                f"the episode of arm {self._ended[0]} is over: reset it with options={{'reset_mask': mask}}"
            )
        fractions = self._checked_actions(actions)
        count = self._num_envs
        result = np.empty((count, self._size), np.float32)
        rewards, terms = np.empty(count), np.empty((len(TERMS), count))
        terminated, truncated = np.empty(count, np.bool_), np.empty(count, np.bool_)
        batch = self._batch
        if batch.engine is not None:
            batch.advance_in_engine(fractions)
        exchange = Exchange(fractions, result, rewards, terminated, truncated, terms)
        seldom = time.perf_counter() - self._stepped > SOON
        threads = threads_for(len(batch.blocks), batch.real_drive is not IDEAL, seldom, batch.num_threads)
        in_threads(step_arms, threads, batch.blocks, none_taken(threads), batch.rooms, exchange, batch.step_settings)
        self._stepped = time.perf_counter()
        stepped = np.empty(count, np.bool_)
        stepped.fill(True)  # `np.ones` takes three times as long
        restarted = self._ended if self._autoreset_mode is AutoresetMode.NEXT_STEP else _NONE
        if self._max_episode_steps < EPISODE_STEPS * self._num_moves:
            truncated |= batch.earlier_steps + batch.steps >= self._max_episode_steps
        if len(restarted):
            stepped[restarted] = False
            rewards[restarted] = 0.0
            terminated[restarted] = truncated[restarted] = False
            terms[:, restarted] = 0.0
            self._restart(restarted, result)
        over = terminated | truncated
        (self._ended,) = over.nonzero()
        info = masked(TERMS, terms, stepped)
        self._least_left -= 1
        moves = self._end_moves(result, terminated) if self._least_left <= 0 else None
        if len(self._ended):
            info = self._finished(info, moves, result, over, terminated)
        elif moves is not None:
            info |= of_moves(moves, stepped)
        return result, rewards, terminated, truncated, info

    def _end_moves(self, result: Singles, terminated: Flags) -> Ended | None:
        """Sum up the moves that are over and begin the next ones; return the sums and the arms that they are of."""
        assert self._streams is not None, "there was a reset"
        batch = self._batch
        steps = batch.steps
        ended = steps == EPISODE_STEPS
        self._least_left = EPISODE_STEPS - int(steps.max(initial=0, where=steps < EPISODE_STEPS))
        if not ended.any():
            return None
        totals = batch.move_totals(np.flatnonzero(ended))
        going_on = np.flatnonzero(ended & ~terminated & (batch.move_numbers < self._num_moves - 1))
        for low in range(0, len(going_on), AT_ONCE):
            arms = going_on[low : low + AT_ONCE]
            batch.next_moves(arms, drawn(self._streams, arms, DRAWS))
            batch.observe(result, arms)
        self._forget_traces(going_on)
        return totals, ended

    def _finished(
        self, info: dict[str, Any], moves: Ended | None, result: Singles, over: Flags, terminated: Flags
    ) -> dict[str, Any]:
        """Info of a step in which episodes ended; with same-step autoreset, restart those arms."""
        totals = masked(TOTALS, self._batch.totals(self._ended, terminated), over)
        if self._autoreset_mode is not AutoresetMode.SAME_STEP:
            return {**info, **totals, **of_moves(moves, np.ones_like(over))}
        terms = np.stack([info[name] for name in TERMS])
        final_info = {**masked(TERMS, np.where(over, terms, 0.0), over), **totals, **of_moves(moves, over)}
        final_observations = np.full(self.num_envs, None, dtype=object)
        for arm in self._ended:
            final_observations[arm] = result[arm].copy()
        self._restart(self._ended, result)
        return {
            **masked(TERMS, np.where(over, 0.0, terms), ~over),
            **of_moves(moves, ~over),
            "final_obs": final_observations,
            "_final_obs": over.copy(),
            "final_info": final_info,
            "_final_info": over.copy(),
        }

    def _restart(self, arms: Integers, result: Singles) -> None:
        """Begin new random episodes and put their first observations into `result`."""
        assert self._streams is not None, "there was a reset"
        self._batch.restart(arms, self._streams)
        self._batch.observe(result, arms)
        self._forget_traces(arms)

    def _forget_traces(self, arms: Integers) -> None:
        """Clear the pictures of arms that begin a move."""
        if self._renderers is not None:
            for arm in arms:
                self._renderers[arm].clear()

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Seed that each arm's stream of random numbers began with."""
        if self._streams is None:
            self._streams, self._seeds = self._seeded(None, _NONE)
        return tuple(self._seeds)

    def _seeded(self, seed: int | Sequence[int | None] | None, arms: Integers) -> tuple[Streams, list[int]]:
        """Return the streams of all arms, with those of some seeded, and the seeds that they began with."""
        if seed is None or isinstance(seed, int | np.integer):
            given = [None if seed is None else checked_seed(seed) + arm for arm in range(self.num_envs)]
        elif isinstance(seed, set | frozenset | dict):
            raise TypeError(f"seeds must have an order, got {seed!r}")
        else:
            given = list(seed)
            if len(given) != self.num_envs:
                raise ValueError(f"seed must be one number or {self.num_envs} of them, got {len(given)}")
        if self._streams is None:
            seeds: list[int] = np.random.default_rng().integers(2**63, size=self.num_envs).tolist()
            streams = seeded(seeds)
        else:
            seeds, streams = self._seeds.copy(), self._streams.copy()
        own = {int(arm): checked_seed(given[arm]) for arm in arms if given[arm] is not None}
        streams[list(own)] = seeded(list(own.values()))
        for arm, number in own.items():
            seeds[arm] = number
        return streams, seeds

    def _checked_mask(self, mask: object) -> Flags:
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.shape != (self.num_envs,):
            raise ValueError(f"reset_mask must be a bool array of shape ({self.num_envs},), got {mask!r}")
        if not mask.any():
            raise ValueError("reset_mask must choose at least one arm, got all False")
        return mask

    def _checked_actions(self, actions: Singles) -> Floats:
        array = np.asarray(actions)
        if array.shape != (self._num_envs, 1) or array.dtype.kind not in "fiu":
            raise ValueError(f"actions must be numbers of shape ({self.num_envs}, 1), got {array.dtype} {array.shape}")
        values = array[:, 0].astype(np.float64)
        allowed = np.abs(values) < HUGE
        if np.count_nonzero(allowed) != self._num_envs:  # `all` takes twice as long
            arm = int(np.argmin(allowed))
            raise ValueError(f"actions must be finite, and below {HUGE:g}, got {values[arm]} for arm {arm}")
        return values

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """One frame of shape (height, width, 3) per arm, or None without a render mode."""
        if self.render_mode is None:
            return None
        if not self._ready:
            raise ResetNeeded("there are no arms to draw yet: call reset() before render()")
        if self._renderers is None:
            self._renderers = [new_renderer(self._batch.model_name, "rgb_array") for _ in range(self.num_envs)]
        states, times = self.state, self._batch.times
        frames = []
        for arm, renderer in enumerate(self._renderers):
            angle = self._batch.reference(arm, times[arm]).angle
            frames.append(renderer.draw(self._batch.params(arm), states[arm], angle, float(times[arm])))
        return tuple(frames)

    def close_extras(self, **_: Any) -> None:
        """Release the renderers."""
        for renderer in self._renderers or []:
            renderer.close()
        self._renderers = None

    @property
    def state(self) -> Floats:
        """Copy of the true states (rad, rad/s), shape (num_envs, 4), float64."""
        return self._batch.states

    @property
    def motor_torques(self) -> Floats:
        """True torques of the motors now [N m], shape (num_envs,), ripple not counted."""
        return self._batch.motor_torques

    @property
    def params(self) -> list[ArmParams]:
        """Physical constants of each arm in its move."""
        return [self._batch.params(arm) for arm in range(self.num_envs)]

    @property
    def params_table(self) -> Floats:
        """Copy of all parameters, shape (num_envs, fields), columns as `ArmParams`."""
        return self._batch.table.copy()

    def tip_errors(self) -> Floats:
        """Tip minus reference tip now: x, y [m] and their speeds [m/s], shape (num_envs, 4)."""
        return self._batch.tip_errors()

    @property
    def moves(self) -> Floats:
        """Moves, shape (num_envs, 4): start, goal [rad], duration, ramp_time [s]."""
        return self._batch.moves

    @property
    def move_numbers(self) -> Integers:
        """Number of each arm's move in its episode, from 0 on, shape (num_envs,)."""
        return self._batch.move_numbers

    def reference(self, time: float) -> Reference:
        """Reference `time` s after each move's start: angle, speed, acceleration at the joint, shape (num_envs,)."""
        per_arm = [self._batch.reference(arm, time) for arm in range(self.num_envs)]
        return Reference(*np.array(per_arm).T)
