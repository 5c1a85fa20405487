"""Uniform random numbers of an episode: how many, and what each is for.

An episode takes as many whatever is randomised or fixed, so that streams stay aligned. Their order is that in which
they came to be: arm, move, drive, sensors.
"""

from __future__ import annotations

import numpy as np

from beltarm_env.arm import FIELDS
from beltarm_env.task import accelerometer, moves

FIRST_OF_MOVE = FIELDS.index("current_loop_time_constant")
END_OF_MOVE = FIRST_OF_MOVE + moves.DRAWS
FIRST_OF_SENSORS = len(FIELDS) + moves.DRAWS
OF_ARM = np.r_[:FIRST_OF_MOVE, END_OF_MOVE:FIRST_OF_SENSORS]
"""Which number is for each field of `ArmParams`."""
DRAWS = FIRST_OF_SENSORS + accelerometer.DRAWS
"""Numbers of an episode."""
