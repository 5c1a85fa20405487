"""Distances of the two engines as Markdown and as a picture."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt

from baselines.tools.provenance import command_line, commit
from beltarm_env.mujoco.model import mujoco
from eval.report.style import COLOURS, save_figure
from eval.report.text import markdown_table
from eval.verification.crosscheck import DRIVE, REGIMES, EngineDistance


def _table(results: list[EngineDistance]) -> str:
    steps = list(results[0].distances)
    rows = []
    for found in results:
        cells = [f"{value:.2g}" if value >= 1e-4 else f"{value:.0e}" for value in found.distances.values()]
        rows.append([found.setting, *cells])
    return markdown_table(["MuJoCo", *(f"{count} per sample" for count in steps)], rows)


def _listed(values: dict[str, float]) -> str:
    return ", ".join(f"`{name}` {value:g}" for name, value in values.items())


def markdown(results: list[EngineDistance], arms: int, seed: int, seconds: float) -> str:
    """The content of summary.md."""
    parts = [
        "# The full arm in two engines",
        f'Largest distance of MuJoCo\'s tip from that of the kernel (`model="lagrangian"`) over 1.8 s and {arms} arms '
        'of the ideal ranges, given the same torques without feedback. `model="mujoco"` has RK4 with two steps per '
        "sample; d = 0.9 and b = 100/s are MuJoCo's own friction settings.",
    ]
    for regime, what in REGIMES.items():
        of_regime = [found for found in results if found.regime == regime]
        parts.append(f"## {regime.capitalize()}: {what}, {of_regime[0].stops} stops of the motor (mm)")
        parts.append(_table(of_regime))
    parts += [
        "![distance](distance.png)",
        "Without Coulomb friction both engines solve the same equations, and what is left is the order of the "
        "integrators: first for MuJoCo's Euler and implicitfast, fourth for RK4 (whose error, with one step per "
        "sample, is the kernel's own).",
        "With it, MuJoCo's friction is soft. A motor that should stick creeps at (1 − d) a / b, and near standstill "
        "friction grows in proportion to the speed, so that stopping takes a time of 1 / b. Here d is the impedance "
        "of the constraint, which MuJoCo cuts at 0.9999, b its rate, 100/s by default, and a the acceleration that the "
        "pull on the motor would cause without friction. Raising d alone removes the creep but not the late stop. With "
        "b = 2 per time step, which RK4 bears with a margin, both shrink with the step. The kernel has neither: it "
        "locates the instant of stopping.",
        f"The drive has {_listed(DRIVE)}: of all that MuJoCo can express, the upper ends of the training ranges. A "
        "command that arrives within a sample cuts it in two pieces with steps of their own, so that one step per "
        "sample is here two. Behind the lag, MuJoCo gets the mean torque of each step, which is of second order.",
        f"`{command_line()}`, seeds {seed} to {seed + arms - 1}, MuJoCo {mujoco.__version__}, beltarm {commit()}, "
        f"{seconds:.0f} s.",
    ]
    return "\n\n".join(parts) + "\n"


def save_picture(results: list[EngineDistance], path: Path) -> None:
    """Distance over the number of steps, a panel per regime."""
    names = list(dict.fromkeys(found.setting for found in results))
    steps = list(results[0].distances)
    figure, axes = plt.subplots(1, len(REGIMES), figsize=(13, 4.2), sharey=True, layout="constrained")
    for axis, (regime, what) in zip(axes, REGIMES.items(), strict=True):
        for found in results:
            if found.regime == regime:
                style, colour = "o--" if "b =" in found.setting else "o-", COLOURS[names.index(found.setting)]
                axis.plot(steps, list(found.distances.values()), style, color=colour, label=found.setting, ms=4)
        axis.axhline(0.1, color="0.5", lw=0.8, ls=":")
        axis.set_xscale("log", base=2)
        axis.set_yscale("log")
        axis.set_xticks(steps, [str(count) for count in steps])
        axis.set_title(f"{regime}: {what}", fontsize=10)
        axis.set_xlabel("MuJoCo steps per sample of 1.5 ms")
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("largest distance of the tips (mm)")
    axes[0].text(1.05, 0.13, "0.1 mm", color="0.4", fontsize=8)
    figure.legend(*axes[1].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    save_figure(figure, path, dpi=110)
