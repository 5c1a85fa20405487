"""PID along a reference that input shapers keep from ringing the belt.

A shaper replaces a command by several, delayed by t_i and weighted with A_i > 0, so that the vibrations that they start
cancel. Half a damped period T / 2 apart, with K = exp(-pi zeta / sqrt(1 - zeta^2)) the decay over it,

    A_i = c w_i K^i,    t_i = i T / 2,    sum of A_i = 1

    ZV   w = (1, 1)                         vibration is zero at the modelled mode
    ZVD  w = (1, 2, 1)                      and its derivative by the frequency too
    EI   w = (1 + V, 2 (1 - V), 1 + V)      it is V there, and zero at a frequency above and one below

(ZV, ZVD: Singer and Seering 1990; EI, extra-insensitive, with the vibration limit V: Singhose, Seering and Singer 1994,
exact for zeta = 0; with damping the vibration at the modelled mode is at most V.)

**Which mode.** The arm's frequency falls from 57 to 22 rad/s between 0 and 90 degrees. Accelerating excites the arm
where it is then, so the ramp up of the task's trapezoid is shaped for the mode at the start, and the ramp down for the
mode at the goal, where what is left goes on ringing. The motor is held by its servo, so the mode is that of a fixed
motor, see `baselines.models.modes`.

**What delays.** A shaper delays by d = sum of A_i t_i, 0.03 to 0.15 s, which counts in full against the task. But the
whole move is known ahead. So

- ramps of time t_r are shortened to t = t_r - 2 d, but not below `shortest_ramp` (nor lengthened): a shaped ramp then
  takes as long as the task's and has its centre where the task's has it;
- the ramp down begins as early as it must for that. The ramp up cannot begin before the move, and what is left of its
  delay is made up for by a higher speed between the two, which keeps the distance right.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from baselines.gains import tunable
from baselines.models.modes import Mode, held_modes
from baselines.models.ramps import Ramps
from baselines.servo.pid import PidGains, RampServo
from beltarm_env import ArmParams
from beltarm_env.arrays import Floats

Kind = Literal["zv", "zvd", "ei"]


@dataclass(frozen=True)
class ShapingGains(PidGains):
    """Gains of the servo, and of a ZV or ZVD shaper."""

    shortest_ramp: float = tunable(0.03, 0.002, 0.5, log=True)  # [s]  before shaping
    frequency: float = tunable(1.0, 0.5, 1.5)  # [-]  of the mode shaped for, over that of the nominal arm


@dataclass(frozen=True)
class ExtraInsensitiveGains(ShapingGains):
    """Gains of the servo, and of an EI shaper."""

    vibration: float = tunable(0.05, 0.0, 0.5)  # V  [-]  limit of the vibration, of the unshaped one


GAINS: dict[Kind, type[ShapingGains]] = {"zv": ShapingGains, "zvd": ShapingGains, "ei": ExtraInsensitiveGains}
"""Gains of each kind of shaper, by name."""


def shaper(kind: Kind, mode: Mode, vibration: float = 0.0) -> tuple[Floats, Floats]:
    """Weights A_i and delays t_i [s] of the impulses for n modes, each of shape (n, impulses).

    Args:
        kind: "zv", "zvd" or "ei".
        mode: Modes not to excite.
        vibration: V, for "ei" alone.
    """
    shares = {"zv": (1.0, 1.0), "zvd": (1.0, 2.0, 1.0), "ei": (1 + vibration, 2 * (1 - vibration), 1 + vibration)}
    number = np.arange(len(shares[kind]))
    weights = np.array(shares[kind]) * mode.decay[:, None] ** number
    return weights / weights.sum(axis=1, keepdims=True), 0.5 * mode.period[:, None] * number


class ShapingController(RampServo):
    """PID along a shaped trapezoid.

    Args:
        gains: Of servo and shaper, of the type that `GAINS` has for the kind.
        params: The design model.
        kind: "zv", "zvd" or "ei".

    Raises:
        ValueError: If there is no such kind of shaper.
        TypeError: If the gains are those of another kind.
    """

    def __init__(self, gains: ShapingGains | None = None, params: ArmParams | None = None, kind: Kind = "ei") -> None:
        if kind not in GAINS:
            raise ValueError(f"kind must be one of {', '.join(map(repr, GAINS))}, got {kind!r}")
        if gains is not None and type(gains) is not GAINS[kind]:
            raise TypeError(f"kind={kind!r} takes {GAINS[kind].__name__}, got {type(gains).__name__}")
        self.gains = gains or GAINS[kind]()
        self.kind: Kind = kind
        super().__init__(self.gains, params, smooth=False)

    def plan(self, moves: Floats) -> Ramps:
        """Ramps for moves of shape (n, 4): one up and one down for each impulse of the shaper."""
        start, goal, duration, ramp = moves.T
        up, up_delays, up_time, up_centre = self._shaped(start, ramp)
        down, down_delays, down_time, down_centre = self._shaped(goal, ramp)
        begin = np.maximum(0.5 * ramp - up_centre, 0.0)
        brake = duration - 0.5 * ramp - down_centre
        cruise = (goal - start) / (brake + down_centre - begin - up_centre)
        return Ramps(
            np.column_stack([begin[:, None] + up_delays, brake[:, None] + down_delays]),
            np.column_stack([np.tile(up_time, (up.shape[1], 1)).T, np.tile(down_time, (down.shape[1], 1)).T]),
            cruise[:, None] * np.column_stack([up, -down]),
        )

    def _shaped(self, angle: Floats, ramp: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Weights and delays of a ramp's impulses, its time before shaping, and its centre after, from its onset."""
        mode = held_modes(self.params, angle)
        vibration = self.gains.vibration if isinstance(self.gains, ExtraInsensitiveGains) else 0.0
        weights, delays = shaper(self.kind, Mode(mode.period / self.gains.frequency, mode.decay), vibration)
        delay = (weights * delays).sum(axis=1)
        time = np.minimum(ramp, np.maximum(ramp - 2 * delay, self.gains.shortest_ramp))
        return weights, delays, time, delay + 0.5 * time
