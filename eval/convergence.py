"""Observed order of convergence of the integrator: `python eval/convergence.py`.

Integrates the same torques with 1, 2, 4 and 8 steps per control period and compares the tip with SciPy's DOP853 between
events that `solve_ivp` locates: without Coulomb friction, and on a motion that sticks and breaks away again and again.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import one_line_errors, stop_without

try:
    import numpy as np
    import sympy  # noqa: F401  needed when the full arm's turn comes
    import tyro
    from numpy.typing import NDArray
    from rich.console import Console
    from rich.table import Table

    from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS, ArmParams, BeltArmEnv
    from eval.verification.event_located import MODELS, EventLocatedArm, tip
except ModuleNotFoundError as error:
    stop_without("eval/convergence.py", error)

Floats = NDArray[np.float64]

STEPS = (1, 2, 4, 8)  # per control period
REGIMES = {"smooth": 0.0, "stick-slip": ArmParams().coulomb_friction}
"""Coulomb friction [N m]."""


@dataclass(frozen=True, slots=True)
class Config:
    """Print the integrator's error against its step, and the order of convergence."""

    samples: int = EPISODE_STEPS
    """Length of the motion in control periods, 1 to 1200."""

    def check(self) -> None:
        """Check the length.

        Raises:
            ValueError: If it is out of range.
        """
        if not 1 <= self.samples <= EPISODE_STEPS:
            raise ValueError(f"--samples must lie within 1 and {EPISODE_STEPS}, got {self.samples}")


@dataclass(frozen=True, slots=True)
class Convergence:
    """Errors of one model in one regime."""

    model: str
    regime: str
    errors: Floats  # largest tip distance [m] for each of STEPS
    stops: int  # how often the motor came to stick

    @property
    def orders(self) -> Floats:
        """log2 of how much a halved step improves, shape (len(STEPS) - 1,)."""
        return np.log2(self.errors[:-1] / self.errors[1:])


def torques(samples: int) -> Floats:
    """Motor torque of each sample [N m]: a sine of 3 Hz, half as large again as Coulomb friction."""
    return 0.048 * np.sin(2 * np.pi * 3 * CONTROL_PERIOD * np.arange(samples))


def convergence(model: str, regime: str, samples: int = EPISODE_STEPS) -> Convergence:
    """Measure one model in one regime, from 45 degrees with the belt wound up by 20 mrad."""
    params = ArmParams(coulomb_friction=REGIMES[regime])
    start = np.array([params.gear_ratio * np.pi / 4, 0.0, 0.02, 0.0])
    exact, stops = _exact(model, params, start, torques(samples))
    errors = [np.linalg.norm(_tips(model, params, start, torques(samples), n) - exact, axis=1).max() for n in STEPS]
    return Convergence(model, regime, np.array(errors), stops)


def _exact(model: str, params: ArmParams, start: Floats, demands: Floats) -> tuple[Floats, int]:
    """Tip [m] after each sample, shape (samples, 2), and how often the motor came to stick."""
    arm = EventLocatedArm(params, start, model)
    tips = []
    for torque in demands.tolist():
        arm.advance(torque, CONTROL_PERIOD)
        tips.append(tip(params, arm.state))
    return np.array(tips), sum(mode == "stuck" for _, mode in arm.mode_changes)


def _tips(model: str, params: ArmParams, start: Floats, demands: Floats, steps: int) -> Floats:
    env = BeltArmEnv(model=model)  # pyright: ignore[reportArgumentType]
    options = {"params": {"coulomb_friction": params.coulomb_friction}, "state": start}
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


def main() -> None:
    """Command line."""
    config = tyro.cli(Config, description=__doc__)
    with one_line_errors("eval/convergence.py"):
        config.check()
        Console().print(table([convergence(m, r, config.samples) for m in MODELS for r in REGIMES]))


if __name__ == "__main__":
    main()
