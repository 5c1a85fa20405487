"""The linear arm behind its drive from one sample to the next: belt, current loop and latency."""

from __future__ import annotations

import math

import numpy as np

from beltarm_env.arm import ArmParams
from beltarm_env.arrays import Floats
from beltarm_env.physics.linear import exponential, state_space
from beltarm_env.timing import CONTROL_PERIOD, SHORTEST_LAG

_SMALL = 0.1  # fastest rate times duration, for the exponential's series
_WHOLE = 1e-9  # so near to a whole number of samples the rest is rounding: 3 T / T is 3 + 4e-16


def sampled_state_space(params: ArmParams, theta_1: float, model: str = "lumped") -> tuple[Floats, Floats, Floats]:
    """Compute the exact model z[k+1] = A z[k] + B u[k], y[k] = C z[k] of a period T = 1.5 ms at a joint angle.

    The state is z[k] = (theta_a, omega_a, theta_s, omega_s, tau, u[k-1], ..., u[k-d]), the input the command u [N m],
    and y = (theta_a, omega_a). With the latency T_c = (m + f) T, 0 <= f < 1, the current loop's target is
    (1 + k) u[k-m-1] for the first f T of a sample and (1 + k) u[k-m] for the rest, so d = m + 1 past commands are
    needed, m if f = 0. Each piece is the exponential of `state_space` with the target held; the rest shifts commands.

    Where T_i = 0 the torque is the target at once: tau stays a state, on which nothing depends.

    Args:
        params: The arm.
        theta_1: Joint angle about which the model is linear [rad].
        model: "lumped", or "lagrangian" (of which "mujoco" is another implementation).

    Returns:
        A (5 + d, 5 + d), B (5 + d, 1) and C (2, 5 + d).

    Raises:
        ValueError: If theta_1 lies outside 0 to pi/2, or the model is unknown.
        TypeError: If theta_1 is not a number.
    """
    late = params.command_latency / CONTROL_PERIOD
    late = round(late) if abs(late - round(late)) < _WHOLE else late
    whole = math.floor(late)
    split = (late - whole) * CONTROL_PERIOD
    past = math.ceil(late)
    # One more column for the command of now: z[k+1] = (A B) (z[k], u[k]).
    both = np.eye(5, 6 + past)
    for duration, age in ((split, whole + 1), (CONTROL_PERIOD - split, whole)):
        if duration == 0:
            continue
        stepped = _piece(params, theta_1, model, duration)
        both = stepped[:, :5] @ both
        both[:, _place(age, past)] += stepped[:, 5]
    shift = np.zeros((past, 6 + past))
    for age in range(past):
        shift[age, _place(age, past)] = 1.0
    both = np.vstack([both, shift])
    return np.delete(both, 5 + past, axis=1), both[:, 5 + past :], np.eye(2, 5 + past)


def _place(age: int, past: int) -> int:
    """Column of the command of `age` samples ago, that of now being the last one."""
    return 4 + age if age else 5 + past


def _piece(params: ArmParams, theta_1: float, model: str, duration: float) -> Floats:
    """Transition of (x, tau) over a time in which a command is held, shape (5, 6); the command's part in column 5."""
    held, gain = np.zeros((6, 6)), 1 + params.torque_constant_error
    lags = params.current_loop_time_constant >= SHORTEST_LAG
    if lags:
        held[:5, :5], held[:5, 5:], _ = state_space(params, theta_1, model, actuator=True)
    else:
        a, b, _ = state_space(params, theta_1, model)
        held[:4, :4], held[:4, 5:] = a, gain * b
    fastest = float(np.abs(np.linalg.eigvals(held)).max())
    halvings = max(0, math.ceil(math.log2(max(fastest * duration, 1e-300) / _SMALL)))
    stepped = exponential(held, duration / 2**halvings)
    for _ in range(halvings):
        stepped = stepped @ stepped
    if not lags:
        stepped[4] = [0, 0, 0, 0, 0, gain]
    return stepped[:5]
