"""Systems that are late."""

import math
from dataclasses import replace

import numpy as np

from baselines.loops.models import System, sampled_arm
from beltarm_env import CONTROL_PERIOD, ArmParams


def delayed(system: System, samples: int) -> System:
    """A system whose input arrives a number of whole samples late."""
    if samples == 0:
        return system
    size, c = len(system.a), np.pad(system.c, (0, samples))
    a, b = np.zeros((size + samples, size + samples)), np.zeros(size + samples)
    a[:size, :size], a[size + 1 :, size:-1] = system.a, np.eye(samples)[1:, 1:]
    a[:size, -1], c[-1], b[size] = system.b, system.d, 1.0
    return System(a, b, c, 0.0)


def late_arm(params: ArmParams, theta_1: float, samples: float) -> System:
    """The arm at a joint angle [rad] with its command later by any number of samples, exactly sampled."""
    total = params.command_latency / CONTROL_PERIOD + samples
    part = replace(params, command_latency=(total - math.floor(total)) * CONTROL_PERIOD)
    return delayed(sampled_arm(part, theta_1), math.floor(total))
