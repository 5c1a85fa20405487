"""Symbols and units of all gains."""

from __future__ import annotations

MEANING = {
    "angle": ("K_p", "1/s²"),
    "speed": ("K_v", "1/s"),
    "integral": ("K_i", "1/s"),
    "torsion_speed": ("K_4", "N m s/rad"),
    "friction": ("c", "share of friction"),
    "rest_width": ("width", "N m"),
    "shortest_ramp": ("t", "s"),
    "frequency": ("of the mode", "of the nominal"),
    "vibration": ("V", "–"),
    "ramp": ("t", "periods of the mode"),
    "observer": ("g, ω_o", "rad/s"),
    "bandwidth": ("ω_c", "rad/s"),
    "reaction": ("g_r", "rad/s"),
    "reaction_gain": ("K_r", "–"),
    "first_spread": ("of the first corner", "periods of the mode"),
    "spread": ("of later corners", "periods of the mode"),
    "velocity_weight": ("w_v", "–"),
    "torque_weight": ("ρ", "1/(N m)²"),
    "change_weight": ("R", "1/(N m)²"),
    "torque_noise": ("σ_τ", "N m"),
    "acceleration_noise": ("σ_α", "rad/s²"),
    "disturbance_noise": ("σ_d", "N m/√s"),
    "angle_noise": ("σ_0", "rad/√s"),
    "unexplained_torque": ("σ_d", "N m"),
    "friction_share": ("c", "share of friction"),
    "friction_speed": ("ω_0", "rad/s"),
    "swing_doubt": ("σ of ln S", "–"),
    "stiffness_doubt": ("σ of ln K_s", "–"),
    "friction_doubt": ("σ of ln V_a1, ln τ_c", "–"),
}
"""Symbol in the module's docstring and unit of every gain, by its name."""
