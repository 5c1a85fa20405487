"""Quantities that a learned observer estimates: what a filter believes of them, and what is true of an arm."""

from __future__ import annotations

import numpy as np

from agents.residual.knowledge import ENTRIES, Knowledge
from baselines.estimation.believed_arm import IDENTIFIED, nominal_row
from beltarm_env import design_model
from beltarm_env.arm import COLUMN, FIELDS, plant_of
from beltarm_env.arrays import Floats, Singles
from beltarm_env.observation import Entry
from beltarm_env.physics.drive import belt_motions, real_drive_of
from beltarm_env.rollout import Recording

_STATES = ("torsion", "torsion_speed", "tip_error_x", "tip_error_y", "tip_speed_error_x", "tip_speed_error_y")
_TOLD = {entry.name: entry for entry in ENTRIES["belief"]}
QUANTITIES: tuple[Entry, ...] = tuple(_TOLD[f"believed_{name}"]._replace(name=name) for name in (*_STATES, *IDENTIFIED))
"""All that is estimated, with units; of constants, see `baselines.estimation.believed_arm`, the logarithms over their
nominal values."""
NAMES = tuple(quantity.name for quantity in QUANTITIES)
SCALES = np.array([quantity.scale for quantity in QUANTITIES])
BELIEVED = tuple(f"believed_{name}" for name in NAMES)
"""Entries of an agent's observation that hold a filter's estimates of them."""
DOUBTS = {name: f"doubt_of_{name}" for name in NAMES if f"doubt_of_{name}" in _TOLD}
"""Entries that hold the filter's standard deviations, where it states one."""
_AT = [list(_TOLD).index(name) - len(_TOLD) for name in BELIEVED]  # from the end of what an agent observes


def believed(seen: Singles) -> Floats:
    """What the filter believes, shape (..., quantities), of what an agent observes that is told it."""
    return seen[..., _AT].astype(np.float64) * SCALES


def missed(recording: Recording, seen: Singles, hold: int, knowledge: Knowledge) -> Floats:
    """By how much the filter is wrong as each hold begins, shape (holds of all moves, arms, quantities).

    Args:
        recording: Moves of the arms.
        seen: What an agent observed as each hold began, shape (holds of all moves, arms, entries).
        hold: Samples of a hold.
        knowledge: That of the agent; without a filter's belief all is missed.
    """
    true = truth(recording, hold)
    return true if knowledge == "none" else true - believed(seen)


def truth(recording: Recording, hold: int) -> Floats:
    """True quantities as each hold begins, shape (holds of all moves, arms, quantities).

    Constants are per commanded torque: a torque constant that is too high by k looks like an arm whose inertias,
    stiffness and friction are lower by 1 + k, and nothing that is measured tells the two apart. Friction is that of the
    episode's start, from which it drifts. Nothing is recorded as a move begins, at rest: it has the next sample's.
    """
    rows = np.maximum(np.arange(0, len(recording.state), hold) - 1, 0)
    count = len(recording.params)
    belts = np.empty((len(rows), count, 2))  # of the belts themselves, which the error of the gear moves too
    for i, row in enumerate(recording.params):
        belts[:, i] = belt_motions(np.ascontiguousarray(recording.state[rows, i]), plant_of(row), real_drive_of(row))
    constants = np.broadcast_to(_logs(recording.params), (len(rows), count, len(IDENTIFIED)))
    tips = recording.tip_error[rows], recording.tip_velocity_error[rows]
    return recording.in_turn(np.concatenate([belts, *tips, constants], axis=2))


def _logs(table: Floats) -> Floats:
    """Logarithms of the identified constants over those of the model that controllers are made for, (n, constants)."""
    nominal = nominal_row(design_model())
    columns = [FIELDS.index(name) for name in IDENTIFIED]
    constants = table[:, columns]
    swing = IDENTIFIED.index("arm_inertia_swing")
    constants[:, swing] = [plant_of(row).inertia_swing for row in table]  # with the payload
    return np.log(constants / nominal[columns]) - np.log1p(table[:, [COLUMN.torque_constant_error]])
