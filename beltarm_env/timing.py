"""Timing of the control loop, shared by everything."""

from __future__ import annotations

CONTROL_PERIOD = 0.0015
"""Sampling time of the controller, and of the environment's steps [s]; the paper's."""
EPISODE_STEPS = 1200
"""Steps per episode: 1.8 s."""
EPISODE_TIME = EPISODE_STEPS * CONTROL_PERIOD
"""[s]"""
LATENCY_SAMPLES = 3
MAX_LATENCY = LATENCY_SAMPLES * CONTROL_PERIOD
"""Longest latency between a sample and the instant at which its command acts [s]."""
SHORTEST_LAG = 1e-7
"""Time constant of the current loop [s] from which on it counts; a shorter one is taken for none.

That moves the arm's end by what it travels in that time, 0.4 um at most. Within such a lag the instant at which a motor
breaks away is not found.
"""
