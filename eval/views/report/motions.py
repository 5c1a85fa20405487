"""Pictures of motions: tip error, torque, phase plane, spectrum of the residual vibration."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy.signal import detrend
from scipy.signal.windows import hann

from baselines.models.modes import held_mode
from beltarm_env.arm import ArmParams
from beltarm_env.rollout import Recording
from beltarm_env.timing import CONTROL_PERIOD
from eval.views.report.scenes import Scene
from eval.views.report.svg import MUTED, SHADE, WIDTH, Panel, line, panel, panel_style

Floats = NDArray[np.float64]
_EVERY = 3  # samples; 4.5 ms are finer than a line on the page
_PADDED = 8192  # samples of a spectrum, most of them zeros: interpolates, does not resolve
_HIGHEST_HZ = 25.0


def scene_panels(scene: Scene, number: int, colours: dict[str, str]) -> list[Panel]:
    """Pictures of one scene: tip error, torque, spectrum, phase plane."""
    drawn = {
        "tip error": _tip_error,
        "motor torque": _torque,
        "spectrum after the move": _spectrum,
        "belt's phase plane": _phase,
    }
    with panel_style():
        return [_panel(scene, f"scene{number}", title, draw, colours) for title, draw in drawn.items()]


Draw = Callable[[Axes, Recording, dict[str, Any]], float]
"""Draws one motion with a style; returns the number that the alternative text names."""


def _panel(scene: Scene, name: str, title: str, draw: Draw, colours: dict[str, str]) -> Panel:
    figure, axis = plt.subplots(figsize=(WIDTH, 2.7), layout="constrained")
    said = []
    for method, recording in scene.motions.items():
        style = {"lw": 1.3} | line(colours, method)
        said.append(f"{method} {draw(axis, recording, style):.3g}")
    first = next(iter(scene.motions.values()))
    unit = _finish(axis, title, first)
    axis.grid()
    key = f"{name}-{title.split()[0].replace(chr(39), '')}"
    return panel(
        figure, key, title, f"{title} on scenario {scene.scenario} of {scene.split}, {unit}: {', '.join(said)}."
    )


def _finish(axis: Axes, title: str, recording: Recording) -> str:
    """Label and mark an axis; returns the quantity and unit of the numbers in the alternative text."""
    duration = recording.moves[0, 2]
    if title in ("tip error", "motor torque"):
        axis.axvspan(0, duration, color=SHADE, zorder=0, lw=0)
        axis.text(duration / 2, 1.01, "move", transform=axis.get_xaxis_transform(), ha="center", color=MUTED)
        axis.set(xlabel="time (s)", xlim=(0, recording.time[-1]))
    if title == "tip error":
        axis.set(ylabel="tip error (mm)", yscale="log")
        axis.set_ylim(bottom=max(axis.get_ylim()[0], 0.01))
        return "largest in mm"
    if title == "motor torque":
        axis.set_ylabel("torque (N m)")
        return "largest in N m"
    if title.startswith("spectrum"):
        hertz = _mode(recording)
        axis.axvline(hertz, color=MUTED, ls=":", lw=1.2)
        label = f"mode: {hertz:.1f} Hz, {2 * np.pi * hertz:.0f} rad/s"
        beside = "left" if hertz < 0.3 * _HIGHEST_HZ else "center"
        axis.text(hertz, 1.01, label, transform=axis.get_xaxis_transform(), ha=beside, color=MUTED)
        axis.set(xlabel="frequency (Hz)", ylabel="tip amplitude (mm)", xlim=(0, _HIGHEST_HZ), ylim=(0, None))
        return "peak in mm"
    axis.set(xlabel="belt torsion (mrad)", ylabel="its rate (rad/s)")
    return "largest torsion in mrad"


def _tip_error(axis: Axes, recording: Recording, style: dict[str, Any]) -> float:
    error = 1000 * np.linalg.norm(recording.tip_error[:, 0], axis=1)
    axis.plot(recording.time[::_EVERY], np.maximum(error[::_EVERY], 1e-3), **style)
    return float(error.max())


def _torque(axis: Axes, recording: Recording, style: dict[str, Any]) -> float:
    torque = recording.torque[:, 0]
    axis.plot(recording.time[::_EVERY], torque[::_EVERY], **style)
    return float(np.abs(torque).max())


def _phase(axis: Axes, recording: Recording, style: dict[str, Any]) -> float:
    torsion = 1000 * recording.state[:, 0, 2]
    axis.plot(torsion[::_EVERY], recording.state[::_EVERY, 0, 3], **style)
    return float(np.abs(torsion).max())


def _spectrum(axis: Axes, recording: Recording, style: dict[str, Any]) -> float:
    hertz, amplitude = spectrum(recording)
    shown = hertz <= _HIGHEST_HZ
    axis.plot(hertz[shown], amplitude[shown], **style)
    return float(amplitude.max())


def spectrum(recording: Recording) -> tuple[Floats, Floats]:
    """Amplitudes of the tip's vibration after the move.

    Both components of the tip error from the move's end on are detrended and windowed (Hann); a sine of amplitude a
    gives a peak of height a. Resolution: about 2 / (time after the move), 2 to 3 Hz.

    Returns:
        Frequencies [Hz] and amplitudes, both components together [mm], each of shape (n,).
    """
    after = recording.time > recording.moves[0, 2]
    motion = detrend(1000 * recording.tip_error[after, 0], axis=0)
    window = hann(len(motion), sym=False)[:, None]
    lines = 2 * np.abs(np.fft.rfft(motion * window, _PADDED, axis=0)) / window.sum()
    hertz = np.arange(len(lines)) / (_PADDED * CONTROL_PERIOD)
    return hertz, np.sqrt(np.sum(lines**2, axis=1))


def _mode(recording: Recording) -> float:
    """Frequency of this arm's mode at the goal with the motor held [Hz]."""
    params = ArmParams.from_row(recording.params[0])
    return float(1 / held_mode(params, recording.moves[:, 1]).period[0])
