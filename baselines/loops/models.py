"""Linear loops at 1.5 ms: law, arm behind its drive, open and closed poles.

The only measurement is the motor's angle, from which the speed is differenced; the torque of the last sample is what
the controller itself asked for. So with P the sampled arm and C the law there is one loop,

    L(z) = -C(z) P(z),    S = 1 / (1 + L),

and cutting it at the plant's input, the command, is cutting it at the encoder. P has the drive as it is built: current
loop, latency and torque constant (`beltarm_env.physics.sampled`). Where all three are zero it is the ideal motor's.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.loops.laws import Law, law_of
from baselines.models.linear import ANGLES
from beltarm_env import CONTROL_PERIOD, ArmParams, sampled_state_space
from beltarm_env.arrays import Floats

Poles = NDArray[np.complex128]


class System(NamedTuple):
    """A linear system from one input to one output: x+ = A x + b u, y = c x + d u; leading axes of all are the same."""

    a: Floats  # (..., m, m)
    b: Floats  # (..., m)
    c: Floats  # (..., m)
    d: Floats  # (...)


class Loop(NamedTuple):
    """A loop: what is cut is the command between law and arm; leading axes of both broadcast."""

    law: System  # C, from motor angle [rad] to command [N m]
    arm: System  # P, back


def stacked(systems: Sequence[System]) -> System:
    """Systems along a new first axis; the smaller ones get states that nothing depends on."""
    size = max(system.a.shape[-1] for system in systems)
    return System(*(np.stack(parts) for parts in zip(*(_padded(system, size) for system in systems), strict=True)))


def _padded(system: System, size: int) -> System:
    more, front = (0, size - system.a.shape[-1]), [(0, 0)] * system.d.ndim
    b, c = (np.pad(part, [*front, more]) for part in (system.b, system.c))
    return System(np.pad(system.a, [*front, more, more]), b, c, system.d)


def sampled_arm(params: ArmParams, theta_1: float, model: str = "lumped") -> System:
    """The arm behind its drive at a joint angle [rad], from command [N m] to motor angle [rad].

    Args:
        params: The arm.
        theta_1: Joint angle [rad].
        model: Whose equations of motion it has, as of `state_space`.
    """
    a, b, c = sampled_state_space(params, theta_1, model)
    return System(a, b[:, 0], c[0], np.array(0.0))


def law_system(law: Law) -> System:
    """A law from motor angle [rad] to command [N m]; its state: memory, angle and command of the last sample."""

    def advance(state: Floats) -> Floats:
        *memory, before, last, angle = state
        torque, following = law.step(angle, (angle - before) / CONTROL_PERIOD, last, np.array(memory))
        return np.array([*following, angle, torque, torque])

    size = law.size + 2
    images = np.array([advance(unit) for unit in np.eye(size + 1)]).T  # linear: columns are images of units
    return System(images[:size, :size], images[:size, size], images[size, :size], images[size, size])


def arms_at_angles(arms: Sequence[ArmParams]) -> System:
    """Each arm at each of `ANGLES`; leading axes (n, 46)."""
    return stacked([stacked([sampled_arm(params, float(angle)) for angle in ANGLES]) for params in arms])


def laws_at_angles(controller: Any) -> System:
    """The law of a controller at each of `ANGLES`; leading axis (46,)."""
    return stacked([law_system(law_of(controller, k)) for k in range(len(ANGLES))])


def loop_at(controller: Any, k: int, params: ArmParams | None = None) -> Loop:
    """Loop of a controller at `ANGLES[k]`, on the arm that it believes in or on another."""
    return Loop(law_system(law_of(controller, k)), sampled_arm(params or controller.params, float(ANGLES[k])))


def closed_loop(loop: Loop, gain: float = 1.0) -> Floats:
    """State matrix of the closed loop, arm and law, with L multiplied by a gain; shape (..., m, m)."""
    law, arm = loop
    front = np.broadcast_shapes(law.d.shape, arm.d.shape)
    split = arm.a.shape[-1]
    size = split + law.a.shape[-1]
    matrix = np.empty((*front, size, size))
    by_command = gain * arm.b[..., :, None]
    matrix[..., :split, :split] = arm.a + by_command * (law.d[..., None] * arm.c)[..., None, :]
    matrix[..., :split, split:] = by_command * law.c[..., None, :]
    matrix[..., split:, :split] = law.b[..., :, None] * arm.c[..., None, :]
    matrix[..., split:, split:] = law.a
    return matrix


def closed_poles(loop: Loop, gain: float = 1.0) -> Poles:
    """Poles z of the closed loop, with L multiplied by a gain; shape (..., m)."""
    return np.linalg.eigvals(closed_loop(loop, gain)).astype(np.complex128)


def open_poles(loop: Loop) -> Poles:
    """Poles z of L: those of the arm and of the law; shape (..., m)."""
    parts = [np.linalg.eigvals(system.a).astype(np.complex128) for system in (loop.arm, loop.law)]
    front = np.broadcast_shapes(*(part.shape[:-1] for part in parts))
    return np.concatenate([np.broadcast_to(part, (*front, part.shape[-1])) for part in parts], axis=-1)


def is_stable(loop: Loop, gain: float = 1.0) -> bool:
    """Whether all poles of the closed loop lie inside the unit circle."""
    return bool(np.abs(closed_poles(loop, gain)).max() < 1)


def slowest_first(s: Poles) -> Poles:
    """Poles [1/s] in the order of their decay."""
    return s[np.argsort(-s.real, kind="stable")]


def continuous(z: Poles) -> Poles:
    """Poles s = ln(z) / period [1/s], slowest first, without those that decay within a few samples."""
    return slowest_first(np.log(z[np.abs(z) > 1e-2]) / np.complex128(CONTROL_PERIOD))
