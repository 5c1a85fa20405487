"""`BeltArm-v0`: the belt-driven arm as a Gymnasium environment."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any, ClassVar, Literal, cast

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from beltarm_env import observation
from beltarm_env.arguments import Arguments
from beltarm_env.arm import ArmParams
from beltarm_env.arrays import Floats, Singles
from beltarm_env.batch import ArmBatch, new_renderer
from beltarm_env.engine import bound
from beltarm_env.info import MOVE_TOTALS
from beltarm_env.kernels.layout import RealDrive, for_lanes
from beltarm_env.kernels.step import HUGE, step_arm
from beltarm_env.observation import Sensors
from beltarm_env.physics.models import ModelName
from beltarm_env.task.draws import DRAWS
from beltarm_env.task.moves import MOVE_FIELDS
from beltarm_env.task.ranges import Randomization
from beltarm_env.task.reference import Profile, Reference
from beltarm_env.task.sensors import ENCODER_COUNTS
from beltarm_env.timing import CONTROL_PERIOD, EPISODE_STEPS

_ARM = np.array([0])


def _checked(action: object) -> Any:
    """Return the action as the kernel reads it, itself if it is so already, or raise ValueError."""
    try:
        array = np.asarray(action)
    except ValueError:
        array = np.empty(0)
    if array.shape != (1,) or array.dtype.kind not in "fiu":
        raise ValueError(f"action must be one number in an array of shape (1,), got {action!r}") from None
    if not -HUGE < array.item() < HUGE:
        raise ValueError(f"action must be finite, got {action!r}") from None
    return np.require(array, np.float32 if array.dtype.char == "f" else np.float64, "A")


class BeltArmEnv(Arguments, gym.Env[Singles, Singles]):  # pyright: ignore[reportIncompatibleVariableOverride]
    """Belt-driven handling robot: move the arm's end along a reference without making it ring.

    ## Description

    A DC motor turns joint 1 through an 88:1 harmonic drive; a timing belt couples the second link so that the arm's end
    moves along a line. The belt is elastic, so the end vibrates, and the motor is subject to Coulomb friction, so it
    sticks. Plant, parameters and controller structure are from Morimoto et al., "Vibration Suppression of Handling
    Robot with Timing Belts Based on Two-mass Model". One step is one sample of the paper's controller, 1.5 ms.

    ## Action Space

    `Box(-1, 1, (1,), float32)`: motor torque over the torque limit (0.3 N m), held for the step. Values outside are
    cut; those that are not finite, or beyond 1e300, raise.

    ## Observation Space

    A flat `Box` of measured and known quantities, each divided by a scale to be of order 1 and cut at a bound. Names,
    units, scales and bounds are in `beltarm_env.observation.ENTRIES`; `beltarm_env.observation.decode` turns a vector
    into physical units.

    | Num | Entry | Scale | Bound | Unit |
    |---|---|---|---|---|
    | 0 | motor angle error, reference minus encoder | 1.5 | 200 | rad |
    | 1 | motor speed error | 8 | 2000 | rad/s |
    | 2 | motor speed, by differencing the encoder | 100 | 2000 | rad/s |
    | 3 | motor angle by the encoder | 100 | 200 | rad |
    | 4, 5 | sine and cosine of twice that angle | 1 | 1 | - |
    | 6 | reference joint angle | 1 | 2 | rad |
    | 7 | reference joint speed | 1 | 20 | rad/s |
    | 8 | reference joint acceleration | 10 | 200 | rad/s² |
    | 9–13 | reference speed 30, 60, 120, 200, 400 ms ahead | 1 | 20 | rad/s |
    | 14–18 | reference acceleration 30, 60, 120, 200, 400 ms ahead | 10 | 200 | rad/s² |
    | 19, 20 | start and goal of the move | 1 | 2 | rad |
    | 21 | duration of the move | 1 | 2 | s |
    | 22 | ramp time of the move | 0.2 | 2 | s |
    | 23 | time since the move's start | 1 | 2 | s |
    | 24 | torque commanded in the last step, over its limit | 1 | 1 | - |
    | 25 | whether the gripper holds a part (`payload_mass` above 0): 1 or 0 | 1 | 1 | - |
    | 26 | `sensors="tip"`: speed of the tip along x | 0.2 | 20 | m/s |
    | 26, 27 | `sensors="full"`: belt torsion; its rate | 0.05; 1 | 2; 200 | rad; rad/s |
    | 26, 27 | `sensors="accelerometer"`: acceleration of the tip along and across the hand | 10 | 80 | m/s² |

    ## Rewards

    Minus the cost `min(|e_p| / 10 mm, 10) + min(|e_v| / 200 mm/s, 10) + 0.1 |Δτ| / limit` with the 2-D tip position
    and velocity errors. Leaving the workspace is charged the bound of the cost for every step that is left of all
    moves, also where `max_episode_steps` is less.

    ## Starting State

    At rest at the start of a random move: from and to anywhere in 0–90°, at least 15°, in 0.5 to 1.2 s.

    ## A Shift of Several Moves

    An episode has `moves` moves of 1200 steps (1.8 s) each, 1 by default. A further move begins in the step that ends
    the one before, whose observation is its first. It starts at the last goal, and from the state that the arm is in:
    nothing comes to rest, no command or measurement is lost, and arm and drive are the same. Every other move, from the
    first one on, carries a part whose mass is drawn anew; the ways back are empty. Friction drifts on from where it has
    got to, within 0.8 and 1.25 times what it was at first. `params`, `move`, `time` and `reference(t)` are those of the
    present move, and `move_number` counts it from 0 on.

    ## Episode End

    Truncated after the last move, 1200 steps for each, or sooner with
    `gymnasium.make("BeltArm-v0", max_episode_steps=…)`. Terminated when joint or arm angle leaves −14.3° to 104.3°. The
    last step may be both.

    ## Information

    Every step: `tip_error` [m], at most 1e6, `cost_position`, `cost_velocity`, `cost_torque_rate`. And of the episode
    until now: `total_cost` with its terms, `episode_steps`, `tip_error_rms` and `tip_error_max` [m]. A batch of arms
    tells these where an episode ends. With the last step of each move: `move_cost`, `move_tip_error_rms` and
    `move_tip_error_max` [m], `move_vibration` [m], the peak-to-peak tip error after the move's end along x or y,
    whichever is larger (in a comparison, of both together less the trend), and `move_still_time` [s], from the move's
    end until the tip error stays within 0.5 mm, or all that is left of the move.

    ## Arguments

    See `__init__`; for example `gymnasium.make("BeltArm-v0", randomization="train", profile="scurve")`.

    ## References

    S. Morimoto, K. Fukuda, Y. Takeda, T. Hirasa: Vibration Suppression of Handling Robot with Timing Belts Based on
    Two-mass Model.
    """

    metadata: ClassVar[dict[str, Any]] = {  # pyright: ignore[reportIncompatibleVariableOverride]
        "render_modes": ["human", "rgb_array"],
        "render_fps": round(1 / CONTROL_PERIOD),  # of who draws every step, as Gymnasium's recorder does
    }

    def __init__(  # noqa: PLR0913  options by keyword
        self,
        *,
        sensors: Sensors = "encoder",
        profile: Profile = "trapezoid",
        model: ModelName = "lumped",
        randomization: Randomization = "off",
        encoder_counts: int = ENCODER_COUNTS,
        delay: float = 0,
        moves: int = 1,
        render_mode: Literal["human", "rgb_array"] | None = None,
    ) -> None:
        """Create the environment.

        Args:
            sensors: "encoder" as in the paper's drive; "tip" adds the tip's speed; "full" adds the true torsion;
                "accelerometer" adds the tip's acceleration as a MEMS part measures it (`task.accelerometer`).
            profile: Shape of the reference: "trapezoid" (the paper's), "scurve" or "quintic". `rollout` refuses the
                others to controllers that rebuild the trapezoid: all of `baselines` but "paper" and "rigid".
            model: The plant: "lumped", the paper's two-mass model; "lagrangian", the full two-link arm; "mujoco", the
                full arm moved and drawn by MuJoCo (extra `mujoco`), which cannot express all effects of a drive and
                refuses those of "train".
            randomization: "off", the paper's arm; "ideal", arms that vary behind an ideal drive (`IDEAL_RANGES`);
                "train", arms and drives that vary (`TRAIN_RANGES`; with several moves `SHIFT_RANGES`); or a mapping
                from `ArmParams` field to (low, high).
            encoder_counts: Counts per motor revolution.
            delay: Samples by which encoder, tachometer and accelerometer lag, 0 to 2; it need not be whole.
            moves: Moves of an episode, 1 to 1000. Several are a working shift (`task.shift`): with a word as
                `randomization` parts weigh 0.05 to 0.5 kg, and with "train" motors give before they slip, too.
            render_mode: "human" for a window, "rgb_array" for frames, None for neither.

        Raises:
            ValueError: If an argument is unknown or out of range.
            TypeError: If `randomization` is neither a word nor a mapping of pairs.
        """
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(f"render_mode must be None or one of {self.metadata['render_modes']}, got {render_mode!r}")
        arguments: dict[str, Any] = {
            "sensors": sensors,
            "profile": profile,
            "model": model,
            "randomization": randomization,
            "encoder_counts": encoder_counts,
            "delay": delay,
            "moves": moves,
        }
        self._batch = ArmBatch(1, **arguments, lanes=1)
        self._hold(**arguments, render_mode=render_mode)
        self.observation_space = self._batch.observation_space
        self.action_space = self._batch.action_space
        self._max_episode_steps = EPISODE_STEPS * self.num_moves
        self._size = observation.size(sensors)
        self._ready = False  # reset at least once
        self._move_ends = 0.0  # steps of the episode after which its move is over
        self._running = False  # within an episode
        self._step_arm: Callable[..., Any] | None = None  # for the drive of the arm of the episode that runs
        self._steps: dict[RealDrive, Callable[..., Any]] = {}  # for each drive that an episode had
        self._renderer = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Singles, dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: Seed of `np_random`, from which parameters and move are drawn.
            options: What to fix instead of drawing it: `params`, an `ArmParams` or a mapping of some of its fields;
                `move`, a mapping of `start`, `goal` [rad], `duration`, `ramp_time` [s]; `state`, x at the start
                (default: at rest at the move's start; a state does not choose the move, so give its start too). Of an
                episode of several moves, `move`, `payload_mass` and `friction_drift` are the first one's.

        Raises:
            ValueError: On an unknown name or a value out of range.
            TypeError: If a value is not a number.
        """
        before = None if options is None else copy.deepcopy((self._np_random, self._np_random_seed))
        super().reset(seed=seed)
        try:
            self._batch.reset(_ARM, self.np_random.random((1, DRAWS)), options)
        except Exception:
            if before is not None:
                self._np_random, self._np_random_seed = before  # what was refused has drawn nothing
            raise
        self._ready = self._running = True
        self._step_arm, self._move_ends = None, float(EPISODE_STEPS)
        result = np.empty((1, self._size), np.float32)
        self._batch.observe(result)
        if self._renderer is not None:
            self._renderer.clear()
        if self._render_mode == "human":
            self.render()
        return result[0], {}

    def step(self, action: Singles) -> tuple[Singles, float, bool, bool, dict[str, Any]]:
        """Hold a torque for one control period.

        Args:
            action: Torque over the torque limit, shape (1,); cut to [-1, 1].

        Raises:
            ResetNeeded: Before the first reset, or after the episode's end.
            ValueError: If the action has another shape or is not finite.
        """
        step_arm = self._step_arm or self._prepared()
        try:
            result = step_arm(action)
        except (TypeError, ValueError):
            given = _checked(action)
            if given is action:
                raise  # what failed is not the action
            result = step_arm(given)
        over, info = result[2] or result[3], result[4]
        if info["episode_steps"] == self._move_ends:
            info |= self._end_move(result[0], over)
        if over:
            self._running, self._step_arm = False, None
        if self._render_mode and self._render_mode == "human":  # twice, since most have none: that is quicker
            self.render()
        return result

    def _end_move(self, result: Singles, over: bool) -> dict[str, float]:
        """Sum up the move that is over, begin the next one unless the episode is over too, and observe it."""
        totals = self._batch.move_totals(_ARM)[:, 0].tolist()
        if not over:
            self._batch.next_moves(_ARM, self.np_random.random((1, DRAWS)))
            self._batch.observe(result.reshape(1, -1))
            self._move_ends += EPISODE_STEPS
            if self._renderer is not None:
                self._renderer.clear()
            self._step_arm = None  # its drift may be the first effect of an ideal drive, or was the last of a real one
        return dict(zip(MOVE_TOTALS, totals, strict=True))

    def _prepared(self) -> Callable[..., Any]:
        """Return what steps the arm of the episode that runs, prepared once for every drive."""
        if not self._running:
            raise ResetNeeded("no episode is running: call reset() before step()")
        real_drive = self._batch.real_drive
        if real_drive not in self._steps:
            self._steps[real_drive] = self._step_for_drive()
        self._step_arm = self._steps[real_drive]
        return self._step_arm

    def _step_for_drive(self) -> Callable[..., Any]:
        """Return the kernel behind what is the same in all steps."""
        batch = self._batch
        same = batch.blocks, batch.scratch, batch.tile, batch.step_settings
        observed = bound(for_lanes(step_arm, batch.lanes), same, 0.0, like=np.empty(self._size, np.float32))

        def moved_by_engine(action: Singles) -> Any:
            given = _checked(action)
            batch.advance_in_engine(given.astype(np.float64))
            return observed(given)

        return observed if batch.engine is None else moved_by_engine

    def __getstate__(self) -> dict[str, Any]:
        """What a copy is made of: machine code cannot be copied."""
        return {**self.__dict__, "_step_arm": None, "_steps": {}}

    def render(self) -> NDArray[np.uint8] | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Draw the arm: a frame of shape (height, width, 3), or None after updating the window."""
        if self.render_mode is None:
            gym.logger.warn('render() does nothing without a render mode: make("BeltArm-v0", render_mode="rgb_array")')
            return None
        if not self._ready:
            raise ResetNeeded("there is no arm to draw yet: call reset() before render()")
        if self._renderer is None:
            mode = cast("Any", self.render_mode)
            self._renderer = new_renderer(self._batch.model_name, mode)
        return self._renderer.draw(self.params, self.state, self.reference(self.time).angle, self.time)

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    @property
    def state(self) -> Floats:
        """Copy of the true state x = [theta_a, omega_a, theta_s, omega_s] (rad, rad/s), float64."""
        return self._batch.states[0]

    @property
    def motor_torque(self) -> float:
        """True torque of the motor now [N m], ripple not counted: what the drive has made of the commands."""
        return float(self._batch.motor_torques[0])

    @property
    def params(self) -> ArmParams:
        """Physical constants of the arm in this move."""
        return self._batch.params(0)

    @property
    def move(self) -> dict[str, float]:
        """The move: start, goal [rad], duration, ramp_time [s]."""
        return dict(zip(MOVE_FIELDS, self._batch.moves[0].tolist(), strict=True))

    @property
    def move_number(self) -> int:
        """Number of the move in its episode, from 0 on."""
        return int(self._batch.move_numbers[0])

    @property
    def time(self) -> float:
        """Time since the move's start [s]."""
        return float(self._batch.times[0])

    def set_integration_steps(self, steps: int) -> None:
        """Integrate this episode with another number of steps per control period, as convergence studies do.

        Raises:
            ValueError: If it is not a whole number from 1 to 400, or MuJoCo moves the arm.
            ResetNeeded: Before the first reset.
        """
        self._batch.set_substeps(steps)
        if not self._ready:
            raise ResetNeeded("reset() chooses the number of steps: call it before set_integration_steps()")

    def reference(self, time: float) -> Reference:
        """Reference joint angle [rad], speed [rad/s] and acceleration [rad/s^2], `time` s after the move's start."""
        return self._batch.reference(0, time)
