"""What the paper does not print, what is taken instead, and the range over which its conclusion is tried."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltarm_env import ArmParams
from beltarm_env.reference import MoveShape
from eval.reproduction.loop import ServoGains
from eval.reproduction.runs import Assumptions, Ringing, is_allowed, ringing_of, run_moves

Floats = NDArray[np.float64]

CLEAR = 0.8
"""Ringing is called reduced below this ratio to that without vibration feedback, and increased above its inverse."""
USUAL_MOVE = MoveShape(np.pi / 4, np.pi / 2, 0.8, 0.12)
"""The standard move where no other is asked for."""
_RAMP_TIMES = (0.08, 0.10, 0.16, 0.20, 0.25, 0.30)
_LENGTHENED = (0.8, 1.25, 1.5)


def effect(ratio: float) -> str:
    """What a ratio of ringing with to ringing without vibration feedback means, in a word."""
    if np.isnan(ratio):
        return "not there"
    return "reduced" if ratio < CLEAR else "increased" if ratio > 1 / CLEAR else "unchanged"


@dataclass(frozen=True, slots=True)
class Variant:
    """One value of an assumption."""

    label: str
    assumed: Assumptions
    move: MoveShape


@dataclass(frozen=True, slots=True)
class Open:
    """One thing that the paper leaves open, with values to try beside the one taken."""

    name: str
    printed: str  # what the paper says about it
    taken: str
    why: str
    variants: list[Variant]


class Compared(NamedTuple):
    """Ringing of the same moves without and with vibration feedback."""

    without: Ringing
    suppressed: Ringing

    def ratio(self, phase: str) -> float:
        """With over without for the first move; NaN where the phase is empty or there is nothing to compare with."""
        return float(self.ratios(phase)[0])

    def ratios(self, phase: str) -> Floats:
        """The same for all moves."""
        before, after = getattr(self.without, phase), getattr(self.suppressed, phase)
        comparable = np.isfinite(before) & (before > 0)
        return np.divide(after, before, out=np.full(before.shape, np.nan), where=comparable)


def compare(assumed: Assumptions, gains: ServoGains, move: MoveShape) -> Compared:
    """Run one move without and with vibration feedback."""
    pair = (ringing_of(run_moves(assumed, of_run, [move])) for of_run in (replace(gains, k4=0.0), gains))
    return Compared(*pair)


def open_questions(standard: MoveShape) -> list[Open]:
    """Everything assumed, varied one at a time around the standard move."""
    return [*_of_the_move(standard), *_of_the_arm(standard), *_of_the_servo(standard)]


def _of_the_move(standard: MoveShape) -> list[Open]:
    ramps = [(f"ramps {ramp:g} s", standard._replace(ramp_time=ramp)) for ramp in _RAMP_TIMES]
    durations = [
        (
            f"move of {factor * standard.duration:.3g} s",
            standard._replace(duration=factor * standard.duration, ramp_time=factor * standard.ramp_time),
        )
        for factor in _LENGTHENED
    ]
    length = abs(standard.goal - standard.start)
    places = [
        ("backwards: start and goal swapped", standard._replace(start=standard.goal, goal=standard.start)),
        ("the same length, to 0°", standard._replace(start=length, goal=0.0)),
        ("the same length, from 0°", standard._replace(start=0.0, goal=length)),
    ]
    return [
        Open(
            "ramp time of the trapezoid",
            "a trapezoid, no times",
            f"{standard.ramp_time:g} s",
            _reason(standard, "ramp_time", "short against the belt's period, as its visible ringing suggests"),
            _allowed(ramps, standard),
        ),
        Open(
            "duration of the move",
            "nothing",
            f"{standard.duration:g} s",
            _reason(standard, "duration", "two periods of cruise, three after the stop"),
            _allowed(durations, standard),
        ),
        Open(
            "where the move leads",
            "poles are placed for 90°",
            f"{_degrees(standard.start)} to {_degrees(standard.goal)}",
            _reason(standard, "goal", "it ends at the angle analysed"),
            _allowed(places, standard),
        ),
    ]


def _of_the_arm(standard: MoveShape) -> list[Open]:
    def of_arm(label: str, **changes: float) -> Variant:
        return Variant(label, Assumptions(arm=ArmParams(**changes)), standard)

    def unknown(label: str, **changes: float) -> Variant:
        return Variant(label, Assumptions(arm=ArmParams(**changes), known=ArmParams()), standard)

    return [
        Open(
            "M2(90°)",
            "M2(0°) = 0.01 kg m² only",
            "0.07 kg m²",
            "link 2 as a uniform rod with M2(0°) has 0.48 kg",
            [
                of_arm("M2(90°) 0.04 kg m²", arm_inertia_swing=0.03),
                of_arm("M2(90°) 0.10 kg m²", arm_inertia_swing=0.09),
                of_arm("payload 0.2 kg: 0.12 kg m²", payload_mass=0.2),
                unknown("M2(90°) 0.05, taken for 0.07", arm_inertia_swing=0.04),
                unknown("M2(90°) 0.09, taken for 0.07", arm_inertia_swing=0.08),
            ],
        ),
        Open(
            "Coulomb friction",
            "0.032 N m; neglected in the analysis",
            "0.032 N m, set-valued: the motor sticks",
            "Table 1",
            [
                of_arm("no Coulomb friction", coulomb_friction=0.0),
                of_arm("Coulomb friction × 0.7", coulomb_friction=0.7 * 0.032),
                of_arm("Coulomb friction × 1.3", coulomb_friction=1.3 * 0.032),
            ],
        ),
        Open(
            "belt damping ratio",
            "none in the model",
            "1 %",
            "belts have 0.5 to 5 %",
            [of_arm("belt damping 0", belt_damping_ratio=0.0), of_arm("belt damping 5 %", belt_damping_ratio=0.05)],
        ),
        Open(
            "torque limit",
            "nothing",
            "0.3 N m",
            "a rigid 90° in 0.7 s needs 0.25 N m",
            [of_arm("torque limit 0.15 N m", torque_limit=0.15), of_arm("torque limit 0.6 N m", torque_limit=0.6)],
        ),
        Open(
            "length l3 of the hand",
            "nothing",
            "0.10 m",
            "a plausible gripper",
            [of_arm("hand 0 m", hand_length=0.0), of_arm("hand 0.20 m", hand_length=0.20)],
        ),
    ]


def _of_the_servo(standard: MoveShape) -> list[Open]:
    def of_servo(label: str, **changes: Any) -> Variant:
        return Variant(label, Assumptions(**changes), standard)

    return [
        Open(
            "sign of the friction compensation",
            "no law",
            "that of the reference speed",
            "known without noise",
            [
                of_servo("compensated by measured speed", friction_sign="measured"),
                of_servo("friction not compensated", friction_sign="none"),
            ],
        ),
        Open(
            "torsional velocity",
            "from a simulation of the arm",
            "simulated from encoder data",
            "as printed",
            [of_servo("torsion measured exactly", true_torsion=True)],
        ),
        Open(
            "encoder",
            "a rotary encoder",
            "4000 counts per revolution",
            "1000 lines, four edges each",
            [
                of_servo("encoder 1000 counts", encoder_counts=1000),
                of_servo("encoder 100 000 counts", encoder_counts=100_000),
            ],
        ),
    ]


def _reason(standard: MoveShape, name: str, usual: str) -> str:
    """Why a value of the standard move is what it is."""
    return usual if np.isclose(getattr(standard, name), getattr(USUAL_MOVE, name)) else "as asked for"


def _degrees(angle: float) -> str:
    return f"{np.degrees(angle):.0f}°"


def _allowed(named: list[tuple[str, MoveShape]], standard: MoveShape) -> list[Variant]:
    """Variants of the move that the environment allows and that differ from the standard one."""
    return [Variant(name, Assumptions(), move) for name, move in named if move != standard and is_allowed(move)]


def run_all(questions: list[Open], gains: ServoGains) -> dict[str, list[Compared]]:
    """Run every variant; by name of the open question, in the order of its variants."""
    return {
        question.name: [compare(variant.assumed, gains, variant.move) for variant in question.variants]
        for question in questions
    }
