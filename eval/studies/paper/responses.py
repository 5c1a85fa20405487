"""Motor and tip over time, the signals of the paper's Figs. 4 and 8."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltarm_env import CONTROL_PERIOD
from beltarm_env.arm import plant_of
from beltarm_env.physics.kinematics import reference_tip, tip_motion
from beltarm_env.physics.state import ArmState
from beltarm_env.rollout import Recording
from beltarm_env.task.reference import TRAPEZOID, MoveShape, reference_at
from eval.studies.paper.ringing import END_WINDOW
from eval.studies.paper.runs import AS_ANALYSED, FRICTION, STANDARD, TO_0

Floats = NDArray[np.float64]
_LAST = round(END_WINDOW / CONTROL_PERIOD)
_RADIAL = ("motor_speed", "radial_speed", "radial_acceleration")
SIGNALS = {
    (STANDARD, FRICTION): _RADIAL,
    (STANDARD, AS_ANALYSED): _RADIAL,
    (TO_0, FRICTION): ("motor_speed", "radial_speed", "lateral_speed", "lateral_acceleration"),
}
"""Signals that are drawn over time, by place and conditions."""


@dataclass(frozen=True, slots=True)
class Response:
    """Signals of one move; SI units, each of shape (T,). NaN once the arm left its workspace."""

    time: Floats
    motor_speed: Floats
    motor_speed_reference: Floats
    radial_speed: Floats  # r', of r = 2 l + l_3 - x
    radial_speed_reference: Floats  # of a rigid arm
    lateral_speed: Floats  # y'; the reference has none
    torque: Floats  # of the motor

    def signal(self, name: str) -> Floats:
        """A speed by its name; or an acceleration, as in the paper the tachometer's speed differentiated."""
        if "acceleration" not in name:
            return getattr(self, name)
        return np.diff(getattr(self, name.replace("acceleration", "speed")), prepend=0.0) / CONTROL_PERIOD

    def summary(self) -> dict[str, float]:
        """Numbers of the tables: velocities peak to peak at the end, errors of the motor, torque, share of sticking."""
        moving = self.motor_speed_reference != 0
        after = self.time > self.time[np.flatnonzero(moving)[-1]]
        known = after & np.isfinite(self.motor_speed)
        return {
            "radial_pp": np.ptp(self.radial_speed[-_LAST:]),
            "lateral_pp": np.ptp(self.lateral_speed[-_LAST:]),
            "motor_speed_error": np.sqrt(np.mean((self.motor_speed - self.motor_speed_reference)[moving] ** 2)),
            "cruising_speed": np.abs(self.motor_speed_reference).max(),
            "peak_torque": np.nanmax(np.abs(self.torque)),
            "stuck_share": np.mean(self.motor_speed[known] == 0) if known.any() else np.nan,
        }


def response(recording: Recording, episode: int = 0) -> Response:
    """Signals of one recorded move."""
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
