"""Uniform random numbers of an episode: how many, and what each is for.

An episode takes as many whatever is randomised or fixed, so that streams stay aligned. Their order is that in which
they came to be: arm, move, drive, sensors, and what came after them.
"""

from __future__ import annotations

import numpy as np

from beltarm_env.arm import FIELDS
from beltarm_env.task import accelerometer, moves

FIRST_OF_MOVE = FIELDS.index("current_loop_time_constant")
END_OF_MOVE = FIRST_OF_MOVE + moves.DRAWS
_LATER = len(FIELDS) - FIELDS.index("presliding_deflection")
FIRST_OF_SENSORS = len(FIELDS) - _LATER + moves.DRAWS
_END_OF_SENSORS = FIRST_OF_SENSORS + accelerometer.DRAWS
DRAWS = _END_OF_SENSORS + _LATER
"""Numbers of an episode."""
OF_ARM = np.r_[:FIRST_OF_MOVE, END_OF_MOVE:FIRST_OF_SENSORS, _END_OF_SENSORS:DRAWS]
"""Which number is for each field of `ArmParams`."""
