"""Plausibility of the encoder: whether what it shows is a motor that is turned by the commanded torque.

The motor is predicted from sample to sample by the torque that acts on it, the command through a lag of about its dead
time, and the friction of the design model; most of all inertia is the motor's own, so belt and payload count as doubt.
A sample is plausible if the change of the angle is near the predicted one, or the angle itself is, as after samples
that were lost. The longer the last plausible one is ago, the farther it may be off:

    |change - omega T| <= step + n delta T    or    |theta_a - theta| <= step + 1/2 n (n + 1) delta T

with the predicted speed omega, n samples on, and the speed delta that an unknown torque brings in one.

The encoder is not believed any more

- after too many samples in a row that are not plausible: it sticks, or counts the other way round, while the motor
  turns,
- where the motor rests under a torque that breaks any motor away: it sticks, while the motor rested,
- where the motor's acceleration is against the torque, both averaged: it counts the other way round.
"""

from __future__ import annotations

from typing import NamedTuple

from baselines.guard.settings import GuardDesign
from beltarm_env import CONTROL_PERIOD
from beltarm_env.arrays import Floats
from beltarm_env.engine import inlined

# Places in the guard's memory.
ANGLE = 0  # shown at the last sample [rad]
PLACE = 1  # predicted from the last plausible samples [rad]
SPEED = 2  # [rad/s]
SHOWN_SPEED = 3  # by the last two samples [rad/s]
ACTING = 4  # torque that acts on the motor [N m]
UNSEEN = 5  # samples since the last plausible one
RESTED = 6  # samples for which the motor has rested under a large torque
BEYOND = 7  # torque beyond friction, averaged [N m]
SHOWN = 8  # torque that the acceleration shows, averaged [N m]
AGAINST = 9  # samples for which they have been opposite
ENCODER_SIZE = 10

_LAG = 0.6  # share by which the acting torque follows the command in a sample
_FOLLOW = 0.5  # share of a plausible speed in the prediction
_AVERAGED = 0.1  # share of the last sample in the averages
_GRIP = 2.5  # Coulomb's friction times this holds hardly any motor of the training ranges
_OPPOSITE = 0.3  # share of the torque that acceleration shows, with the other sign
_CERTAIN = 5  # samples
_HUGE = 1e9


class Seen(NamedTuple):
    """What the encoder's last sample is worth."""

    steady: bool  # whether its speed is plausible; if not, torques of this sample are not to be used
    plausible: bool  # whether its speed is, or its angle
    believed: bool  # whether the encoder is to be believed at all


@inlined
def finite(value: float) -> bool:
    """Whether a number is one, and not out of all proportion."""
    return abs(value) < _HUGE


@inlined
def begin_encoder(angle: float, memory: Floats) -> None:
    """Begin an episode, taken to rest at a motor angle [rad], with a memory of zeros."""
    if finite(angle):
        memory[ANGLE] = memory[PLACE] = angle


@inlined
def _predicted_speed(design: GuardDesign, speed: float, torque: float) -> float:
    """Speed of the motor a sample on [rad/s], which friction brings to rest and never turns round."""
    free = speed + design.per_torque * (torque - design.viscous * speed)
    most = design.per_torque * design.friction
    return free - min(max(free, -most), most)


@inlined
def watch_encoder(design: GuardDesign, angle: float, command: float, memory: Floats) -> Seen:
    """Judge the encoder's angle [rad] at a sample, after the last command [N m]."""
    memory[ACTING] += _LAG * (command - memory[ACTING])
    acting = memory[ACTING]
    speed = _predicted_speed(design, memory[SPEED], acting)
    place = memory[PLACE] + CONTROL_PERIOD * speed
    unseen = memory[UNSEEN] + 1.0
    shown = angle if finite(angle) else memory[ANGLE]
    change = shown - memory[ANGLE]
    doubt = CONTROL_PERIOD * design.doubt * unseen
    steady = finite(angle) and abs(change - CONTROL_PERIOD * speed) <= design.step + doubt
    near = finite(angle) and abs(shown - place) <= design.step + 0.5 * doubt * (unseen + 1.0)
    if steady:
        speed += _FOLLOW * (change / CONTROL_PERIOD - speed)
    seen = steady or near
    memory[PLACE] = shown if seen else place
    memory[SPEED] = speed
    memory[UNSEEN] = 0.0 if seen else unseen
    memory[ANGLE] = shown
    rests = change == 0.0 and abs(command) >= design.push
    memory[RESTED] = memory[RESTED] + 1.0 if rests else 0.0
    beyond = acting - min(max(acting, -_GRIP * design.friction), _GRIP * design.friction)
    memory[BEYOND] += _AVERAGED * (beyond - memory[BEYOND])
    acceleration = change / CONTROL_PERIOD - memory[SHOWN_SPEED]
    memory[SHOWN] += _AVERAGED * (acceleration / design.per_torque - memory[SHOWN])
    memory[SHOWN_SPEED] = change / CONTROL_PERIOD
    opposite = abs(memory[BEYOND]) > design.against and (
        memory[SHOWN] * memory[BEYOND] < -_OPPOSITE * memory[BEYOND] * memory[BEYOND]
    )
    memory[AGAINST] = memory[AGAINST] + 1.0 if opposite else 0.0
    believed = (
        memory[UNSEEN] < design.longest_loss and memory[RESTED] < design.longest_rest and memory[AGAINST] < _CERTAIN
    )
    return Seen(steady, seen, believed)
