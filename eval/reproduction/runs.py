"""Moves of the simulated arm with and without vibration feedback, under stated assumptions, and how much the tip rings.

Ringing is the root mean square of the tip's acceleration error, the two-dimensional distance from the acceleration of a
rigid arm on the reference: the signal of Figs. 4 and 8 with the move itself taken out. It hardly sees the slow return
of the position loop, which is no vibration.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines import PaperController
from baselines.servo.paper import PaperGains, PaperMemory
from beltarm_env import CONTROL_PERIOD, ArmParams, observation
from beltarm_env.arm import plant_of
from beltarm_env.physics.kinematics import reference_tip, tip_motion
from beltarm_env.physics.state import ArmState
from beltarm_env.rollout import Recording, rollout
from beltarm_env.task.moves import check_moves
from beltarm_env.task.reference import TRAPEZOID, MoveShape, reference_at
from beltarm_env.task.sensors import ENCODER_COUNTS
from eval.reproduction.loop import PAPER_ARM, ServoGains

Floats = NDArray[np.float64]
FrictionSign = Literal["reference", "measured", "none"]

END_WINDOW = 0.3
"""Length of the last phase [s]: what still rings at the end of the recording."""
_MEASURED = observation.size("encoder")
_UNLIMITED = 100.0  # torque limit [N m] at which the servo inside `AssumedServo` never saturates


@dataclass(frozen=True, slots=True)
class Assumptions:
    """What the paper leaves open."""

    arm: ArmParams = field(default_factory=ArmParams)
    known: ArmParams | None = None  # what the controller takes the arm to be; None: the arm itself
    friction_sign: FrictionSign = "reference"  # whose sign the friction compensation of (8a) has
    true_torsion: bool = False  # measured instead of simulated torsional velocity
    encoder_counts: int = ENCODER_COUNTS  # per motor revolution
    model: str = "lumped"  # whose equations of motion the arm has; the controller's simulation is always lumped


SIMULATED = Assumptions()
"""Table 1 with friction, and the belt's damping assumed."""
ANALYSED = Assumptions(arm=replace(PAPER_ARM, coulomb_friction=0.0))
"""As the paper's analysis has it: neither Coulomb friction nor belt damping, in arm and controller."""


class AssumedServo:
    """The paper's servo, eq. (11), with the two things that it leaves open: sign of friction and source of theta_s'.

    Sees the `full` sensors, of which the true torsional velocity is used only where that is assumed. Under the default
    assumptions it is `PaperController`.
    """

    def __init__(self, assumed: Assumptions, gains: PaperGains) -> None:
        known = assumed.known or assumed.arm
        self._assumed, self._k4, self._limit = assumed, gains.torsion_speed, assumed.arm.torque_limit
        self._coulomb_friction = known.coulomb_friction
        inside = replace(gains, torsion_speed=0.0) if assumed.true_torsion else gains
        self._servo = PaperController(replace(known, coulomb_friction=0.0, torque_limit=_UNLIMITED), inside)

    def predict(
        self,
        observation: NDArray[np.float32],
        state: PaperMemory | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], PaperMemory]:
        """Torque over its limit, shape (n, 1), for observations of shape (n, size); see `Controller`."""
        action, memory = self._servo.predict(observation[:, :_MEASURED], state, episode_start, deterministic)
        torque = action[:, 0].astype(np.float64) * _UNLIMITED
        if self._assumed.friction_sign != "none":
            moving = "reference_speed" if self._assumed.friction_sign == "reference" else "motor_speed"
            torque += self._coulomb_friction * np.sign(_entry(observation, moving))
        if self._assumed.true_torsion:
            torque -= self._k4 * _entry(observation, "torsion_speed")
        return np.clip(torque / self._limit, -1, 1).astype(np.float32)[:, None], memory


def _entry(seen: NDArray[np.float32], name: str) -> Floats:
    k = observation.index(name, "full")
    return seen[:, k].astype(np.float64) * observation.scales("full")[k]


def check_move(move: MoveShape) -> None:
    """Check that the environment allows a move.

    Raises:
        ValueError: Naming the value, the bound and what would do.
    """
    check_moves(TRAPEZOID, np.array([move], dtype=np.float64))


def is_allowed(move: MoveShape) -> bool:
    """Whether `check_move` lets a move pass."""
    try:
        check_move(move)
    except ValueError:
        return False
    return True


def run_moves(assumed: Assumptions, gains: ServoGains, moves: list[MoveShape]) -> Recording:
    """Run given moves side by side."""
    table = dict(zip(MoveShape._fields, np.array(moves).T, strict=True))
    return _run(assumed, gains, len(moves), 0, {"move": table})


def run_random_moves(assumed: Assumptions, gains: ServoGains, count: int, seed: int) -> Recording:
    """Run moves that the environment draws, the same for the same seed."""
    return _run(assumed, gains, count, seed, {})


def _run(assumed: Assumptions, gains: ServoGains, count: int, seed: int, options: dict[str, Any]) -> Recording:
    return rollout(
        AssumedServo(assumed, gains.feedback),
        count,
        seed=seed,
        options={"params": asdict(assumed.arm), **options},
        sensors="full",
        encoder_counts=assumed.encoder_counts,
        model=assumed.model,
    )


class Ringing(NamedTuple):
    """RMS acceleration error of the tip [m/s^2] in three phases, each of shape (n,); NaN where a phase is empty."""

    cruise: Floats  # while the reference speed is constant
    stop: Floats  # from the reference's stop to the end of the recording
    end: Floats  # the last `END_WINDOW` of the recording


PHASES = {
    "cruise": "during the cruise",
    "stop": "after the stop",
    "end": f"in the last {END_WINDOW:g} s",
}


def ringing(tip_velocity_error: Floats, durations: Floats, ramp_times: Floats) -> Ringing:
    """How much the tip rings.

    Args:
        tip_velocity_error: Shape (T, n, 2) [m/s], row k at (k + 1) control periods.
        durations: Of the moves [s], shape (n,).
        ramp_times: Of the moves [s], shape (n,).
    """
    acceleration = np.diff(tip_velocity_error, axis=0) / CONTROL_PERIOD
    square = np.sum(acceleration**2, axis=2)
    middle = (np.arange(len(square)) + 1.5)[:, None] * CONTROL_PERIOD
    last = (len(square) + 1) * CONTROL_PERIOD
    # The reference's acceleration jumps at its corners: differences across them are no ringing.
    windows = (
        (middle > ramp_times + CONTROL_PERIOD) & (middle < durations - ramp_times - CONTROL_PERIOD),
        middle > durations + CONTROL_PERIOD,
        (middle > last - END_WINDOW) & (middle > durations + CONTROL_PERIOD),
    )
    return Ringing(*(_rms(square, window) for window in windows))


def _rms(square: Floats, window: NDArray[np.bool_]) -> Floats:
    count = window.sum(axis=0)
    total = np.where(window, square, 0.0).sum(axis=0)
    return np.sqrt(np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0))


def ringing_of(recording: Recording) -> Ringing:
    """`ringing` of recorded moves; infinite where the arm left its workspace."""
    found = ringing(recording.tip_velocity_error, recording.moves[:, 2], recording.moves[:, 3])
    return Ringing(*(np.where(recording.finished, phase, np.inf) for phase in found))


@dataclass(frozen=True, slots=True)
class Response:
    """What the paper's figures show of one move; SI units, each of shape (T,). NaN once the arm left its workspace."""

    time: Floats
    motor_speed: Floats
    motor_speed_reference: Floats
    radial_speed: Floats  # r', of r = 2 l + l_3 - x
    radial_speed_reference: Floats  # of a rigid arm
    lateral_speed: Floats  # y'; the reference has none
    torque: Floats  # of the motor

    @property
    def radial_acceleration(self) -> Floats:
        """Acceleration of r; as in the paper the tachometer's r' differentiated."""
        return np.diff(self.radial_speed, prepend=0.0) / CONTROL_PERIOD

    @property
    def radial_acceleration_reference(self) -> Floats:
        """The same of a rigid arm."""
        return np.diff(self.radial_speed_reference, prepend=0.0) / CONTROL_PERIOD

    @property
    def lateral_acceleration(self) -> Floats:
        """Acceleration across the line of motion."""
        return np.diff(self.lateral_speed, prepend=0.0) / CONTROL_PERIOD

    @property
    def motor_speed_error(self) -> float:
        """RMS of the motor's speed error while the reference moves [rad/s]."""
        moving = self.motor_speed_reference != 0
        return float(np.sqrt(np.mean((self.motor_speed - self.motor_speed_reference)[moving] ** 2)))

    @property
    def peak_torque(self) -> float:
        """Largest torque of the motor [N m]."""
        return float(np.nanmax(np.abs(self.torque)))

    @property
    def stuck_share(self) -> float:
        """Share of the time after the reference's stop that the motor sticks."""
        after = self.time > self.time[np.flatnonzero(self.motor_speed_reference)[-1]]
        known = after & np.isfinite(self.motor_speed)
        return float(np.mean(self.motor_speed[known] == 0)) if known.any() else np.nan


def response(recording: Recording, episode: int = 0) -> Response:
    """The signals of one recorded move."""
    plant = plant_of(recording.params[episode])
    move = MoveShape(*recording.moves[episode].tolist())
    states = recording.state[:, episode]
    tips = np.array([tip_motion(ArmState(*row), plant) for row in states])
    there = np.where(recording.finished[episode] | (states != states[-1]).any(axis=1), 1.0, np.nan)
    references = [reference_at(TRAPEZOID, move, time) for time in recording.time]
    rigid = np.array([reference_tip(reference.angle, reference.speed, plant)[1] for reference in references])
    motor = plant.gear * np.array([reference.speed for reference in references])
    motion = (there * states[:, 1], motor, there * -tips[:, 2], -rigid, there * tips[:, 3])
    return Response(recording.time, *motion, there * recording.torque[:, episode])
