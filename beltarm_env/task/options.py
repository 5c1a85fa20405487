"""Options of a reset, checked and as arrays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from beltarm_env.arrays import Floats
from beltarm_env.physics.kinematics import HIGHEST, LOWEST

_FASTEST = np.array([2000.0, 200.0])  # motor and torsional speed of an initial state [rad/s]


def checked_names(what: str, given: object, allowed: tuple[str, ...]) -> Mapping[str, Any]:
    """Return a mapping whose names are all allowed; an empty one for None."""
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise TypeError(f"{what} must be a mapping, got {given!r}")
    unknown = [name for name in given if name not in allowed]
    if unknown:
        raise ValueError(f"{what} has unknown name {unknown[0]!r}; known: {', '.join(allowed)}")
    return given


def checked_column(name: str, value: object, count: int) -> Floats:
    """Broadcast a scalar or one value per arm, as an array of shape (count,)."""
    array = _numbers(name, value)
    if array.shape not in ((), (count,)):
        raise ValueError(f"{name} must be one number or have shape ({count},), got shape {array.shape}")
    return np.broadcast_to(array, (count,)).copy()


def _numbers(name: str, value: object) -> Floats:
    try:
        array = np.asarray(value)
    except ValueError:
        array = np.empty(0, dtype=object)
    if array.dtype == object and array.size and all(type(entry) in (int, float) for entry in array.flat):
        try:
            return array.astype(np.float64)
        except OverflowError:
            raise ValueError(f"{name} must be finite, got a whole number that no float can hold") from None
    if array.dtype.kind not in "fiu":
        raise TypeError(f"{name} must consist of numbers, got {value!r}")
    return array.astype(np.float64)


def checked_states(given: object, gear: Floats) -> Floats:
    """Check initial states as given, shape (n, 4), for arms with gear ratios of shape (n,)."""
    states = np.empty((len(gear), 4))
    array = _numbers("state", given)
    if array.shape not in ((4,), states.shape):
        raise ValueError(f"state must have shape (4,) or {states.shape}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"state must be finite, got {array.tolist()}")
    states[:] = array
    joint, arm = states[:, 0] / gear, states[:, 0] / gear - states[:, 2]
    inside = np.all([joint >= LOWEST, joint <= HIGHEST, arm >= LOWEST, arm <= HIGHEST], axis=0)
    if not inside.all():
        raise ValueError(
            f"state must have joint and arm angle within {LOWEST:.3f} and {HIGHEST:.3f} rad, "
            f"got {states[int(np.argmin(inside))].tolist()}"
        )
    slow = np.all(np.abs(states[:, [1, 3]]) <= _FASTEST, axis=1)
    if not slow.all():
        raise ValueError(
            f"state must have speeds of at most {_FASTEST[0]:.0f} rad/s (motor) and {_FASTEST[1]:.0f} rad/s (torsion), "
            f"got {states[int(np.argmin(slow))].tolist()}"
        )
    return states
