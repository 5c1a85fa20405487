"""Order of convergence of the integrator, its errors on many arms, and the full arm in two engines.

Torques are integrated with 1, 2, 4 and 8 steps per control period, and compared with a solution by SciPy's DOP853 that
locates all events. Then arms are moved by the paper's controller, and back and forth so that the motor sticks and
breaks away: the same torques go into this package's kernel and into MuJoCo, from the same state and without feedback.
"""

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from baselines import PaperController
from baselines.registry import CONTROLLERS
from baselines.tools.progress import progress_over
from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS, ArmParams, BeltArmEnv, BeltArmVectorEnv
from beltarm_env.arm import params_columns, params_table
from beltarm_env.arrays import Floats
from beltarm_env.mujoco.drive import EXPRESSIBLE
from beltarm_env.rollout import rollout
from beltarm_env.task.ranges import DRIVE_RANGES
from beltarm_env.task.reference import MoveShape
from beltarm_env.task.seeds import CROSSCHECK
from eval.comparison.rollouts import side_by_side
from eval.reference.event_located import MODELS, EventLocatedArm, tip
from eval.report.style import COLOURS, below, panels
from eval.studies._frame import Bounds, OptionsWithJobs, Pictures
from eval.studies.physics.errors import DRIVERS, FINE, SENSITIVE, SETS, cost_change, errors_of

QUICK = {"arms": 1, "samples": 40, "drawn": 2}
STEPS = (1, 2, 4, 8)
"""Steps per control period, of the kernel and of MuJoCo."""

ARMS = {
    "smooth": ArmParams(coulomb_friction=0.0),
    "stick-slip": ArmParams(),
    "drive": ArmParams(**{name: high for name, (_, high) in DRIVE_RANGES.items()}),
}
"""Arms whose order is measured: without Coulomb friction; the paper's; with all effects of the drive at their upper
ends in training."""
REGIMES = {
    "smooth": "no Coulomb friction",
    "moves": "the benchmark's moves",
    "stick-slip": "back and forth",
    "drive": "back and forth behind a drive",
}
"""Kinds of motion in which the engines are compared."""
DRIVE = {name: DRIVE_RANGES[name][1] for name in EXPRESSIBLE}
"""Effects of the drive that MuJoCo can express, at the upper ends of the training ranges."""
SETTINGS = {
    "RK4": {"integrator": "rk4"},
    "implicitfast": {"integrator": "implicitfast"},
    "Euler": {"integrator": "euler"},
    "RK4, d = 0.9, b = 100/s": {"integrator": "rk4", "friction_impedance": 0.9, "friction_rate": 100.0},
    "RK4, d = 0.9999, b = 100/s": {"integrator": "rk4", "friction_impedance": 0.9999, "friction_rate": 100.0},
    "RK4, d = 0.9999, b = 400/s": {"integrator": "rk4", "friction_impedance": 0.9999, "friction_rate": 400.0},
}
"""Arguments of `load_model`. The first three have its friction, d = 0.9999 and b in proportion to 1 / step; the others
differ from the first in friction alone, beginning with MuJoCo's own."""


@dataclass(frozen=True)
class Options(OptionsWithJobs):
    """Options of the study."""

    bounds = OptionsWithJobs.bounds | Bounds(
        arms=(1, CROSSCHECK.size), seed=(0, None), samples=(1, EPISODE_STEPS), drawn=(1, 10_000)
    )

    arms: int = 8
    """Arms of each kind of motion in MuJoCo, 1 to 1000."""
    seed: int = CROSSCHECK.first
    """Seed of the first arm. Arm i has seed + i."""
    samples: int = EPISODE_STEPS
    """Length of the motions in control periods, 1 to 1200."""
    drawn: int = 1000
    """Arms of each set whose samples are integrated in more steps, 1 to 10000."""


def measure(options: Options) -> dict[str, Any]:
    """Errors and orders of the kernel, and distances of MuJoCo from it."""
    from beltarm_env.mujoco.model import mujoco  # the other studies can do without it

    cases = [(model, regime) for model in MODELS for regime in ARMS]
    kinds = [(name, model, driver) for name in SETS for model in MODELS for driver in DRIVERS]
    tried = [(*kind, options.drawn, options.samples) for kind in kinds]
    errors = side_by_side("errors of the step", errors_of, tried, options.jobs)
    closed = [(name, options.drawn) for name in CONTROLLERS]
    costs = side_by_side("costs in closed loop", cost_change, closed, options.jobs)
    return {
        "mujoco": mujoco.__version__,
        "fine": FINE,
        "sensitive": SENSITIVE,
        "sets": SETS,
        "errors": [errors[each] for each in tried],
        "costs": [costs[each] for each in closed],
        "steps": STEPS,
        "drive": DRIVE,
        "convergence": [
            measure_convergence(*case, options.samples) for case in progress_over("orders of convergence", cases)
        ],
        "engines": compare_engines(options.arms, options.seed, options.samples),
    }


@dataclass(frozen=True, slots=True)
class Convergence:
    """Errors of one model in one regime over the number of steps."""

    model: str
    regime: str
    errors: Floats  # largest tip distance [m] for each of STEPS
    stops: int  # of the motor, which then stuck


def measure_convergence(model: str, regime: str, samples: int = EPISODE_STEPS) -> Convergence:
    """Measure one model in one regime, from 45 degrees with the belt wound up by 20 mrad."""
    params = ARMS[regime]
    commands = _sine(samples, params)
    start = np.array([params.gear_ratio * np.pi / 4, 0.0, 0.02, 0.0])
    arm = EventLocatedArm(params, start, model)
    exact = np.empty((samples, 2))
    for k, torque in enumerate(commands.tolist()):
        arm.sample(torque)
        exact[k] = tip(params, arm.state)
    errors = [np.linalg.norm(_simulated_tips(model, params, start, commands, n) - exact, axis=1).max() for n in STEPS]
    return Convergence(model, regime, np.array(errors), sum(mode == "stuck" for _, mode in arm.mode_changes))


def _sine(samples: int, params: ArmParams) -> Floats:
    """Command of each sample [N m]: a sine of 3 Hz, half as large again as the friction that holds the paper's motor.

    Static friction counts: 48 mN m of an ideal drive.
    """
    amplitude = 0.048 * (1 + params.static_friction_excess)
    return amplitude * np.sin(2 * np.pi * 3 * CONTROL_PERIOD * np.arange(samples))


def _simulated_tips(model: str, params: ArmParams, start: Floats, demands: Floats, steps: int) -> Floats:
    env = BeltArmEnv(model=model)  # pyright: ignore[reportArgumentType]
    env.reset(seed=0, options={"params": asdict(params), "state": start})
    env.set_integration_steps(steps)
    tips = []
    for torque in demands.tolist():
        env.step(np.array([torque / params.torque_limit]))
        tips.append(tip(params, env.state))
    return np.array(tips)


@dataclass(frozen=True, slots=True)
class Motion:
    """One arm, its torques and where the kernel's full arm goes."""

    params: ArmParams
    torques: Floats  # commanded [N m]     (T,)
    start: Floats  # x at the beginning     (4,)
    tips: Floats  # after each sample [m]     (T, 2)
    stops: int  # samples in which the motor came to rest


def motions(regime: str, arms: int, seed: int, samples: int = EPISODE_STEPS) -> list[Motion]:
    """Arms, torques and where the kernel takes them in some samples; arm i has seed + i.

    A regime is "smooth", without Coulomb friction; "moves", as the benchmark has them; "stick-slip", a torque that goes
    back and forth; or "drive", the same through `DRIVE`.
    """
    env = BeltArmVectorEnv(arms, randomization="ideal")
    env.reset(seed=seed)
    changes = {"smooth": {"coulomb_friction": 0.0}, "drive": DRIVE}.get(regime, {})
    params = [replace(p, **changes) for p in env.params]
    moves = env.moves
    starts = np.zeros((arms, 4))
    starts[:, 0] = [p.gear_ratio for p in params] * moves[:, 0]
    if regime in ("stick-slip", "drive"):
        starts[:, 0] = params[0].gear_ratio * np.pi / 4
        periods = 2 * np.pi * CONTROL_PERIOD * np.arange(EPISODE_STEPS)[:, None]
        friction = np.array([p.coulomb_friction for p in params])
        torques = 1.5 * friction * np.sin(np.linspace(2.0, 5.0, arms) * periods)
    else:
        torques = _under_the_papers_controller(params, moves, friction=regime != "smooth")
    return _in_the_kernel(params, starts, torques[:samples])


def _under_the_papers_controller(params: list[ArmParams], moves: Floats, friction: bool) -> Floats:
    controller = PaperController(ArmParams() if friction else ArmParams(coulomb_friction=0.0))
    options = {
        "params": params_columns(params_table(params)),
        "move": dict(zip(MoveShape._fields, moves.T, strict=True)),
    }
    return rollout(controller, len(params), seed=0, options=options, model="lagrangian").torque


def _in_the_kernel(params: list[ArmParams], starts: Floats, torques: Floats) -> list[Motion]:
    env = BeltArmVectorEnv(len(params), model="lagrangian", autoreset_mode="Disabled")
    env.reset(seed=0, options={"params": params_columns(params_table(params)), "state": starts})
    limits = np.array([p.torque_limit for p in params])
    states = np.empty((len(torques), len(params), 4))
    for k, torque in enumerate(torques):
        _, _, terminated, _, _ = env.step((torque / limits)[:, None])  # pyright: ignore[reportArgumentType]
        if terminated.any():
            raise ValueError(f"arm {int(np.argmax(terminated))} left the workspace: choose another --seed")
        states[k] = env.state
    at_rest = states[:, :, 1] == 0
    stops = np.sum(at_rest[1:] & ~at_rest[:-1], axis=0)
    tips = [np.array([tip(p, x) for x in states[:, arm]]) for arm, p in enumerate(params)]
    arms = zip(params, torques.T, starts, tips, stops.tolist(), strict=True)
    return [Motion(*arm) for arm in arms]


def distance(motion: Motion, steps: int, **settings: object) -> float:
    """Largest distance of MuJoCo's tip from the kernel's [m], with some MuJoCo steps per sample."""
    from beltarm_env.mujoco.engine import MuJoCoArm

    arm = MuJoCoArm(motion.params, steps, **settings)
    arm.begin(motion.start)
    worst = 0.0
    for torque, there in zip(motion.torques.tolist(), motion.tips, strict=True):
        worst = max(worst, float(np.linalg.norm(tip(motion.params, arm.advance(torque)) - there)))
    return worst


def compare_engines(arms: int, seed: int, samples: int) -> list[dict[str, Any]]:
    """Largest distances [m] over the arms in every regime, under the settings of MuJoCo that matter to it."""
    results = []
    for regime in progress_over("kinds of motion", REGIMES):
        cases = motions(regime, arms, seed, samples)
        stops = sum(motion.stops for motion in cases)
        for name, setting in SETTINGS.items():
            if regime in ("smooth", "drive") and "friction_rate" in setting:
                continue
            worst = [max(distance(motion, steps, **setting) for motion in cases) for steps in STEPS]
            results.append({"regime": regime, "setting": name, "stops": stops, "distances": worst})
    return results


def tables(data: dict[str, Any]) -> dict[str, Any]:
    """Kinds of motion, and how the template writes orders and distances."""
    return {
        "regimes": REGIMES,
        "order": lambda errors: f"{np.log2(errors[0] / errors[-1]) / (len(errors) - 1):.2f}",  # by halved steps
        "millimetres": lambda distance: f"{1e3 * distance:{'.2g' if distance >= 1e-7 else '.0e'}}",
    }


def pictures(data: dict[str, Any]) -> Pictures:
    """The distance of the two engines."""
    return {"distance.png": lambda: _distances(data["engines"], data["steps"])}


def _distances(rows: list[dict[str, Any]], steps: list[int]) -> Figure:
    """Distance over the number of steps, a panel per regime."""
    names = list(SETTINGS)
    figure, axes = panels(len(REGIMES), len(REGIMES), (3.25, 4.2), sharey=True)
    for axis, (regime, title) in zip(axes, REGIMES.items(), strict=True):
        for row in rows:
            if row["regime"] == regime:
                style, colour = "o--" if "b =" in row["setting"] else "o-", COLOURS[names.index(row["setting"])]
                values = 1e3 * np.array(row["distances"])
                axis.plot(steps, values, style, color=colour, label=row["setting"], ms=4)
        axis.axhline(0.1, color="0.5", lw=0.8, ls=":")
        axis.set_xscale("log", base=2)
        axis.set_xticks(steps, [str(count) for count in steps])
        axis.set(yscale="log", xlabel="MuJoCo steps per sample of 1.5 ms")
        axis.set_title(f"{regime}: {title}", fontsize=10)
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("largest distance of the tips (mm)")
    axes[0].text(1.05, 0.13, "0.1 mm", color="0.4", fontsize=8)
    below(figure, axes[1], 3)
    return figure
