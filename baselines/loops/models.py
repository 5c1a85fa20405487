"""Linear loops at 1.5 ms: law, arm behind its drive, open and closed poles.

The only measurement is the motor's angle, from which the speed is differenced; the torque of the last sample is what
the controller itself asked for. So with P the sampled arm and C the law there is one loop,

    L(z) = -C(z) P(z),    S = 1 / (1 + L),

and cutting it at the plant's input, the command, is cutting it at the encoder. P has the real drive: current
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
    """A linear system from one input to one output: x+ = A x + b u, y = c x + d u."""

    a: Floats  # (m, m)
    b: Floats  # (m,)
    c: Floats  # (m,)
    d: float


class Loop(NamedTuple):
    """A loop: what is cut is the command between law and arm."""

    law: System  # C, from motor angle [rad] to command [N m]
    arm: System  # P, back


def sampled_arm(params: ArmParams, theta_1: float, model: str = "lumped") -> System:
    """The arm behind its drive at a joint angle [rad], from command [N m] to motor angle [rad].

    Args:
        params: The arm.
        theta_1: Joint angle [rad].
        model: Whose equations of motion it has, as of `state_space`.
    """
    a, b, c = sampled_state_space(params, theta_1, model)
    return System(a, b[:, 0], c[0], 0.0)


def law_system(law: Law) -> System:
    """A law from motor angle [rad] to command [N m]; its state: memory, angle and command of the last sample."""

    def advance(state: Floats) -> Floats:
        *memory, before, last, angle = state
        torque, following = law.step(angle, (angle - before) / CONTROL_PERIOD, last, np.array(memory))
        return np.array([*following, angle, torque, torque])

    size = law.size + 2
    images = np.array([advance(unit) for unit in np.eye(size + 1)]).T  # linear: columns are images of units
    return System(images[:size, :size], images[:size, size], images[size, :size], images[size, size])


def laws_at_angles(controller: Any) -> list[System]:
    """The law of a controller at each of `ANGLES`."""
    return [law_system(law_of(controller, k)) for k in range(len(ANGLES))]


def loop_at(controller: Any, k: int, params: ArmParams | None = None) -> Loop:
    """Loop of a controller at `ANGLES[k]`, on the arm that it believes in or on another."""
    return Loop(law_system(law_of(controller, k)), sampled_arm(params or controller.params, float(ANGLES[k])))


def closed_poles(loop: Loop, gain: float = 1.0) -> Poles:
    """Poles z of the closed loop, with L multiplied by a gain; shape (m,)."""
    law, arm = loop
    by_command = gain * arm.b[:, None]
    rows = [[arm.a + by_command * (law.d * arm.c), by_command * law.c], [law.b[:, None] * arm.c, law.a]]
    return np.linalg.eigvals(np.block(rows)).astype(np.complex128)


def poles_of(loops: Sequence[Loop]) -> tuple[Poles, Poles]:
    """Open and closed poles z of n loops, shape (n, m) each; loops of a lower order have poles at 0 in both."""
    size = max(len(law.a) + len(arm.a) for law, arm in loops)
    both = np.zeros((2, len(loops), size), np.complex128)
    for i, loop in enumerate(loops):
        opened = np.concatenate([np.linalg.eigvals(loop.arm.a), np.linalg.eigvals(loop.law.a)])
        closed = closed_poles(loop)
        both[0, i, : len(opened)], both[1, i, : len(closed)] = opened, closed
    return both[0], both[1]


def slowest_first(s: Poles) -> Poles:
    """Poles [1/s] in the order of their decay."""
    return s[np.argsort(-s.real, kind="stable")]


def continuous(z: Poles) -> Poles:
    """Poles s = ln(z) / period [1/s], slowest first, without those that decay within a few samples."""
    return slowest_first(np.log(z[np.abs(z) > 1e-2]) / np.complex128(CONTROL_PERIOD))
