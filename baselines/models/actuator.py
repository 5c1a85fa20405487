"""Time from a sample to the instant at which its command acts on the motor.

The command is late by T_c, and the current loop follows it with the time constant T_i. Control counts both as one dead
time T_c + T_i, as a drive engineer adds up small time constants (C. Kessler: Das symmetrische Optimum,
Regelungstechnik 6, 1958): at 300 rad/s a lag of 0.55 ms differs from a dead time by 0.1 degrees of phase and 1.3 % of
gain. So plans and feed-forward are read that much later in the move, and feedback is about the state then.
"""

from __future__ import annotations

from beltarm_env import ArmParams


def dead_time(params: ArmParams) -> float:
    """Return T_c + T_i [s]."""
    return params.command_latency + params.current_loop_time_constant
