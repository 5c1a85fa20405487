"""N arms with their parameters, moves and sensors: the part shared by the single and the vector environment."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import asdict
from functools import cache
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike

from beltarm_env import observation
from beltarm_env.arm import COLUMN, FIELDS, WHOLE, ArmParams, checked_constant
from beltarm_env.arrays import Flags, Floats, Integers, Singles
from beltarm_env.engine.blocks import MAX_THREADS
from beltarm_env.info import MOVE_TOTALS, TOTALS
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.episodes import Beginnings, begin_episodes, episode_totals, restart_episodes, tip_errors
from beltarm_env.kernels.layout import IDEAL, REAL
from beltarm_env.kernels.moves import move_totals, next_moves
from beltarm_env.kernels.observe import observe_arms, observe_some
from beltarm_env.kernels.step import new_rooms
from beltarm_env.physics.models import model_of
from beltarm_env.physics.substeps import MAX_SUBSTEPS, check_integrable, fastest_arms
from beltarm_env.task.draws import END_OF_MOVE, FIRST_OF_MOVE
from beltarm_env.task.moves import MOVE_FIELDS, check_moves, draw_moves
from beltarm_env.task.options import checked_column, checked_names, checked_states
from beltarm_env.task.ranges import Randomization, draw_table, shared_bounds
from beltarm_env.task.reference import PROFILES, MoveShape, Reference, reference_at
from beltarm_env.task.shift import MOST_MOVES, fastest_of_moves
from beltarm_env.task.streams import Streams, wrapping
from beltarm_env.timing import CONTROL_PERIOD, EPISODE_STEPS

if TYPE_CHECKING:
    from beltarm_env.mujoco.renderer import MuJoCoRenderer
    from beltarm_env.rendering.renderer import Renderer


WINDOW_FPS = 50
"""Frames per second of arm time that a window shows [1/s]."""
AT_ONCE = 4096
"""Arms whose draws take little memory."""


class Engine(Protocol):
    """Protocol of what moves the arms of a batch in place of the kernels."""

    def check(self, table: Floats) -> None:
        """Refuse arms with parameters (n, fields) that it cannot move, by a ValueError."""
        ...

    def begin(self, arms: Integers, table: Floats, states: Floats | None) -> None:
        """Begin new episodes for arms with parameters (n, fields) from states (n, 4); None for further moves."""
        ...

    def advance(self, actions: Floats) -> Floats:
        """Hold torques over their limits, shape (num_arms,), for one control period; states, shape (num_arms, 4)."""
        ...

    def torques(self) -> Floats:
        """Torques of the motors now [N m], shape (num_arms,)."""
        ...


def new_renderer(model: str, render_mode: Literal["human", "rgb_array"]) -> Renderer | MuJoCoRenderer:
    """Make what draws an arm of this model."""
    if model == "mujoco":
        from beltarm_env.mujoco.renderer import MuJoCoRenderer

        return MuJoCoRenderer(render_mode, WINDOW_FPS)
    from beltarm_env.rendering.renderer import Renderer

    return Renderer(render_mode, WINDOW_FPS)


def _choice(name: str, value: object, allowed: tuple[str, ...]) -> int:
    if value not in allowed:
        raise ValueError(f"{name} must be one of {', '.join(map(repr, allowed))}, got {value!r}")
    return allowed.index(str(value))


def whole(name: str, value: object, low: int, high: int) -> int:
    """Return an argument that must be a whole number within bounds, or raise ValueError."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not low <= value <= high:
        raise ValueError(f"{name} must be a whole number from {low} to {high}, got {value!r}")
    return int(value)


def _delays(given: object, count: int) -> Floats:
    """Check delays [samples], one number or one per arm, and return them in shape (count,)."""
    bound = f"from 0 to {at.MAX_DELAY}"
    try:
        array = np.asarray(given)
    except ValueError:
        array = np.empty(0, dtype=object)
    if array.dtype.kind not in "fiu":
        raise ValueError(f"delay must be a number of samples {bound}, got {given!r}")
    if array.shape not in ((), (count,)):
        raise ValueError(f"delay must be one number or have shape ({count},), got shape {array.shape}")
    delays = np.broadcast_to(array, (count,)).astype(np.float64)  # a copy: of the caller's too
    if not (inside := (delays >= 0) & (delays <= at.MAX_DELAY)).all():
        arm = int(np.argmin(inside))
        of_arm = f" for arm {arm}" if array.ndim else ""
        raise ValueError(f"delay must be a number of samples {bound}, got {delays[arm]:g}{of_arm}")
    return delays


@cache
def _spaces(sensors: str) -> tuple[spaces.Box[np.float32], spaces.Box[np.float32]]:
    """Spaces of observation and action that nobody draws from: copies of them share their arrays, half a kilobyte."""
    bounds = observation.bounds(sensors)
    both = spaces.Box(-bounds, bounds, dtype=np.float32), spaces.Box(-1.0, 1.0, (1,), np.float32)
    for of in both:
        for array in (of.low, of.high, of.bounded_below, of.bounded_above):
            array.flags.writeable = False
    return both


class ArmBatch:
    """State and settings of `num_arms` arms; see `BeltArmEnv` for the arguments."""

    def __init__(  # noqa: PLR0913  options by keyword
        self,
        num_arms: int,
        *,
        sensors: str,
        profile: str,
        model: str,
        randomization: Randomization,
        encoder_counts: int,
        delay: ArrayLike,
        moves: int,
        num_threads: int = 1,
        lanes: int = at.LANES,
    ) -> None:
        self.num_arms, self.lanes = num_arms, lanes
        self.num_threads = whole("num_threads", num_threads, 1, MAX_THREADS)
        self.rooms = new_rooms(self.num_threads, lanes)
        self.scratch, self.tile = self.rooms[0][0], self.rooms[1][0]
        self.tier = _choice("sensors", sensors, observation.SENSORS)
        self.profile = _choice("profile", profile, PROFILES)
        self.model_name = model
        self.model = model_of(model)
        self.num_moves = whole("moves", moves, 1, MOST_MOVES)
        self._bounds = shared_bounds(randomization, self.num_moves)
        check_integrable(fastest_arms(fastest_of_moves(self._bounds, self.num_moves)), self.model)
        self.resolution = 2 * np.pi / whole("encoder_counts", encoder_counts, 1, 10_000_000)
        self._num_real = 0
        self._substeps = 0  # integration steps per sample that were asked for; 0 for those that the arms need
        delays, real_drives = _delays(delay, num_arms), np.zeros(num_arms, np.bool_)
        self._setup = at.Setup(self.resolution, delays, real_drives, self.num_moves, self.profile, self.model)
        self.blocks = at.empty_blocks(num_arms, lanes)
        self.engine: Engine | None = None
        if model == "mujoco":
            from beltarm_env.mujoco.engine import MuJoCoArms

            self.engine = MuJoCoArms(num_arms)
            self.engine.check(self._bounds)
        self.table = np.tile(self._bounds[0], (num_arms, 1))
        observed, acted = _spaces(sensors)
        self.observation_space, self.action_space = copy(observed), copy(acted)

    def reset(self, arms: Integers, uniforms: Floats, options: Mapping[str, Any] | None) -> None:
        """Begin a new episode for some arms.

        Args:
            arms: Integers of the arms.
            uniforms: Draws in [0, 1), shape (len(arms), DRAWS).
            options: `params`, `move` and `state`, each a scalar or one value per arm; see `BeltArmEnv.reset`.

        Raises:
            ValueError: On an unknown name or a value that is not allowed; the arms are then left as they were.
            TypeError: If a value is not numeric.
        """
        options = checked_names("options", options, ("params", "move", "state"))
        params = options.get("params")
        params = asdict(params) if isinstance(params, ArmParams) else params
        given_params = checked_names("options['params']", params, FIELDS)
        given_move = checked_names("options['move']", options.get("move"), MOVE_FIELDS)
        count = len(arms)

        table = np.empty((count, len(FIELDS)))
        draw_table(self._bounds, uniforms, table)
        for name, value in given_params.items():
            column = checked_column(f"params[{name!r}]", value, count)
            for given in np.unique(column) if name in WHOLE else (column.min(), column.max()):
                checked_constant(name, float(given))
            table[:, FIELDS.index(name)] = column
        if given_params:
            check_integrable(fastest_of_moves(table, self.num_moves), self.model)
            if self.engine is not None:
                self.engine.check(table)

        given = np.full((count, 4), np.nan)
        for name, value in given_move.items():
            given[:, MOVE_FIELDS.index(name)] = column = checked_column(f"move[{name!r}]", value, count)
            if not np.isfinite(column).all():
                raise ValueError(f"move[{name!r}] must be finite, got {value!r}")
        moves = draw_moves(self.profile, uniforms[:, FIRST_OF_MOVE:END_OF_MOVE], given)
        if given_move:
            check_moves(self.profile, moves)

        states = np.full((count, 4), np.nan)
        if options.get("state") is not None:
            states = checked_states(options["state"], table[:, COLUMN.gear_ratio])
        self.table[arms] = table
        self._substeps = 0
        begin = at.for_lanes(begin_episodes, self.lanes)
        self._num_real += begin(self.blocks, arms, Beginnings(table, moves, states, uniforms), self._setup)
        if self.engine is not None:
            self.engine.begin(arms, table, self.states[arms])

    def restart(self, arms: Integers, streams: Streams) -> None:
        """Begin new random episodes for some arms, without options.

        Args:
            arms: Integers of the arms.
            streams: Random streams of all arms, of which theirs move on.
        """
        self._substeps = 0
        begin = at.for_lanes(restart_episodes, self.lanes)
        with wrapping():
            for low in range(0, len(arms), AT_ONCE):
                some = arms[low : low + AT_ONCE]
                self._num_real += begin(self.blocks, some, streams, self._bounds, self.table, self._setup)
        if self.engine is not None:
            self.engine.begin(arms, self.table[arms], self.states[arms])

    def next_moves(self, arms: Integers, uniforms: Floats) -> None:
        """Begin the next move of some arms, from the states that they have.

        Args:
            arms: Integers of the arms.
            uniforms: Draws in [0, 1), shape (len(arms), DRAWS).
        """
        begin = at.for_lanes(next_moves, self.lanes)
        self._num_real += begin(self.blocks, arms, uniforms, self._bounds, self.table, self._setup)
        if self._substeps:
            self.set_substeps(self._substeps)
        if self.engine is not None:
            self.engine.begin(arms, self.table[arms], None)

    def advance_in_engine(self, actions: Floats) -> None:
        """Move all arms by one control period in `engine`, where it is not the kernels that do.

        Args:
            actions: Torque over the torque limit, shape (num_arms,), cut to [-1, 1].
        """
        assert self.engine is not None, "the kernels move these arms"
        at.put_rows(self.blocks, at.STATE, self.engine.advance(np.clip(actions, -1.0, 1.0)))

    def set_substeps(self, substeps: int) -> None:
        """Replace the number of integration steps per sample that the arms need by another, until some are reset.

        Raises:
            ValueError: If it is not a whole number from 1 to `MAX_SUBSTEPS`, or another engine moves the arms.
        """
        if self.engine is not None:
            raise ValueError('model="mujoco" takes steps of its own: choose their number with "lumped" or "lagrangian"')
        count = whole("steps", substeps, 1, MAX_SUBSTEPS)
        at.put_rows(self.blocks, at.SUBSTEPS, np.full((self.num_arms, 1), float(count)))
        self._substeps = count

    def observe(self, observations: Singles, arms: Integers | None = None) -> None:
        """Write the observations of all arms, or of some, into `observations`, shape (num_arms, size)."""
        if arms is None:
            at.for_lanes(observe_arms, self.lanes)(self.blocks, self.tile, observations, self.step_settings)
        else:
            at.for_lanes(observe_some, self.lanes)(self.blocks, self.tile, observations, arms, self.step_settings)

    @property
    def real_drive(self) -> at.RealDrive:
        """Whether real drives are among the arms."""
        return REAL if self._num_real else IDEAL

    @property
    def step_settings(self) -> at.StepSettings:
        """What all arms have in common in a step."""
        return at.StepSettings(self.profile, self.tier, self.model, self.real_drive, self.engine is None)

    @property
    def states(self) -> Floats:
        """Copy of the states, shape (num_arms, 4)."""
        return at.rows(self.blocks, at.STATE, 4, self.num_arms)

    @property
    def motor_torques(self) -> Floats:
        """Torques of the motors now [N m], shape (num_arms,): what the drives have made of the commands."""
        if self.engine is not None:
            return self.engine.torques()
        rows = at.rows(self.blocks, at.REAL_DRIVE, 1, self.num_arms)[:, 0]
        commanded = at.rows(self.blocks, at.ACTION, 1, self.num_arms)[:, 0] * self.table[:, COLUMN.torque_limit]
        return np.where(rows > 0, at.rows(self.blocks, at.TORQUE, 1, self.num_arms)[:, 0], commanded)

    @property
    def moves(self) -> Floats:
        """Copy of the moves, shape (num_arms, 4), columns as `MOVE_FIELDS`."""
        return at.rows(self.blocks, at.MOVE, 4, self.num_arms)

    @property
    def steps(self) -> Floats:
        """Steps since each move's start, shape (num_arms,)."""
        return at.rows(self.blocks, at.STEP, 1, self.num_arms)[:, 0]

    @property
    def earlier_steps(self) -> Floats:
        """Steps of each episode before its move, shape (num_arms,)."""
        return at.rows(self.blocks, at.EARLIER, 1, self.num_arms)[:, 0]

    @property
    def move_numbers(self) -> Integers:
        """Number of each arm's move in its episode, from 0 on, shape (num_arms,)."""
        return (self.earlier_steps / EPISODE_STEPS).astype(np.intp)

    @property
    def times(self) -> Floats:
        """Time since each move's start [s], shape (num_arms,)."""
        return self.steps * CONTROL_PERIOD

    def tip_errors(self) -> Floats:
        """Tip minus reference tip: x, y [m] and their speeds [m/s], shape (num_arms, 4)."""
        errors = np.empty((self.num_arms, 4))
        at.for_lanes(tip_errors, self.lanes)(self.blocks, errors, self.profile, self.real_drive)
        return errors

    def params(self, arm: int) -> ArmParams:
        """Parameters of one arm."""
        return ArmParams.from_row(self.table[arm])

    def reference(self, arm: int, time: float) -> Reference:
        """Reference of one arm at its joint, `time` seconds into its move."""
        return Reference(*reference_at(self.profile, MoveShape(*self.moves[arm].tolist()), float(time)))

    def totals(self, arms: Integers, terminated: Flags) -> Floats:
        """Sum up the episodes of some arms: shape (len(TOTALS), num_arms), zero for the other arms."""
        totals = np.zeros((len(TOTALS), self.num_arms))
        at.for_lanes(episode_totals, self.lanes)(self.blocks, arms, terminated, totals)
        return totals

    def move_totals(self, arms: Integers) -> Floats:
        """Sum up the moves of some arms, which are over: shape (len(MOVE_TOTALS), num_arms), zero for the others."""
        totals = np.zeros((len(MOVE_TOTALS), self.num_arms))
        at.for_lanes(move_totals, self.lanes)(self.blocks, arms, totals)
        return totals
