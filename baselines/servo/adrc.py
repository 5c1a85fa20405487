"""Active disturbance rejection: an extended state observer of the motor's error from a flat motion.

All that the design model knows is fed forward: motion and torque of a smoothed move (`baselines.servo.flat`), and dry
friction. About it the motor is taken for nothing but an inertia M, behind a dead time T, and everything else for one
acceleration phi that the observer finds and the law cancels (Han 2009; about a flat motion: Sira-Ramírez, Luviano-
Juárez, Ramírez-Neria and Zurita-Bustamante 2017):

    e = theta_a - G theta_1,flat,    e'' = v(t - T) / M + phi,    tau_m = tau_flat + tau_f + v

**Observer**, from sample to sample, of z = [e; e'; phi] with phi held (Miklosovic, Radke and Gao 2006),

    z^- = F z + [h^2/2; h; 0] v_T / M,    z = z^- + L (e - z^-_1),    F = [1 h h^2/2; 0 1 h; 0 0 1]

where v_T is the mean of v(t - T) over the sample, of what the limit let through: a command that is on its way is no
disturbance (Zhao and Gao 2014). All three poles lie at b = exp(-w_o h), which takes

    L = [1 - b^3;  3/2 (1 - b)^2 (1 + b) / h;  (1 - b)^3 / h^2].

**Law**, with one bandwidth too (Gao 2003), both poles at -w_c:

    v = -M (w_c^2 z_1 + 2 w_c z_2 + phi)

**Friction.** A motor that sticks has phi = -v / M, which the observer would make larger and larger until it breaks
away. It may, where the motor is off its goal; where v is within the width that is not meant to break it away
(`baselines.models.friction`), the observer knows the motor to rest, and phi is held.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from baselines.gains import tunable
from baselines.models.flatness import CORNERS, SpreadGains, write_corners
from baselines.models.friction import FrictionGains, compensated
from baselines.models.linear import dead_time
from baselines.models.rigid_arm import inertia_at, motor_errors
from baselines.reading import Sample, move_of
from baselines.servo.flat import held_torque, joint_motion
from baselines.servo.pid import Servo, ServoDesign
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled, inlined
from beltarm_env.timing import MAX_LATENCY

_LATEST = dead_time(ArmParams(current_loop_time_constant=0.01, command_latency=MAX_LATENCY))
_MOST_PUSHES = int(_LATEST / CONTROL_PERIOD) + 1
_MOVE = slice(0, CORNERS)  # the smoothed move
ERROR, RATE, ACCELERATION, ADDED, HELD, PUSHES = range(CORNERS, CORNERS + 6)
"""Entries of the memory after the smoothed move: z [rad, rad/s, rad/s^2], torque beside v since the last sample [N m],
1 where the last push was not meant to break the motor away, and from `PUSHES` on v of the samples before, the latest
first [N m]."""


@dataclass(frozen=True)
class AdrcGains(FrictionGains, SpreadGains):
    """Smoothness of the move, and the two bandwidths."""

    rest_width: float = tunable(0.06, 0.0001, 0.3, log=True)  # [N m]  push compensated in full while at rest
    bandwidth: float = tunable(60.0, 2.0, 200.0, log=True)  # w_c  [rad/s]  of the law
    observer: float = tunable(15.0, 1.0, 1000.0, log=True)  # w_o  [rad/s]  of the observer


class ExtendedState(NamedTuple):
    """Estimates of the observer."""

    error: float  # z_1 [rad]
    rate: float  # z_2 [rad/s]
    acceleration: float  # phi [rad/s^2]


class ObserverGains(NamedTuple):
    """L: what the estimates take of an innovation."""

    error: float  # [-]
    rate: float  # [1/s]
    acceleration: float  # [1/s^2]


def observer_gains(bandwidth: float) -> ObserverGains:
    """Return L of an observer with all poles at exp(-bandwidth h), for w_o [rad/s]."""
    pole = float(np.exp(-bandwidth * CONTROL_PERIOD))
    gap = 1 - pole
    return ObserverGains(1 - pole**3, 1.5 * gap**2 * (1 + pole) / CONTROL_PERIOD, gap**3 / CONTROL_PERIOD**2)


@inlined
def observe(z: ExtendedState, acting: float, measured: float, gains: ObserverGains) -> ExtendedState:
    """Compute the estimates one sample later.

    Args:
        z: Those before it.
        acting: v_T / M over the sample [rad/s^2].
        measured: e at its end [rad].
        gains: L.
    """
    h = CONTROL_PERIOD
    pushed = z.acceleration + acting
    error = z.error + h * (z.rate + 0.5 * h * pushed)
    innovation = measured - error
    return ExtendedState(
        error + gains.error * innovation,
        z.rate + h * pushed + gains.rate * innovation,
        z.acceleration + gains.acceleration * innovation,
    )


@inlined
def feedback(z: ExtendedState, bandwidth: float) -> float:
    """Return v / M [rad/s^2] for estimates z and w_c [rad/s]."""
    return -(bandwidth * (bandwidth * z.error + 2 * z.rate) + z.acceleration)


class AdrcDesign(NamedTuple):
    """What the law knows."""

    servo: ServoDesign
    late: int  # whole samples of T
    rest: float  # what T is beyond them [samples]
    observer: ObserverGains


@inlined
def _observed(design: AdrcDesign, now: Sample, measured: float, inertia: float, memory: Floats) -> ExtendedState:
    """Estimates at this sample, from those and the pushes in the memory; the latter are moved on by a sample."""
    oldest = memory[PUSHES + design.late]
    for k in range(PUSHES + design.late, PUSHES, -1):
        memory[k] = memory[k - 1]
    memory[PUSHES] = now.last_command - memory[ADDED]
    newer = memory[PUSHES + design.late]
    acting = newer + design.rest * (oldest - newer)
    if memory[HELD] > 0.0 and now.motor_speed == 0.0:
        return ExtendedState(measured, 0.0, memory[ACCELERATION])
    z = ExtendedState(memory[ERROR], memory[RATE], memory[ACCELERATION])
    return observe(z, acting / inertia, measured, design.observer)


@compiled
def adrc_law(design: AdrcDesign, now: Sample, begins: bool, memory: Floats) -> float:
    """Motor torque [N m] for one arm, see `LawKernel`; the arm is taken to rest where a move begins."""
    servo, corners = design.servo, memory[_MOVE]
    plant, gains = servo.plant, servo.gains
    if begins:
        write_corners(move_of(now), plant, gains.first_spread, gains.spread, corners)
        memory[PUSHES:] = 0.0
    time = CONTROL_PERIOD * now.step
    later = time + servo.lead
    wanted, led = joint_motion(corners, time, plant), joint_motion(corners, later, plant)
    error, _ = motor_errors(now, wanted, plant.gear)
    inertia = inertia_at(wanted.angle, plant)
    if begins:
        z = ExtendedState(-error, 0.0, 0.0)
    else:
        z = _observed(design, now, -error, inertia, memory)
    push = inertia * feedback(z, gains.bandwidth)
    friction, direction = compensated(led, push, plant.gear, servo.compensation)
    added = held_torque(corners, later, plant) + friction
    memory[ERROR], memory[RATE], memory[ACCELERATION] = z.error, z.rate, z.acceleration
    memory[ADDED], memory[HELD] = added, 1.0 if abs(direction) < 1 else 0.0
    return added + push


class AdrcController(Servo):
    """Active disturbance rejection about a flat motion, on encoder observations."""

    gains_type = AdrcGains
    needs_vibration = True
    arm_law = staticmethod(adrc_law)
    memory_size = PUSHES + _MOST_PUSHES

    def _known(self) -> AdrcDesign:
        servo = super()._known()
        late, rest = divmod(servo.lead / CONTROL_PERIOD, 1.0)
        return AdrcDesign(servo, int(late), rest, observer_gains(self.gains.observer))
