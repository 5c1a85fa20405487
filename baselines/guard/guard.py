"""The guard: the command of one sample, from the torques of all that could drive the motor.

    level 0    learned    base + residual
    level 1    base       the residual is no number, out of its range, or at its limit for too long
    level 2    servo      the observer's innovations say that the arm is none it knows, or it begins anew; a sample is
                          lost, or no motor can have made it; or the base's torque is no number
    level 3    passive    the encoder is not believed any more, or neither base nor servo gives a number where the
                          servo is asked for: no torque; friction stops the motor

    tau = (1 - p) ((1 - s) clip(base + r residual) + s clip(servo)),    clip to the torque limit

The weights r, s and p are between 0 and 1 and move linearly, so that nothing jumps where the guard decides; the command
changes by no more than the slew limit in a sample. It goes down at once, and back after a while of good behaviour,
which doubles with every fall from level 0; not from level 3, which lasts for the rest of the move: no loop that is
closed around an encoder that lies is safe. Where there is no servo, the base keeps the motor: level 2 is then without
residual alone.

While a single sample is not plausible, or its torque is no number, the last command is held.
"""

from __future__ import annotations

from typing import NamedTuple

from baselines.guard.encoder import ENCODER_SIZE, Seen, begin_encoder, finite, watch_encoder
from baselines.guard.settings import GuardDesign
from beltarm_env.arrays import Flags, Floats
from beltarm_env.engine import compiled, inlined

# Places in the guard's memory, after the encoder's.
LEVEL = ENCODER_SIZE
GOOD = LEVEL + 1  # samples of good behaviour
WAIT = GOOD + 1  # samples of it that it takes to return
LEARNED = WAIT + 1  # r, weight of the residual
SERVO = LEARNED + 1  # s, weight of the servo
PASSIVE = SERVO + 1  # p, weight of no torque
RESIDUAL = PASSIVE + 1  # last one that was a number within its range [N m]
SATURATED = RESIDUAL + 1  # samples for which it has been at its limit
SURPRISE = SATURATED + 1  # w at the last sample
CHANGED = SURPRISE + 1  # 1 where the command is not that of base and residual, else 0
ASKS = CHANGED + 1  # 1 where the next sample needs the servo's torque, else 0; it begins where the last one did not
GUARD_SIZE = ASKS + 1

LEARNED_LEVEL, BASE_LEVEL, SERVO_LEVEL, PASSIVE_LEVEL = 0.0, 1.0, 2.0, 3.0


class GuardInputs(NamedTuple):
    """What the guard is given at a sample."""

    base: float  # torque of the base [N m]
    residual: float  # that is to be added to it [N m]
    servo: float  # torque of the servo [N m]; not a number where it was not asked, see `ASKS`
    motor_angle: float  # by the encoder [rad]
    surprise: float  # w of the observer; 1 where there is none
    last_command: float  # [N m]


@inlined
def _moved(weight: float, towards: float, most: float) -> float:
    return weight + min(max(towards - weight, -most), most)


@inlined
def _residual_level(design: GuardDesign, residual: float, memory: Floats) -> float:
    """Level that the residual allows; a good one is kept, to be faded out should the next be bad."""
    if not abs(residual) <= design.residual:
        return BASE_LEVEL
    memory[RESIDUAL] = residual
    limited = design.saturated > 0.0 and abs(residual) >= design.saturated
    memory[SATURATED] = memory[SATURATED] + 1.0 if limited else 0.0
    return BASE_LEVEL if memory[SATURATED] > design.longest_saturation else LEARNED_LEVEL


@inlined
def _observer_level(design: GuardDesign, surprise: float, memory: Floats) -> float:
    """Level that the observer's innovations allow; a filter that has begun anew says w = 1 exactly."""
    anew = surprise == 1.0 and memory[SURPRISE] != 1.0
    memory[SURPRISE] = surprise
    allowed = design.calm if memory[LEVEL] >= SERVO_LEVEL else design.surprise
    return LEARNED_LEVEL if abs(surprise) <= allowed and not anew else SERVO_LEVEL


@inlined
def _decide(design: GuardDesign, level: float, memory: Floats) -> None:
    """Go down to a level at once, or back up to it after a while."""
    if level > memory[LEVEL]:
        if memory[LEVEL] == LEARNED_LEVEL:
            memory[WAIT] = min(max(2.0 * memory[WAIT], float(design.wait)), float(design.longest_wait))
        memory[LEVEL] = level
        memory[GOOD] = 0.0
    elif level == memory[LEVEL] or memory[LEVEL] == PASSIVE_LEVEL:
        memory[GOOD] = 0.0
    else:
        memory[GOOD] += 1.0
        if memory[GOOD] >= memory[WAIT]:
            memory[LEVEL] = level
            memory[GOOD] = 0.0


@inlined
def _fade(design: GuardDesign, servo: bool, memory: Floats) -> None:
    """Move the weights towards those of the level; the servo's only where it has given a torque."""
    level = memory[LEVEL]
    memory[LEARNED] = _moved(memory[LEARNED], 1.0 if level == LEARNED_LEVEL else 0.0, design.fade)
    if servo or level < SERVO_LEVEL:
        memory[SERVO] = _moved(memory[SERVO], 1.0 if level >= SERVO_LEVEL else 0.0, design.fade)
    memory[PASSIVE] = _moved(memory[PASSIVE], 1.0 if level == PASSIVE_LEVEL else 0.0, design.stop)


@inlined
def _mixed(design: GuardDesign, now: GuardInputs, last: float, memory: Floats) -> float:
    """Torque of all tiers by their weights, within the limit [N m]; of what is no number nothing is used."""
    has_base, has_servo = finite(now.base), finite(now.servo)
    share = memory[SERVO] if has_base else 1.0
    servo = min(max(now.servo, -design.limit), design.limit) if has_servo else last
    base = now.base + memory[LEARNED] * memory[RESIDUAL] if has_base else last
    base = min(max(base, -design.limit), design.limit)
    return (1.0 - memory[PASSIVE]) * ((1.0 - share) * base + share * servo)


@inlined
def guarded_torque(design: GuardDesign, now: GuardInputs, begins: bool, anew: bool, memory: Floats) -> float:
    """Command of one sample [N m].

    Args:
        design: What is constant.
        now: What could drive the motor, and what is measured.
        begins: Whether a move begins, when all tiers begin anew.
        anew: Whether an episode does, with the motor at rest: the encoder is watched from then on, over all its moves.
        memory: Of shape (GUARD_SIZE,), written.
    """
    last = now.last_command if finite(now.last_command) else 0.0
    if anew:
        memory[:] = 0.0
        begin_encoder(now.motor_angle, memory)
        seen = Seen(True, True, True)
    else:
        seen = watch_encoder(design, now.motor_angle, last, memory)
    if begins or anew:
        passive = 0.0 if seen.believed else memory[PASSIVE]
        memory[ENCODER_SIZE:] = 0.0
        memory[LEARNED] = memory[SURPRISE] = 1.0
        memory[PASSIVE] = passive
    of_residual = _residual_level(design, now.residual, memory)
    of_observer = _observer_level(design, now.surprise, memory)
    level = max(of_residual, of_observer)
    if not seen.plausible or not finite(now.base):
        level = max(level, SERVO_LEVEL)
    nothing = memory[ASKS] != 0.0 and not finite(now.base) and not finite(now.servo)
    if nothing or not seen.believed:
        level = PASSIVE_LEVEL
    _decide(design, level, memory)
    _fade(design, finite(now.servo), memory)
    unguarded = now.base + now.residual
    if memory[PASSIVE] == 0.0 and not seen.steady:
        torque = last
    else:
        torque = _mixed(design, now, last, memory)
    torque = min(max(torque, last - design.slew), last + design.slew)
    torque = min(max(torque, -design.limit), design.limit)
    unchanged = memory[LEARNED] == 1.0 and memory[SERVO] == 0.0 and memory[PASSIVE] == 0.0 and seen.steady
    within = abs(min(max(unguarded, -design.limit), design.limit) - last) <= design.slew
    memory[CHANGED] = 0.0 if unchanged and within else 1.0
    memory[ASKS] = 1.0 if memory[SERVO] > 0.0 or memory[LEVEL] == SERVO_LEVEL else 0.0
    return torque


@compiled
def guard_arms(
    design: GuardDesign, inputs: Floats, begins: Flags, anew: Flags, memory: Floats, torques: Floats
) -> None:
    """Guard n arms.

    Args:
        design: Of all of them.
        inputs: Columns as `GuardInputs`, shape (n, 6).
        begins: Which arms begin a move, shape (n,).
        anew: Which of them begin an episode, shape (n,).
        memory: Shape (n, GUARD_SIZE), written.
        torques: The commands [N m], shape (n,), written.
    """
    for arm in range(len(torques)):
        now = GuardInputs._make(inputs[arm, k] for k in range(6))
        torques[arm] = guarded_torque(design, now, begins[arm], anew[arm], memory[arm])
