"""Tuned gains as a table: symbol, unit, value, range, provenance."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from baselines import CONTROLLERS, TUNABLE
from baselines.gains import read_file
from baselines.servo.paper import PaperGains
from eval.report.text import markdown_table

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


def _row(name: str, value: float, limits: str) -> list[str]:
    symbol, unit = MEANING.get(name, ("", ""))
    return [f"`{name}`", symbol, f"{value:.4g}", unit, limits]


def _limits(metadata: Any) -> str:
    if not metadata:
        return "not tuned"
    return f"{metadata['low']:g} to {metadata['high']:g}{', log' if metadata['log'] else ''}"


def gains_table(name: str) -> str:
    """Table of the gains of one of `CONTROLLERS` with units and provenance.

    Raises:
        ValueError: If the file of gains is damaged or out of date.
    """
    controller = CONTROLLERS[name]()
    gains = controller.gains
    rows = [_row(gain.name, getattr(gains, gain.name), _limits(gain.metadata)) for gain in fields(gains)]
    table = markdown_table(["gain", "symbol", "value", "unit", "searched"], rows, "llrll")
    return table + "\n\n" + _origin(name, isinstance(gains, PaperGains))


def _origin(name: str, of_paper: bool) -> str:
    if of_paper:
        return "Table 2 of the paper" + (" with K_4 = 0" if name == "rigid" else "") + "; not tuned."
    entry = read_file().get(name) if name in TUNABLE else None
    if entry is None:
        return "Not tuned."
    p = entry["provenance"]
    return (
        f"`{p['command']}`, seed {p['seed']}, {p['steps'] / 1e6:g} million samples, {p['trials']} trials, "
        f"{p['date']}, commit {p['commit']}: cost {p['cost_untuned']:g} before, {p['cost']:g} after, on "
        f"{p['measured_on']}."
        + (" That tree had changes that were not committed." if p["commit"].endswith("-dirty") else "")
    )
