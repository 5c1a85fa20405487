"""Linear law of every classical controller, for an arm at rest at an angle.

A law is written as the controller runs it, from one sample to the next, for deviations from the rest:

    (tau_m, memory) <- step(theta_a, omega_a by differencing, tau_m of the last sample, memory)

Left out are Coulomb friction and its compensation, the encoder's resolution and the limits: of the torque, of integrals
and of estimates. What is left is linear, so that `baselines.loops.models` finds its matrices by probing it.

To add a controller, add its law to `LAWS`: `tests/baselines/test_loops.py` then holds it against the controller itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from baselines.estimation.believed_arm import DISTURBANCE, SHORTEST, nominal_row
from baselines.estimation.observer import QUANTUM, Noise, kalman_gains, steady_gain
from baselines.models.linear import ANGLES, dead_time, linear_arm
from baselines.models.rigid_arm import inertia_at
from baselines.optimal.adaptive import AdaptiveController
from baselines.optimal.lqg import LqgController, feedback_gains
from baselines.optimal.mpc import MpcController, horizon, plan
from baselines.optimal.preview import PreviewController
from baselines.optimal.robust import RobustController
from baselines.planning.plan import GAIN, planned
from baselines.servo.adrc import AdrcController, ExtendedState, feedback, observe, observer_gains
from baselines.servo.disturbance import DisturbanceController
from baselines.servo.flat import FlatController
from baselines.servo.paper import PaperController, RetunedController, next_torsion
from baselines.servo.shaping import EiController, ZvController, ZvdController
from baselines.servo.smooth import SmoothController
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arrays import Floats
from beltarm_env.physics.sampled import sampled_state_space
from beltarm_env.task.reference import MoveShape

_linear_arm = lru_cache(maxsize=16)(linear_arm)

Step = Callable[[float, float, float, Floats], tuple[float, Floats]]


class Law(NamedTuple):
    """A linear law: the size of its memory, and its step from sample to sample."""

    size: int
    step: Step  # angle [rad], speed [rad/s], last torque [N m], memory (size,) -> torque [N m], memory


def torsion_feedback(params: ArmParams, theta_1: float, inertia: float, gains: Any) -> Law:
    """Eq. (11) at a joint angle [rad], torsion simulated; memory: torsion, its rate, the joint's last speed."""
    plant = params.plant()

    def step(angle: float, speed: float, last: float, memory: Floats) -> tuple[float, Floats]:
        joint_speed = speed / params.gear_ratio
        torsion, rate = next_torsion(memory[0], memory[1], joint_speed - memory[2], theta_1, plant)
        servo = -inertia * (gains.speed * speed + gains.angle * angle)
        torque = servo + params.motor_viscous_friction * speed - gains.torsion_speed * rate
        return torque, np.array([torsion, rate, joint_speed])

    return Law(3, step)


def paper_law(controller: PaperController, k: int) -> Law:
    """Table 2 on the motor's inertia alone; with K_4 = 0 nothing of the simulation reaches the torque."""
    params, gains = controller.params, controller.gains
    if gains.torsion_speed != 0:
        return torsion_feedback(params, ANGLES[k], params.motor_inertia, gains)

    def step(angle: float, speed: float, last: float, memory: Floats) -> tuple[float, Floats]:
        servo = -params.motor_inertia * (gains.speed * speed + gains.angle * angle)
        return servo + params.motor_viscous_friction * speed, memory

    return Law(0, step)


def retuned_law(controller: RetunedController, k: int) -> Law:
    """Torsion feedback with the inertia of the links."""
    inertia = inertia_at(ANGLES[k], controller.params.plant())
    return torsion_feedback(controller.params, ANGLES[k], inertia, controller.gains)


def pid_law(controller: Any, k: int) -> Law:
    """PID; memory: the integral of the error [rad s]."""
    inertia, gains = inertia_at(ANGLES[k], controller.params.plant()), controller.gains

    def step(angle: float, speed: float, last: float, memory: Floats) -> tuple[float, Floats]:
        torque = inertia * (gains.angle * (gains.integral * memory[0] - angle) - gains.speed * speed)
        return torque, memory - CONTROL_PERIOD * angle

    return Law(1, step)


def disturbance_law(controller: DisturbanceController, k: int) -> Law:
    """PD with the load's two filters; memory: both, the speed and the known torque of the last sample."""
    params, gains = controller.params, controller.gains
    shares = 1 - np.exp(-CONTROL_PERIOD * np.array([gains.observer, gains.reaction]))

    def step(angle: float, speed: float, last: float, memory: Floats) -> tuple[float, Floats]:
        latest = last - memory[3] - params.motor_inertia * (speed - memory[2]) / CONTROL_PERIOD
        load, fast_load = memory[:2] + shares * (latest - memory[:2])
        servo = -params.motor_inertia * (gains.angle * angle + gains.speed * speed)
        known = params.motor_viscous_friction * speed
        torque = servo - (gains.reaction_gain - 1) * (fast_load - load) + known + load
        return torque, np.array([load, fast_load, speed, known])

    return Law(4, step)


def adrc_law(controller: AdrcController, k: int) -> Law:
    """Both bandwidths; memory: the observer's state, and the pushes before the last one."""
    params, gains = controller.params, controller.gains
    inertia = inertia_at(ANGLES[k], params.plant())
    filter_gains = observer_gains(gains.observer)
    whole, rest = divmod(dead_time(params) / CONTROL_PERIOD, 1.0)
    late = int(whole)

    def step(angle: float, speed: float, last: float, memory: Floats) -> tuple[float, Floats]:
        pushes = np.array([last, *memory[3:]])
        acting = pushes[late] + rest * (pushes[late + 1] - pushes[late])
        state = observe(ExtendedState(*memory[:3]), acting / inertia, angle, filter_gains)
        return inertia * feedback(state, gains.bandwidth), np.append(state, pushes[:-1])

    return Law(4 + late, step)


def _ahead_feedback(params: ArmParams, k: int, gain: Floats, noise: Noise) -> Law:
    """-K (x when the command acts, net torque of the last sample) - d, with the motor sliding.

    Memory: the arm behind its drive as `sampled_state_space` has it, d, and what was added to the net torque.
    """
    a, b, _ = sampled_state_space(params, float(ANGLES[k]))
    filter_gain = kalman_gains(params, noise)[k]
    whole, rest = divmod(dead_time(params) / CONTROL_PERIOD, 1.0)
    size = len(a)

    def step(angle: float, speed: float, last: float, memory: Floats) -> tuple[float, Floats]:
        *_, disturbance, added = memory
        z = a @ memory[:size] + b[:, 0] * (last + disturbance)
        innovation = angle - z[0]
        z[:4] += filter_gain[:4] * innovation
        disturbance += filter_gain[4] * innovation
        torques, ahead = b[:, 0] * (last + disturbance), z
        for _ in range(int(whole)):
            ahead = a @ ahead + torques
        ahead = ahead + rest * (a @ ahead + torques - ahead)
        net = float(-gain @ [*ahead[:4], last - added])
        return net - disturbance, np.array([*z, disturbance, -disturbance])

    return Law(size + 2, step)


def lqg_law(controller: LqgController, k: int) -> Law:
    """State feedback, optimal or robust."""
    return _ahead_feedback(controller.params, k, controller.feedback()[k], controller.gains.noise())


def preview_law(controller: PreviewController, k: int) -> Law:
    """Gain of the plan at rest, long before the episode's end: that of LQG with the same weights."""
    params, g = controller.params, controller.gains
    return _ahead_feedback(params, k, feedback_gains(params, g.weights())[k], g.noise())


def _about_rest(params: ArmParams) -> ArmParams:
    """The arm whose mean stiffness is that of a belt about zero torsion, K_s (1 - b), its damping D_s the same.

    A filter that linearises its own simulation has this one at rest.
    """
    soft = 1 - params.belt_stiffening
    stiffness, damping = params.belt_stiffness * soft, params.belt_damping_ratio / soft**0.5
    return replace(params, belt_stiffness=stiffness, belt_damping_ratio=damping, belt_stiffening=0.0)


def adaptive_law(controller: AdaptiveController, k: int) -> Law:
    """State feedback of the plan on the predicted state, the constants held at those of the design model.

    Memory: x and d of the filter, the motor's torque and the commands under way; ripple is left out, and what friction
    adds to the filter's noise at slow speeds.
    """
    row, gains = nominal_row(controller.params), controller.gains
    params, uncertainty, angle = ArmParams.from_row(row), gains.uncertainty(), float(ANGLES[k])
    lag = max(controller.params.current_loop_time_constant, SHORTEST * CONTROL_PERIOD)
    a, b, _ = sampled_state_space(replace(params, current_loop_time_constant=lag), angle)
    gain = planned(np.array([angle, angle, 0.5, 0.2]), row, gains.weights())[0, GAIN : GAIN + 4]  # long before the end
    arm, growth = _linear_arm(_about_rest(params)).at(k), uncertainty.growth()[DISTURBANCE]
    noise = uncertainty.torque, uncertainty.acceleration
    filter_gain = steady_gain(arm, *noise, uncertainty.decay, growth, QUANTUM**2 / 120)  # the constants held
    by_torque = np.append(arm.by_torque, np.zeros(len(a) - 4))
    delay = (params.command_latency + lag) / CONTROL_PERIOD
    whole = int(delay)

    def step(angle: float, speed: float, last: float, memory: Floats) -> tuple[float, Floats]:
        z, d = a @ memory[1:] + b[:, 0] * last + by_torque * memory[0], uncertainty.decay * memory[0]
        innovation = angle - z[0]
        z[:4] += filter_gain[:4] * innovation
        d += filter_gain[4] * innovation
        ahead = [z]
        for _ in range(whole + 1):
            ahead.append(a @ ahead[-1] + b[:, 0] * last + by_torque * d)
        x = ahead[whole] + (delay - whole) * (ahead[whole + 1] - ahead[whole])
        return float(-gain @ x[:4] - d), np.append(d, z)

    return Law(1 + len(a), step)


_horizon = lru_cache(maxsize=8)(horizon)


def mpc_law(controller: MpcController, k: int) -> Law:
    """First torque of the horizon's plan: its derivative by [x, net torque of the last sample] at rest.

    The plan is linear where it keeps within the torque limit: one difference for each entry is exact.
    """
    params, g, angle = controller.params, controller.gains, float(ANGLES[k])
    ahead = _horizon(params, g.weights())
    rest = np.array([ahead.plant.gear * angle, 0.0, 0.0, 0.0, 0.0])
    small = np.diag([1e-3, 1e-2, 1e-5, 1e-3, 1e-3])
    away = 0.5 if angle < 0.8 else -0.5  # of the move's start; it ended long ago
    move, torques = MoveShape(angle + away, angle, 1.0, 0.3), np.empty((6, len(ahead.lengths)))
    for state, row in zip(rest + np.vstack([np.zeros(5), small]), torques, strict=True):
        plan(ahead, move, 100.0, state, 0.0, row)
    gain = (torques[1:, 0] - torques[0, 0]) / small.diagonal()
    return _ahead_feedback(params, k, -gain, g.noise())


LAWS: dict[type, Callable[[Any, int], Law]] = {
    PaperController: paper_law,
    RetunedController: retuned_law,
    **dict.fromkeys((ZvController, ZvdController, EiController), pid_law),
    SmoothController: pid_law,
    FlatController: pid_law,
    DisturbanceController: disturbance_law,
    AdrcController: adrc_law,
    LqgController: lqg_law,
    RobustController: lqg_law,
    PreviewController: preview_law,
    MpcController: mpc_law,
    AdaptiveController: adaptive_law,
}
"""Makers of the law at `ANGLES[k]`, by the type of controller. A subclass inherits none: its law may be another."""


def law_of(controller: Any, k: int) -> Law:
    """Law of a controller at rest at `ANGLES[k]`.

    Raises:
        ValueError: If there is none for its type.
    """
    kind = type(controller)
    if kind not in LAWS:
        remedy = "add one to LAWS in baselines/loops/laws.py, or tune with --no-margins"
        raise ValueError(f"no linear law for {kind.__name__}: {remedy}")
    return LAWS[kind](controller, k)
