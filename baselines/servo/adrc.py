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

from baselines.controller import ClassicalController
from baselines.gains import tunable
from baselines.models.actuator import dead_time
from baselines.models.flatness import Corners, SpreadGains, smoothed
from baselines.models.friction import FrictionGains, commanded_direction, dry_friction, friction_level
from baselines.models.rigid_arm import RigidArm, motor_errors
from baselines.reading import Reading, chosen, last_share
from baselines.servo.flat import joint_motion
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arrays import Flags, Floats


@dataclass(frozen=True)
class AdrcGains(FrictionGains, SpreadGains):
    """Smoothness of the move, and the two bandwidths."""

    rest_width: float = tunable(0.06, 0.0001, 0.3, log=True)  # [N m]  push compensated in full while at rest
    bandwidth: float = tunable(60.0, 2.0, 200.0, log=True)  # w_c  [rad/s]  of the law
    observer: float = tunable(15.0, 1.0, 1000.0, log=True)  # w_o  [rad/s]  of the observer


class ExtendedState(NamedTuple):
    """Estimates of n arms, each of shape (n,)."""

    error: Floats  # z_1 [rad]
    rate: Floats  # z_2 [rad/s]
    acceleration: Floats  # phi [rad/s^2]


def observer_gains(bandwidth: float) -> tuple[float, float, float]:
    """Return L of an observer with all poles at exp(-bandwidth h)."""
    pole = np.exp(-bandwidth * CONTROL_PERIOD)
    gap = 1 - pole
    return 1 - pole**3, 1.5 * gap**2 * (1 + pole) / CONTROL_PERIOD, gap**3 / CONTROL_PERIOD**2


def observe(z: ExtendedState, acting: Floats, measured: Floats, bandwidth: float) -> ExtendedState:
    """Compute the estimates one sample later.

    Args:
        z: Those before it.
        acting: v_T / M over the sample [rad/s^2], shape (n,).
        measured: e at its end [rad], shape (n,).
        bandwidth: w_o [rad/s].
    """
    h, gains = CONTROL_PERIOD, observer_gains(bandwidth)
    pushed = z.acceleration + acting
    error = z.error + h * (z.rate + 0.5 * h * pushed)
    innovation = measured - error
    return ExtendedState(
        error + gains[0] * innovation,
        z.rate + h * pushed + gains[1] * innovation,
        z.acceleration + gains[2] * innovation,
    )


def feedback(z: ExtendedState, bandwidth: float) -> Floats:
    """Return v / M [rad/s^2] for estimates z and w_c [rad/s]."""
    return -(bandwidth * (bandwidth * z.error + 2 * z.rate) + z.acceleration)


@dataclass(frozen=True)
class AdrcMemory:
    """Memory from sample to sample."""

    corners: Corners  # of the smoothed move
    state: ExtendedState
    pushes: Floats  # v of the samples before the last one, the latest first [N m], shape (n, whole samples of T + 1)
    added: Floats  # torque beside v since the last sample [N m], shape (n,)
    held: Flags  # whether the last push was not meant to break the motor away, shape (n,)


class AdrcController(ClassicalController[AdrcMemory]):
    """Active disturbance rejection about a flat motion, on encoder observations.

    Args:
        gains: Smoothness and bandwidths.
        params: The design model.
    """

    def __init__(self, gains: AdrcGains | None = None, params: ArmParams | None = None) -> None:
        super().__init__(params)
        self.gains = gains or AdrcGains()
        self._arm = RigidArm(self.params)
        self._row = self.params.row()
        self._lead = dead_time(self.params)

    def law(self, reading: Reading, begins: Flags, memory: AdrcMemory | None) -> tuple[Floats, AdrcMemory]:
        """Torque [N m] of one sample, see `ClassicalController`."""
        p, gains = self.params, self.gains
        corners = self._smoothed(memory.corners if memory else None, begins, reading.move)
        time = CONTROL_PERIOD * reading.step.astype(np.float64)
        wanted, _ = joint_motion(corners, time, p)
        led, torque = joint_motion(corners, time + self._lead, p)
        inertia = self._arm.inertia(wanted.angle)
        state, pushes = self._observed(memory, begins, reading, -motor_errors(reading, wanted, p)[0], inertia)
        push = inertia * feedback(state, gains.bandwidth)
        direction = commanded_direction(led, push, gains.rest_width)
        added = torque + gains.friction * friction_level(dry_friction(self._row), p.gear_ratio * led.speed) * direction
        return added + push, AdrcMemory(corners, state, pushes, added, np.abs(direction) < 1)

    def _observed(
        self, memory: AdrcMemory | None, begins: Flags, now: Reading, measured: Floats, inertia: Floats
    ) -> tuple[ExtendedState, Floats]:
        """Estimates at this sample, and the pushes that later ones need; at rest where an episode begins."""
        whole, rest = divmod(self._lead / CONTROL_PERIOD, 1.0)
        at_rest = ExtendedState(measured, np.zeros_like(measured), np.zeros_like(measured))
        if memory is None:
            return at_rest, np.zeros((len(begins), int(whole) + 1))
        last = last_share(now, memory.added, begins)
        pushes = np.column_stack([last, np.where(begins[:, None], 0.0, memory.pushes)])
        acting = pushes[:, int(whole)] + rest * (pushes[:, int(whole) + 1] - pushes[:, int(whole)])
        found = observe(memory.state, acting / inertia, measured, self.gains.observer)
        stuck = memory.held & (now.motor_speed == 0.0)
        resting = at_rest._replace(acceleration=np.where(begins, 0.0, memory.state.acceleration))
        state = ExtendedState(*(chosen(begins | stuck, *pair) for pair in zip(resting, found, strict=True)))
        return state, pushes[:, :-1]

    def _smoothed(self, corners: Corners | None, begins: Flags, moves: Floats) -> Corners:
        """Smoothed moves, with new ones for arms that begin an episode."""
        if corners is not None and not begins.any():
            return corners
        new = smoothed(moves, self.params, self.gains.first_spread, self.gains.spread)
        return new if corners is None else Corners(*(chosen(begins, *pair) for pair in zip(new, corners, strict=True)))
