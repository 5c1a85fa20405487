"""Tables of the linear loop: poles, the full arm, best K4, damping over omega_n."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from beltarm_env import ArmParams
from eval.report.text import markdown_table, number, poles_text
from eval.reproduction.loop import (
    GAIN_RANGES,
    PAPER_ARM,
    ServoGains,
    best_gain,
    closed_loop,
    digital_poles,
    dominant_damping,
    natural_frequency_locus,
    nominal_m2,
    poles,
    sampled_poles,
    without_and_with,
)

FREQUENCY_FACTORS = (0.5, 1.0, 2.0, 3.0)
"""Of omega_n, in the table of the damping over it."""


def pole_table(gains: ServoGains) -> str:
    """Poles of the loop and of its variants at both angles."""
    k4, no_k4, rows = f"K4 = {gains.k4:g}", replace(gains, k4=0.0), []
    for degrees in (0, 90):
        angle = np.radians(degrees)
        loops = {
            "K4 = 0": poles(closed_loop(PAPER_ARM, angle, no_k4)),
            k4: poles(closed_loop(PAPER_ARM, angle, gains)),
            f"{k4}, sign in (6e) as printed": poles(closed_loop(PAPER_ARM, angle, gains, as_printed=True)),
            f"{k4}, belt damping ζ = {ArmParams().belt_damping_ratio:g}": poles(closed_loop(ArmParams(), angle, gains)),
            f"{k4}, torque held over 1.5 ms": sampled_poles(PAPER_ARM, angle, gains),
            f"{k4}, as the drive runs it": digital_poles(PAPER_ARM, angle, gains),
        }
        rows += [[f"{degrees}°", loop, poles_text(values, 2)] for loop, values in loops.items()]
    return markdown_table(["θ₁", "loop", "poles (1/s), damping ratio of each pair"], rows, "lll")


def full_arm_table(gains: ServoGains) -> str:
    """Damping of the loop on the full arm, as analysed: torsional velocity measured, and simulated by the drive."""
    rows = []
    for degrees in (0, 45, 90):
        angle = np.radians(degrees)
        measured = (poles(closed_loop(PAPER_ARM, angle, g, model="lagrangian")) for g in without_and_with(gains))
        simulated = digital_poles(PAPER_ARM, angle, gains, model="lagrangian")
        damping = [number(dominant_damping(values), 3) for values in (*measured, simulated)]
        rows.append([f"{degrees}°", *damping, poles_text(simulated[np.abs(simulated.imag) > 1e-6], 2)])
    k4 = f"K4 = {gains.k4:g}, torsion"
    titles = ["θ₁", "damping with K4 = 0", f"{k4} measured", f"{k4} simulated", "the latter's pairs (1/s)"]
    return markdown_table(titles, rows, "lrrrl")


def best_gain_table(gains: ServoGains) -> str:
    """K4 of the largest dominant damping at three inertias."""
    rows = []
    for name, angle, payload in (("0°", 0.0, 0.0), ("90°", np.pi / 2, 0.0), ("90°, payload 0.2 kg", np.pi / 2, 0.2)):
        m2 = nominal_m2(angle, payload)
        k4, damping = best_gain(gains, m2)
        rows.append([name, f"{m2:g}", f"{round(k4, 2):g}", number(damping, 3)])
    return markdown_table(["arm", "M2 (kg m²)", "best K4 (N m s/rad)", "dominant damping"], rows)


def frequency_table(gains: ServoGains) -> str:
    """Dominant damping at 90 degrees over omega_n, Fig. 6(b)."""
    low, high = GAIN_RANGES["natural_frequency"]
    frequencies = np.unique(np.clip(gains.natural_frequency * np.array(FREQUENCY_FACTORS), low, high))
    damping = dominant_damping(natural_frequency_locus(PAPER_ARM, np.pi / 2, gains, frequencies))
    rows = [[f"{f:g}", number(d, 3)] for f, d in zip(frequencies, damping, strict=True)]
    return markdown_table(["ω_n (rad/s)", "dominant damping at 90°"], rows, "rr")
