"""The industrial answer: a smoothed move's exact motion and torque fed forward, and a well-damped PID on the motor.

    tau_m = tau_flat(t + T + h/2) + tau_f + push
    push = M (K_p (e + K_i integral of e dt) + K_v e'),    e = G theta_1,flat(t) - theta_a

The corners of the task's trapezoid are spread, and state and torque of motor *and* belt along it follow in closed form
(`baselines.models.flatness`; Fliess, Lévine, Martin and Rouchon 1995). So the motor is not asked to follow the link's
reference, as under a rigid arm's torque, but to be ahead of it by the torsion that moves the link; then the belt is at
rest where the link is, as far as the arm is the design model. That a PD on the motors of robots with elastic joints
needs no state of the links is Tomei's (1991); fed forward with their flat motion and torque it is De Luca's (2000).

The servo is `baselines.servo.pid`: stiff where the motor's own encoder sees, blind to the belt. No observer, nothing to
be misled by an arm that is not the design model; but what rings then, rings on. The torque is the one in the middle of
the sample over which it is held, a dead time T later.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.gains import tunable
from baselines.models.flatness import Corners, SpreadGains, flat_motion, smoothed
from baselines.models.rigid_arm import Motion
from baselines.servo.pid import PidGains, PidServo
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arrays import Floats


@dataclass(frozen=True)
class FlatGains(PidGains, SpreadGains):
    """Smoothness of the move, and gains of the servo."""

    rest_width: float = tunable(0.06, 0.0001, 0.3, log=True)  # [N m]  push compensated in full while at rest


def joint_motion(corners: Corners, time: Floats, params: ArmParams) -> tuple[Motion, Floats]:
    """Motion of the joint along smoothed moves, and the motor torque of the sample that begins then [N m].

    Args:
        corners: Of n moves.
        time: Since their start [s], shape (n,).
        params: The arm.
    """
    flat, held = (flat_motion(corners, time + later, params) for later in (0.0, 0.5 * CONTROL_PERIOD))
    joint = np.column_stack([flat.state[:, :2], flat.acceleration]) / params.gear_ratio
    return Motion(*joint.T), held.torque


class FlatController(PidServo[Corners]):
    """PID about a flat motion.

    Args:
        gains: Of smoothing and servo.
        params: The design model.
    """

    def __init__(self, gains: FlatGains | None = None, params: ArmParams | None = None) -> None:
        self.gains = gains or FlatGains()
        super().__init__(self.gains, params)

    def plan(self, moves: Floats) -> Corners:
        """Smoothed moves, of shape (n, 4)."""
        return smoothed(moves, self.params, self.gains.first_spread, self.gains.spread)

    def motion(self, planned: Corners, start: Floats, time: Floats) -> tuple[Motion, Floats]:
        """Motion and torque along smoothed moves, see `PidServo`."""
        return joint_motion(planned, time, self.params)
