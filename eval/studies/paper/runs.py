"""Moves of the simulated arm under the paper's servo, with everything that the paper does not print stated."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from baselines import PaperController
from baselines.reading import read
from baselines.servo.paper import PaperGains
from beltarm_env import ArmParams
from beltarm_env.arm import params_columns
from beltarm_env.arrays import Floats
from beltarm_env.rollout import Recording, rollout
from beltarm_env.task.moves import check_moves
from beltarm_env.task.reference import TRAPEZOID, MoveShape
from beltarm_env.task.seeds import SeedRange
from beltarm_env.task.sensors import ENCODER_COUNTS
from eval.studies.paper.linear import PAPER_ARM, ServoGains

FrictionSign = Literal["reference", "measured", "none"]

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
"""Places of the moves: the standard move, and one as long that ends at 0 degrees."""
FRICTION, AS_ANALYSED = "with friction", "as analysed"
MEASURED = "as analysed, torsion measured"
FULL, FULL_ANALYSED = "full arm, with friction", "full arm, as analysed"
MAIN = {FRICTION: SIMULATED, AS_ANALYSED: ANALYSED}
"""The two sets of conditions around which everything else is varied."""
BOTH_ARMS = {**MAIN, FULL: replace(SIMULATED, model="lagrangian"), FULL_ANALYSED: replace(ANALYSED, model="lagrangian")}
"""Conditions of the random moves."""
VIEWS = {**MAIN, MEASURED: replace(ANALYSED, true_torsion=True), **BOTH_ARMS}
"""Conditions of the standard move and of the one to 0 degrees."""


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
        observation: NDArray[np.float32],
        state: Floats | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], Floats]:
        """Torque over its limit, shape (n, 1), for observations of shape (n, size); see `Controller`."""
        action, memory = self._servo.predict(observation, state, episode_start, deterministic)
        torque, reading = action[:, 0].astype(np.float64) * _UNLIMITED, read(observation, self._servo.params, "full")
        if self._conditions.friction_sign != "none":
            reference = self._conditions.friction_sign == "reference"
            torque += self._coulomb_friction * np.sign(reading.reference_speed if reference else reading.motor_speed)
        if self._conditions.true_torsion and reading.torsion is not None:
            torque -= self._k4 * reading.torsion[:, 1]
        return np.clip(torque / self._limit, -1, 1).astype(np.float32)[:, None], memory


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


def run_moves(
    conditions: Conditions, gains: ServoGains, moves: list[MoveShape] | SeedRange, arms: Floats | None = None
) -> Recording:
    """Run given moves side by side, or those that the environment draws from each of some seeds.

    Args:
        conditions: Arm and servo.
        gains: Of the servo.
        moves: What to run.
        arms: An arm for each move in place of the conditions' one, which the controller goes on taking them for;
            columns as `ArmParams`, shape (n, len(FIELDS)).
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
