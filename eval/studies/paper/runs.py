"""Moves of the simulated arm under the paper's servo, the ringing of its tip, and its signals over time.

Ringing is the root mean square of the tip's acceleration error, the two-dimensional distance from the acceleration of a
rigid arm on the reference: the signal of Figs. 4 and 8 with the move itself taken out. It hardly sees the slow return
of the position loop, which is no vibration.
"""

from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

import numpy as np

from baselines import PaperController
from baselines.reading import read
from baselines.servo.paper import PaperGains
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arm import params_columns, plant_of
from beltarm_env.arrays import Flags, Floats, Singles
from beltarm_env.physics.kinematics import reference_tip, tip_motion
from beltarm_env.physics.state import ArmState
from beltarm_env.rollout import Recording, rollout
from beltarm_env.task.reference import TRAPEZOID, MoveShape, reference_at
from beltarm_env.task.seeds import SeedRange
from beltarm_env.task.sensors import ENCODER_COUNTS
from eval.studies.paper.linear import PAPER_ARM, TABLE_2, ServoGains

FrictionSign = Literal["reference", "measured", "none"]

END_WINDOW = 0.3
"""Length of the last phase [s]: what still rings at the end of the recording."""
PHASES = {"cruise": "during the cruise", "stop": "after the stop", "end": f"in the last {END_WINDOW:g} s"}
"""Phases of a move: constant reference speed, from the reference's stop on, and `END_WINDOW`."""
REMOVED, REDUCED = 0.1, 0.8
"""Ratios to the ringing without vibration feedback below which it counts as removed and as reduced."""
ANSWERS = ("yes", "in part", "no", "not comparable")
_UNLIMITED = 100.0  # torque limit [N m] at which the servo inside `AssumedServo` never saturates


@dataclass(frozen=True, slots=True)
class Conditions:
    """Arm, and settings of the servo that the paper does not print."""

    arm: ArmParams = field(default_factory=ArmParams)
    known: ArmParams | None = None  # what the controller takes the arm to be; None: the arm itself
    friction_sign: FrictionSign = "reference"  # whose sign the friction compensation of (8a) has
    true_torsion: bool = False  # measured instead of simulated torsional velocity
    encoder_counts: int = ENCODER_COUNTS  # per motor revolution
    model: str = "lumped"  # whose equations of motion the arm has; the controller's simulation is always lumped


SIMULATED = Conditions()
"""Table 1 with friction, and the belt's damping assumed."""
ANALYSED = Conditions(arm=replace(PAPER_ARM, coulomb_friction=0.0))
"""As the paper's analysis has it: neither Coulomb friction nor belt damping, in arm and controller."""
STANDARD, TO_0 = "standard", "to 0°"
PLACES = {STANDARD: MoveShape(np.pi / 4, np.pi / 2, 0.8, 0.12), TO_0: MoveShape(np.pi / 4, 0.0, 0.8, 0.12)}
"""Moves by place: the standard move, and one as long that ends at 0 degrees."""
FRICTION, AS_ANALYSED = "with friction", "as analysed"
MEASURED = "as analysed, torsion measured"
FULL, FULL_ANALYSED = "full arm, with friction", "full arm, as analysed"
MAIN = {FRICTION: SIMULATED, AS_ANALYSED: ANALYSED}
"""The two sets of conditions around which everything else is varied."""
BOTH_ARMS = {**MAIN, FULL: replace(SIMULATED, model="lagrangian"), FULL_ANALYSED: replace(ANALYSED, model="lagrangian")}
"""Conditions of the random moves."""
VIEWS = {**MAIN, MEASURED: replace(ANALYSED, true_torsion=True), **BOTH_ARMS}
"""Conditions of the standard move and of the one to 0 degrees."""


_RADIAL = ("motor_speed", "radial_speed", "radial_acceleration")
SIGNALS = {
    (STANDARD, FRICTION): _RADIAL,
    (STANDARD, AS_ANALYSED): _RADIAL,
    (TO_0, FRICTION): ("motor_speed", "radial_speed", "lateral_speed", "lateral_acceleration"),
}
"""Signals of `signals_of` that are drawn over time, by place and conditions."""


class AssumedServo:
    """The paper's servo, eq. (11), with the assumed sign of friction and source of theta_s'.

    Sees the `full` sensors, of which the true torsional velocity is used only where that is assumed. Under the default
    conditions it is `PaperController`.
    """

    def __init__(self, conditions: Conditions, gains: PaperGains) -> None:
        known = conditions.known or conditions.arm
        self._conditions, self._k4, self._limit = conditions, gains.torsion_speed, conditions.arm.torque_limit
        self._coulomb_friction = known.coulomb_friction
        inside = replace(gains, torsion_speed=0.0) if conditions.true_torsion else gains
        self._servo = PaperController(replace(known, coulomb_friction=0.0, torque_limit=_UNLIMITED), inside)

    def predict(
        self,
        observation: Singles,
        state: Floats | None = None,
        episode_start: Flags | None = None,
        deterministic: bool = True,
    ) -> tuple[Singles, Floats]:
        """Torque over its limit, shape (n, 1), for observations of shape (n, size); see `Controller`."""
        action, memory = self._servo.predict(observation, state, episode_start, deterministic)
        torque, reading = action[:, 0].astype(np.float64) * _UNLIMITED, read(observation, self._servo.params, "full")
        if self._conditions.friction_sign != "none":
            reference = self._conditions.friction_sign == "reference"
            torque += self._coulomb_friction * np.sign(reading.reference_speed if reference else reading.motor_speed)
        if self._conditions.true_torsion and reading.torsion is not None:
            torque -= self._k4 * reading.torsion[:, 1]
        return np.clip(torque / self._limit, -1, 1).astype(np.float32)[:, None], memory


def run_moves(
    conditions: Conditions, gains: ServoGains, moves: list[MoveShape] | SeedRange, arms: Floats | None = None
) -> Recording:
    """Run given moves side by side, or those that the environment draws from each of some seeds.

    With `arms`, columns as `ArmParams`, each move has an arm of its own; the controller still takes it for the
    conditions' one.
    """
    options: dict[str, Any] = {"params": asdict(conditions.arm) if arms is None else params_columns(arms)}
    if isinstance(moves, SeedRange):
        seed, count = moves
    else:
        seed, count = 0, len(moves)
        options["move"] = dict(zip(MoveShape._fields, np.array(moves).T, strict=True))
    return rollout(
        AssumedServo(conditions, gains.feedback),
        count,
        seed=seed,
        options=options,
        sensors="full",
        encoder_counts=conditions.encoder_counts,
        model=conditions.model,
    )


def ringing(tip_velocity_error: Floats, durations: Floats, ramp_times: Floats) -> Floats:
    """Measure ringing in the error of the tip's velocity.

    Args:
        tip_velocity_error: Shape (T, n, 2) [m/s], row k at (k + 1) control periods.
        durations: Of the moves [s], shape (n,).
        ramp_times: Of the moves [s], shape (n,).

    Returns:
        RMS acceleration error of the tip [m/s^2], shape (len(PHASES), n); NaN where a phase is empty.
    """
    square = np.sum((np.diff(tip_velocity_error, axis=0) / CONTROL_PERIOD) ** 2, axis=2)
    middle = (np.arange(len(square)) + 1.5)[:, None] * CONTROL_PERIOD
    last = (len(square) + 1) * CONTROL_PERIOD
    # The reference's acceleration jumps at its corners: differences across them are no ringing.
    stopped = middle > durations + CONTROL_PERIOD
    cruising = (middle > ramp_times + CONTROL_PERIOD) & (middle < durations - ramp_times - CONTROL_PERIOD)
    windows = np.array([cruising, stopped, stopped & (middle > last - END_WINDOW)])
    count, total = windows.sum(axis=1), np.where(windows, square, 0.0).sum(axis=1)
    return np.sqrt(np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0))


def ringing_of(recording: Recording) -> Floats:
    """`ringing` of recorded moves, infinite where the arm left its workspace."""
    phases = ringing(recording.tip_velocity_error, recording.moves[:, 2], recording.moves[:, 3])
    return np.where(recording.finished, phases, np.inf)


def suppression(conditions: Conditions, moves: list[MoveShape] | SeedRange) -> Floats:
    """Ringing of moves without and with vibration feedback, shape (2, len(PHASES), n)."""
    return np.array([ringing_of(run_moves(conditions, gains, moves)) for gains in TABLE_2.without_and_with])


def ratios(pair: Floats) -> Floats:
    """Values with vibration feedback over those without, for a pair of both.

    Infinite where the arm left its workspace with vibration feedback only, NaN where there is nothing to compare with:
    the phase is empty, or the arm left its workspace without.
    """
    before, after = pair
    comparable = np.isfinite(before) & (before > 0)
    return np.divide(after, before, out=np.full(before.shape, np.nan), where=comparable)


def answer(ratio: float) -> str:
    """Whether vibration feedback removes ringing, by its ratio at the end of the recording; one of `ANSWERS`."""
    if np.isnan(ratio):
        return "not comparable"
    return "yes" if ratio < REMOVED else "in part" if ratio < REDUCED else "no"


def signals_of(recording: Recording, episode: int = 0) -> dict[str, Floats]:
    """Signals of Figs. 4 and 8 of one recorded move by name, SI units, shape (T,); NaN once the arm left its workspace.

    Those of a rigid arm on the reference end in `_reference`. Accelerations are differences of speeds, as in the paper.
    """
    plant, move = plant_of(recording.params[episode]), MoveShape(*recording.moves[episode].tolist())
    states = recording.state[:, episode]
    tips = np.array([tip_motion(ArmState(*row), plant, None) for row in states])
    there = np.where(recording.finished[episode] | (states != states[-1]).any(axis=1), 1.0, np.nan)
    references = [reference_at(TRAPEZOID, move, time) for time in recording.time]
    signals = {
        "time": recording.time,
        "motor_speed": there * states[:, 1],
        "motor_speed_reference": plant.gear * np.array([reference.speed for reference in references]),
        "radial_speed": there * -tips[:, 2],  # r', of r = 2 l + l_3 - x
        "radial_speed_reference": np.array([-reference_tip(ref.angle, ref.speed, plant)[1] for ref in references]),
        "lateral_speed": there * tips[:, 3],  # y'; the reference has none
        "torque": there * recording.torque[:, episode],
    }
    for name in ("radial_speed", "radial_speed_reference", "lateral_speed"):
        signals[name.replace("speed", "acceleration")] = np.diff(signals[name], prepend=0.0) / CONTROL_PERIOD
    return signals


def summary(signals: dict[str, Floats]) -> dict[str, float]:
    """Numbers of one move: error and cruising speed of the motor, peak of its torque, share of sticking at the end."""
    time, speed, reference = (signals[name] for name in ("time", "motor_speed", "motor_speed_reference"))
    moving = reference != 0
    known = (time > time[moving][-1]) & np.isfinite(speed)
    return {
        "motor_speed_error": np.sqrt(np.mean((speed - reference)[moving] ** 2)),
        "cruising_speed": np.abs(reference).max(),
        "peak_torque": np.nanmax(np.abs(signals["torque"])),
        "stuck_share": np.mean(speed[known] == 0) if known.any() else np.nan,
    }
