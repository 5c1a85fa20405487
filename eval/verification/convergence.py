"""Observed order of convergence of the integrator, against SciPy's DOP853 between located events."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
import sympy  # noqa: F401  needed when the full arm's turn comes
from numpy.typing import NDArray
from rich.table import Table

from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS, ArmParams, BeltArmEnv
from beltarm_env.task.ranges import DRIVE_RANGES
from eval.verification.event_located import EventLocatedArm, tip

Floats = NDArray[np.float64]

STEPS = (1, 2, 4, 8)  # per control period
REGIMES = {
    "smooth": ArmParams(coulomb_friction=0.0),
    "stick-slip": ArmParams(),
    "drive": ArmParams(**{name: high for name, (_, high) in DRIVE_RANGES.items()}),
}
"""Arms: without Coulomb friction; the paper's; behind a drive whose effects are all at their upper ends in training."""


@dataclass(frozen=True, slots=True)
class Convergence:
    """Errors of one model in one regime over the number of steps."""

    model: str
    regime: str
    errors: Floats  # largest tip distance [m] for each of STEPS
    stops: int  # of the motor, which then stuck

    @property
    def orders(self) -> Floats:
        """Observed order, log2 of the ratio of errors at a halved step, shape (len(STEPS) - 1,)."""
        return np.log2(self.errors[:-1] / self.errors[1:])


def torques(samples: int, params: ArmParams) -> Floats:
    """Command of each sample [N m]: a sine of 3 Hz, half as large again as the friction that holds the paper's motor.

    Static friction counts: 48 mN m of an ideal drive.
    """
    amplitude = 0.048 * (1 + params.static_friction_excess)
    return amplitude * np.sin(2 * np.pi * 3 * CONTROL_PERIOD * np.arange(samples))


def measure_convergence(model: str, regime: str, samples: int = EPISODE_STEPS) -> Convergence:
    """Measure one model in one regime, from 45 degrees with the belt wound up by 20 mrad."""
    params = REGIMES[regime]
    commands = torques(samples, params)
    start = np.array([params.gear_ratio * np.pi / 4, 0.0, 0.02, 0.0])
    exact, stops = _exact_tips(model, params, start, commands)
    errors = [np.linalg.norm(_simulated_tips(model, params, start, commands, n) - exact, axis=1).max() for n in STEPS]
    return Convergence(model, regime, np.array(errors), stops)


def _exact_tips(model: str, params: ArmParams, start: Floats, demands: Floats) -> tuple[Floats, int]:
    """Tip [m] after each sample, shape (samples, 2), and of the motor, which then stuck."""
    arm = EventLocatedArm(params, start, model)
    tips = []
    for torque in demands.tolist():
        arm.sample(torque)
        tips.append(tip(params, arm.state))
    return np.array(tips), sum(mode == "stuck" for _, mode in arm.mode_changes)


def _simulated_tips(model: str, params: ArmParams, start: Floats, demands: Floats, steps: int) -> Floats:
    env = BeltArmEnv(model=model)  # pyright: ignore[reportArgumentType]
    options = {"params": asdict(params), "state": start}
    env.reset(seed=0, options=options)
    env.set_integration_steps(steps)
    tips = []
    for torque in demands.tolist():
        env.step(np.array([torque / params.torque_limit]))
        tips.append(tip(params, env.state))
    return np.array(tips)


def table(results: list[Convergence]) -> Table:
    """Errors and orders, a row per model and regime."""
    out = Table(title="largest tip error (nm) against the steps per control period", title_justify="left")
    for title in ("model", "regime", "stops"):
        out.add_column(title, no_wrap=True)
    for steps in STEPS:
        out.add_column(str(steps), justify="right", no_wrap=True)
    out.add_column("order", justify="right", no_wrap=True)
    for r in results:
        errors = [f"{1e9 * error:.2g}" if error > 1e-12 else f"{1e9 * error:.0e}" for error in r.errors]
        out.add_row(r.model, r.regime, str(r.stops), *errors, f"{r.orders.mean():.2f}")
    return out
