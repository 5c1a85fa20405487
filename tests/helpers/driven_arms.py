"""Arms for the tests: the environment's beside the event-located solution, behind an ideal drive and a built one."""

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS, ArmParams, BeltArmEnv
from beltarm_env.task.ranges import DRIVE_RANGES, IDEAL_RANGES, PRESLIDING
from eval.reference.event_located import EventLocatedArm, tip

Command = Callable[[int, EventLocatedArm], float]  # torque [N m] of the sample and the arm
GEAR = 88.0
MODELS = ("lumped", "lagrangian")
LOSSLESS = {"coulomb_friction": 0.0, "motor_viscous_friction": 0.0, "belt_damping_ratio": 0.0}
UPPER_ENDS = {name: high for name, (_, high) in DRIVE_RANGES.items()}
GIVES = {name: high for name, (_, high) in PRESLIDING.items()}


def at_rest(joint: float, torsion: float = 0.0, torsion_speed: float = 0.0, gear: float = GEAR) -> np.ndarray:
    return np.array([gear * joint, 0.0, torsion, torsion_speed])


def arm_env(params: Mapping[str, Any], state: np.ndarray, model: str = "lumped", **settings: Any) -> BeltArmEnv:
    env = BeltArmEnv(model=model, **settings)  # pyright: ignore[reportArgumentType]
    env.reset(seed=0, options={"params": dict(params), "move": {"start": math.pi / 4, "goal": 1.2}, "state": state})
    return env


def apply(env: BeltArmEnv, torque: float) -> np.ndarray:
    """Step with a torque [N m]; the arm must stay in its workspace."""
    observation, _, terminated, _, _ = env.step(np.array([torque / env.params.torque_limit]))
    assert not terminated, f"the arm left the workspace at {env.time:.3f} s: no test of anything"
    return observation


def largest_distance(
    params: ArmParams | Mapping[str, Any],
    state: np.ndarray,
    command: Command,
    model: str = "lumped",
    samples: int = EPISODE_STEPS,
    steps: int = 1,
) -> tuple[float, EventLocatedArm]:
    """Largest distance of the tips [m], given the same commands, and the event-located arm at the end."""
    env = arm_env(asdict(params) if isinstance(params, ArmParams) else params, state, model)
    env.set_integration_steps(steps)
    constants, worst = env.params, 0.0
    arm = EventLocatedArm(constants, state, model)
    for k in range(samples):
        torque = command(k, arm)
        apply(env, torque)
        arm.sample(torque)
        worst = max(worst, float(np.linalg.norm(tip(constants, env.state) - tip(constants, arm.state))))
    return worst, arm


def stops(arm: EventLocatedArm) -> int:
    return sum(mode == "stuck" for _, mode in arm.mode_changes)


def wave(amplitude: float, frequency: float) -> Command:
    """Sine of an amplitude [N m] and a frequency [Hz]."""
    return lambda k, _: amplitude * math.sin(2 * math.pi * frequency * k * CONTROL_PERIOD)


def full_arm_at(params: ArmParams, theta_1: float, phi: float) -> EventLocatedArm:
    return EventLocatedArm(params, np.array([params.gear_ratio * theta_1, 0.0, theta_1 - phi, 0.0]), "lagrangian")


def random_params(rng: np.random.Generator) -> ArmParams:
    """Any arm within a factor of three of the nominal one, with a payload."""
    nominal = ArmParams()
    fields = ("gear_ratio", "link_length", "motor_inertia", "arm_inertia", "arm_inertia_swing", "belt_stiffness")
    drawn = {name: getattr(nominal, name) * 3 ** rng.uniform(-1, 1) for name in fields}
    return ArmParams(**drawn, payload_mass=rng.uniform(0, 0.5))


def push(sample: int, _: object = None) -> float:
    """Command [N m]: a 3 Hz wave of a fifth of the torque limit and a square one of a tenth at 1.7 Hz."""
    time = sample * CONTROL_PERIOD
    return 0.06 * math.sin(6 * math.pi * time) + math.copysign(0.03, math.sin(3.4 * math.pi * (time + 1e-9)))


def swing(sample: int, arm: EventLocatedArm) -> float:
    """Command [N m] of a servo that swings the joint from 0.2 to 1.35 rad and back, 0.4 s each way."""
    time = sample * CONTROL_PERIOD - 0.1
    turn = 2 * math.pi / 0.8
    way = 1.15 * 0.5 * (1 - math.cos(turn * min(max(time, 0.0), 0.8)))
    rate = 1.15 * 0.5 * turn * math.sin(turn * time) if 0 < time < 0.8 else 0.0
    gear, (angle, speed, _, _) = arm.params.gear_ratio, arm.state.tolist()
    demand = 400 * (gear * (0.2 + way) - angle) + 40 * (gear * rate - speed)
    limit = arm.params.torque_limit
    return min(max(7e-5 * demand, -limit), limit)


def drawn_arms(count: int, seed: int) -> list[dict[str, Any]]:
    """Arms of the training ranges behind drives at the upper ends, with phases and orders of their own."""
    rng, arms = np.random.default_rng(seed), []
    for k in range(count):
        arm = {name: rng.uniform(*pair) for name, pair in IDEAL_RANGES.items()} | UPPER_ENDS
        arm |= {name: rng.uniform(*DRIVE_RANGES[name]) for name in DRIVE_RANGES if name.endswith("_phase")}
        arm["torque_ripple_order"] = float(rng.integers(4, 13))
        if k % 2:
            arm["stribeck_speed"] = DRIVE_RANGES["stribeck_speed"][0]  # at which friction changes fastest
        arms.append(arm)
    return arms
