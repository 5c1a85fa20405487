"""The linear loop in tables and words, every statement from the numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from beltarm_env import ArmParams
from eval.reproduction.effects import without_and_with
from eval.reproduction.loop import (
    GAIN_RANGES,
    PAPER_ARM,
    Poles,
    ServoGains,
    best_gain,
    closed_loop,
    digital_poles,
    dominant_damping,
    natural_frequency_locus,
    poles,
    sampled_poles,
)
from eval.reproduction.runs import END_WINDOW
from eval.reproduction.study import AS_ANALYSED, MEASURED, TO_0, Study, nominal_m2
from eval.reproduction.words import number
from eval.style.markdown_table import markdown_table

_ANGLES = {"0°": 0.0, "90°": np.pi / 2}
_FREQUENCY_FACTORS = (0.5, 1.0, 2.0, 3.0)


def _shown(values: Poles) -> str:
    """Poles as text, each conjugate pair once."""
    parts = []
    for value in values:
        if value.imag > 1e-6:
            parts.append(f"{number(value.real, 2)} ± {number(value.imag, 1)}j")
        elif value.imag > -1e-6:
            parts.append(number(value.real, 2))
    return ", ".join(parts)


def pole_table(gains: ServoGains) -> str:
    """Poles of the loop and of its variants at both angles."""
    rows = []
    for name, angle in _ANGLES.items():
        loops = {
            "K4 = 0": poles(closed_loop(PAPER_ARM, angle, replace(gains, k4=0.0))),
            f"K4 = {gains.k4:g}": poles(closed_loop(PAPER_ARM, angle, gains)),
            f"K4 = {gains.k4:g}, sign in (6e) as printed": poles(closed_loop(PAPER_ARM, angle, gains, as_printed=True)),
            f"K4 = {gains.k4:g}, belt damping ζ = {ArmParams().belt_damping_ratio:g}": poles(
                closed_loop(ArmParams(), angle, gains)
            ),
            f"K4 = {gains.k4:g}, sampled at 1.5 ms": sampled_poles(PAPER_ARM, angle, gains),
        }
        for loop, values in loops.items():
            rows.append([name, loop, _shown(values), number(dominant_damping(values), 3)])
    return markdown_table(["θ₁", "loop", "poles (1/s)", "dominant damping"], rows, "lllr")


def pole_remarks(study: Study) -> list[str]:
    """What the poles say: erratum, sampling, the torsion's simulation, and how far more of each gain helps."""
    gains = study.gains
    return [_erratum(gains), _sampling(gains), _simulation(study), _full_arm(gains), _best(gains), _frequency(gains)]


def _erratum(gains: ServoGains) -> str:
    unstable = [
        name
        for name, angle in _ANGLES.items()
        if poles(closed_loop(PAPER_ARM, angle, gains, as_printed=True)).real.max() > 0
    ]
    what = f"unstable at {' and '.join(unstable)}" if unstable else "stable at both angles"
    return (
        "Erratum: (6e) prints the last entry of b as −1/(M_a1 G); (5a) with (6g) gives +1/(M_a1 G). With the sign as "
        f"printed the loop is {what}; with the right one its poles are those of the row above. Everything else here "
        "uses the right one."
    )


def _sampling(gains: ServoGains) -> str:
    changes = []
    for angle in _ANGLES.values():
        continuous = dominant_damping(poles(closed_loop(PAPER_ARM, angle, gains)))
        digital = dominant_damping(_split(digital_poles(PAPER_ARM, angle, gains), angle)[1])
        changes += [
            (float(dominant_damping(sampled_poles(PAPER_ARM, angle, gains)) - continuous), digital - continuous)
        ]
    small = "does not change" if np.abs(changes).max() < 0.03 else "changes"
    (hold_0, drive_0), (hold_90, drive_90) = ((number(change, 3, plus=True) for change in row) for row in changes)
    return (
        f"Sampling at 1.5 ms {small} the conclusion. Holding the torque moves the dominant damping by {hold_0} at 0° "
        f"and {hold_90} at 90°; with speed by differencing and torsion simulated from it as well, by {drive_0} and "
        f"{drive_90}."
    )


def _split(values: Poles, angle: float) -> tuple[Poles, Poles]:
    """The simulation's own pair among the drive's poles, +-j sqrt(K_s / M2), and the others."""
    mode = 1j * np.sqrt(PAPER_ARM.belt_stiffness / nominal_m2(angle))
    own = np.minimum(np.abs(values - mode), np.abs(values + mode)).argsort()
    return values[own[:2]], values[own[2:]]


def _simulation(study: Study) -> str:
    own = {name: _split(digital_poles(PAPER_ARM, angle, study.gains), angle)[0] for name, angle in _ANGLES.items()}
    listed = " and ".join(f"{_shown(pair)} at {name}" for name, pair in own.items())
    simulated, measured = (study.scenes[TO_0, view].compared.fate("end") for view in (AS_ANALYSED, MEASURED))
    return (
        "The simulation that supplies the torsional velocity, as in the paper, adds a pair of poles of its own: "
        f"{listed}, the belt's behind a motor held still. Nothing corrects an error of the simulation; it dies out "
        "with the belt's own damping only, and K4 passes it on to the motor. On the move to 0°, as analysed, the "
        f"ringing in the last {END_WINDOW:g} s is {simulated}; with the torsional velocity measured it is {measured}."
    )


def _full_arm(gains: ServoGains) -> str:
    """What becomes of the loop on the full arm."""
    loop = f"K4 = {gains.k4:g}, torsion"
    lines = [
        f"| θ₁ | damping with K4 = 0 | {loop} measured | {loop} simulated | the latter's pairs (1/s) |",
        "|---|---:|---:|---:|---|",
    ]
    unstable, helped = [], []
    for degrees in (0, 45, 90):
        before, measured = (
            dominant_damping(poles(closed_loop(PAPER_ARM, np.radians(degrees), g, model="lagrangian")))
            for g in without_and_with(gains)
        )
        values = digital_poles(PAPER_ARM, np.radians(degrees), gains, model="lagrangian")
        simulated = dominant_damping(values)
        cells = (number(damping, 3) for damping in (before, measured, simulated))
        lines.append(f"| {degrees}° | {' | '.join(cells)} | {_shown(values[np.abs(values.imag) > 1e-6])} |")
        unstable += [f"{degrees}°"] if measured < 0 else []
        helped += [f"{degrees}°"] if simulated > before + 5e-4 else []
    stable = f"unstable at {' and '.join(unstable)}" if unstable else "stable at all three angles"
    raised = (
        f"raises the smallest damping at {' and '.join(helped)} only"
        if helped
        else "does not raise the smallest damping at any of them"
    )
    return (
        "On the full arm, as analysed, the loop with the torsional velocity measured is "
        f"{stable}. As shipped, with the velocity simulated, it has two oscillating pairs. The simulation is that of "
        f"the lumped arm and does not know the full arm's mode, 28.7 rad/s behind a held motor at every angle: K4 "
        f"{raised}.\n\n" + "\n".join(lines)
    )


def _best(gains: ServoGains) -> str:
    listed = []
    for name, m2 in (
        ("0°", nominal_m2(0)),
        ("90°", nominal_m2(np.pi / 2)),
        ("90° with 0.2 kg", nominal_m2(np.pi / 2, 0.2)),
    ):
        k4, damping = best_gain(gains, m2)
        listed.append(f"{round(k4, 2):g} at {name} (M2 = {m2:g} kg m²; damping {number(damping, 3)})")
    return (
        f"Where more K4 stops helping depends on M2: the dominant damping is largest with K4 = "
        f"{', '.join(listed)}. The map below shows it."
    )


def _frequency(gains: ServoGains) -> str:
    low, high = GAIN_RANGES["natural_frequency"]
    frequencies = np.unique(np.clip(gains.natural_frequency * np.array(_FREQUENCY_FACTORS), low, high))
    damping = dominant_damping(natural_frequency_locus(PAPER_ARM, np.pi / 2, gains, frequencies))
    falls = "falls as ω_n grows" if np.all(np.diff(damping) < 0) else "does not fall throughout as ω_n grows"
    listed = ", ".join(f"{number(d, 3)} at {f:g} rad/s" for f, d in zip(frequencies, damping, strict=True))
    return f"Fig. 6(b), at 90°: the dominant damping {falls}: {listed}."
