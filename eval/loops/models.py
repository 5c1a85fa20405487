"""Linear loops at 1.5 ms: arm and law as python-control's state spaces, closed-loop poles and margins.

The only measurement is the motor's angle, from which the speed is differenced; the torque of the last sample is what
the controller itself asked for. So with P the sampled arm and C the law there is one loop,

    L(z) = -C(z) P(z),    S = 1 / (1 + L),

and cutting it at the plant's input, the torque, is cutting it at the encoder.

    gain margins    factors on L, up and down, at which it becomes unstable
    phase margin    least |phase of L from 180 degrees| where |L| = 1
    delay margin    least phase(w) / w where |L| = 1 [samples]: the encoder's delay that the loop bears
    modulus margin  1 / max |S| = min |1 + L|, the distance of the Nyquist curve to -1
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import control
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar, root_scalar

from baselines.models.linear import ANGLES
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.physics.sampled import sampled_state_space
from eval.loops.laws import Law, law_of

Floats = NDArray[np.float64]
Poles = NDArray[np.complex128]

NYQUIST = np.pi / CONTROL_PERIOD
"""[rad/s]"""
_FREQUENCIES = np.append(np.geomspace(0.05, 0.9999 * NYQUIST, 4000), NYQUIST)


def sampled_arm(params: ArmParams, theta_1: float, model: str = "lumped") -> control.StateSpace:
    """The arm behind its drive at a joint angle [rad] from command [N m] to motor angle [rad].

    Args:
        params: The arm.
        theta_1: Joint angle [rad].
        model: Whose equations of motion it has, as of `state_space`.
    """
    a, b, c = sampled_state_space(params, theta_1, model)
    return control.StateSpace(a, b, c[:1], 0, CONTROL_PERIOD)


def law_model(law: Law) -> control.StateSpace:
    """A law from motor angle [rad] to torque [N m]; its state: memory, angle and torque of the last sample."""

    def advance(state: Floats) -> Floats:
        *memory, before, last, angle = state
        torque, following = law.step(angle, (angle - before) / CONTROL_PERIOD, last, np.array(memory))
        return np.array([*following, angle, torque, torque])

    size = law.size + 2
    images = np.array([advance(unit) for unit in np.eye(size + 1)]).T  # linear: columns are images of units
    return control.StateSpace(
        images[:size, :size], images[:size, size:], images[size:, :size], images[size:, size:], CONTROL_PERIOD
    )


def loop_model(controller: Any, k: int, params: ArmParams | None = None) -> control.StateSpace:
    """L of a controller at `ANGLES[k]`, on the arm that it believes in or on another."""
    model = law_model(law_of(controller, k))
    return -(model * sampled_arm(params or controller.params, ANGLES[k]))


def closed_poles(loop: control.StateSpace, gain: float = 1.0) -> Poles:
    """Poles z of the closed loop, with L multiplied by a gain."""
    closed = cast("control.StateSpace", control.feedback(gain * loop, 1))
    return np.asarray(closed.poles(), dtype=np.complex128)


def is_stable(loop: control.StateSpace, gain: float = 1.0) -> bool:
    """Whether all poles of the closed loop lie inside the unit circle."""
    return bool(np.abs(closed_poles(loop, gain)).max() < 1)


def slowest_first(s: Poles) -> Poles:
    """Poles [1/s] in the order of their decay."""
    return s[np.argsort(-s.real, kind="stable")]


def continuous(z: Poles) -> Poles:
    """Poles s = ln(z) / period [1/s], slowest first, without those that decay within a few samples."""
    return slowest_first(np.log(z[np.abs(z) > 1e-2]) / np.complex128(CONTROL_PERIOD))


@dataclass(frozen=True, slots=True)
class Margins:
    """Stability margins of a loop at one angle."""

    stable: bool
    gain_up: float  # factor above 1, infinite if there is none
    gain_down: float  # factor below 1, 0 if there is none
    phase: float  # [degrees]
    delay: float  # [samples]
    modulus: float


def response(loop: control.StateSpace, frequencies: Floats | float) -> Poles:
    """L at frequencies [rad/s] other than 0."""
    a, b, c, d = (np.asarray(part) for part in (loop.A, loop.B, loop.C, loop.D))
    z = np.exp(1j * np.atleast_1d(frequencies) * CONTROL_PERIOD)
    solved = np.linalg.solve(z[:, None, None] * np.eye(len(a)) - a, b.astype(np.complex128)[None])
    return (c @ solved + d)[:, 0, 0].reshape(np.shape(frequencies))


def margins(loop: control.StateSpace) -> Margins:
    """Margins of a loop from its frequency response, crossings located exactly; meaningless if it is not stable."""
    values = response(loop, _FREQUENCIES)
    real = [response(loop, w).real for w in _crossings(loop, values.imag, np.imag)]
    real = np.array([*real, values[-1].real, float(control.dcgain(loop))])
    factors = -1 / real[np.isfinite(real) & (real != 0)]
    cuts = np.array(_crossings(loop, np.abs(values) - 1, lambda value: np.abs(value) - 1))
    lag = np.angle(-response(loop, cuts)) if len(cuts) else np.empty(0)
    return Margins(
        is_stable(loop),
        float(min(factors[factors > 1], default=np.inf)),
        float(max(factors[(factors > 0) & (factors < 1)], default=0.0)),
        float(np.degrees(np.abs(lag).min(initial=np.pi))),
        float((lag % (2 * np.pi) / cuts / CONTROL_PERIOD).min(initial=np.inf)),
        _modulus(loop, values),
    )


def _crossings(loop: control.StateSpace, values: Floats, part: Any) -> list[float]:
    """Frequencies [rad/s] at which a real function of L vanishes; `values` are its values on the grid."""
    found = []
    for i in np.flatnonzero(np.diff(np.sign(values[:-1]))):
        ends = (_FREQUENCIES[i], _FREQUENCIES[i + 1])
        found.append(float(root_scalar(lambda w: float(part(response(loop, w))), bracket=ends, xtol=1e-9).root))
    return found


def _modulus(loop: control.StateSpace, values: Poles) -> float:
    least = int(np.abs(1 + values).argmin())
    around = _FREQUENCIES[[max(least - 1, 0), min(least + 1, len(values) - 1)]]
    found = minimize_scalar(lambda w: abs(1 + response(loop, w)), bounds=tuple(around), method="bounded")
    return float(min(found.fun, np.abs(1 + values[least])))


@dataclass(frozen=True)
class Scan:
    """The loops of one controller at each of `ANGLES`."""

    margins: list[Margins]
    poles: list[Poles]  # continuous equivalents [1/s]


def scan(controller: Any) -> Scan:
    """Margins and poles of a controller on the arm that it believes in, over all angles."""
    loops = [loop_model(controller, k) for k in range(len(ANGLES))]
    return Scan([margins(loop) for loop in loops], [continuous(closed_poles(loop)) for loop in loops])
