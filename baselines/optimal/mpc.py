"""Model predictive control on encoder data: a new plan of the next 0.3 s at every sample, within the torque limit.

    tau_m = u + tau_f - d

u is the net torque of the plan from the *estimated* state, at the time at which the command acts. The command adds what
the plan leaves out, dry friction as in `baselines.optimal.preview` and the estimated bias d. State and bias are
estimated by `baselines.estimation.observer`, a Kalman filter that models stiction. The move is known ahead, the arm is
not: its parameters are those of the design model.

**Plan.** With r = [G phi_ref, G phi_ref', 0, 0] the state's deviation e = x - r obeys, over m samples of constant net
torque u (motor torque less Coulomb friction),

    e+ = A e + b u + c,    c = A r - r+ + a alpha,    alpha = M2'(phi_ref) phi_ref'^2 / (2 M2(phi_ref))

with the linear arm of `baselines.models.linear` at the reference angle half-way through; alpha is the torsional
acceleration by the term that completes (5b). The input is the torque's *change* v, which makes u a fifth state: z = [e,
u_last],

    z+ = F z + g v + h,    F = [A b; 0 1],    g = [b; 1],    h = [c; 0].

Cost. The tip's errors, linear in e (`baselines.planning.tip_error`), are squared, over 10 mm and 200 mm/s as in the
environment's cost, and summed at the end of every step, m-fold, with weights 1 and w_v, and so is rho u^2; R v^2 is
added once per step. After the last step comes the LQR's cost-to-go at the reference's angle (from the discrete
algebraic Riccati equation), about the torsion and torque of the reference. Steps grow in length, to see far ahead with
few unknowns; the first ones are as short as a sample.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

from baselines.estimation.observer import AHEAD, DISTURBANCE, ObserverDesign, observer_design
from baselines.models.friction import SmoothCompensation, smooth_friction
from baselines.models.linear import ANGLES, between, dead_time, linear_arm, place, turning_load
from baselines.optimal.active_set import SIZE, Problem, empty_problem, minimise
from baselines.optimal.preview import ADDED, ObserverController, PreviewGains
from baselines.planning.plan import Weights
from baselines.planning.tip_error import ErrorWeights, add_tip_cost, error_weights, softened_sine, write_tip_errors
from baselines.reading import Sample, move_of
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arm import Plant
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled
from beltarm_env.task.reference import TRAPEZOID, MoveShape, Reference, reference_at

STEPS = np.repeat([1, 2, 4, 8], [8, 6, 6, 20])
"""Length of every step in samples: 0.3 s in all."""


class Horizon(NamedTuple):
    """Constants of the problem: what depends neither on the arm's state nor on the move."""

    plant: Plant
    lengths: NDArray[np.int64]  # of the steps, in samples    (N,)
    which: NDArray[np.int64]  # row of the tables that belongs to a step's length    (N,)
    transition: Floats  # F    (lengths, 46, 5, 5)
    by_acceleration: Floats  # a    (lengths, 46, 4)
    final: Floats  # cost-to-go after the last step    (46, 5, 5)
    error_weights: ErrorWeights
    torque_weight: float  # rho    [1/(N m)^2]
    change_weight: float  # R    [1/(N m)^2]


def horizon(params: ArmParams, weights: Weights) -> Horizon:
    """Tabulate the problem for an arm."""
    plant, of_errors = params.plant(), error_weights(weights.velocity)
    arm = linear_arm(params)
    single = np.zeros((len(ANGLES), SIZE + 1, SIZE + 1))  # over one sample, of z and an acceleration, both held
    single[:, :4, :4], single[:, :4, 4], single[:, :4, 5] = arm.transition, arm.by_torque, arm.by_acceleration
    single[:, 4, 4] = single[:, 5, 5] = 1.0
    different, which = np.unique(STEPS, return_inverse=True)
    powers = np.stack([np.linalg.matrix_power(single, int(length)) for length in different])
    final = np.empty((len(ANGLES), SIZE, SIZE))
    for k, angle in enumerate(ANGLES):
        weight, errors = np.zeros((SIZE, SIZE)), np.empty((4, 4))
        write_tip_errors(float(angle), 0.0, softened_sine(float(angle)), plant, errors)
        add_tip_cost(weight, errors, of_errors)
        weight[4, 4] = weights.torque
        step = single[k, :SIZE, :SIZE]
        final[k] = solve_discrete_are(step, step[:, 4:], weight, [[weights.change]]) - weight
    return Horizon(
        plant,
        STEPS.astype(np.int64),
        which.astype(np.int64),
        np.ascontiguousarray(powers[..., :SIZE, :SIZE]),
        np.ascontiguousarray(powers[..., :4, SIZE]),
        final,
        of_errors,
        weights.torque,
        weights.change,
    )


@compiled
def _set_step(p: Problem, k: int, ahead: Horizon, start: Reference, middle: Reference, end: Reference) -> None:
    """Set dynamics and weight of step k, between two references."""
    row, weight = place(middle.angle)
    table, accelerated = ahead.transition[ahead.which[k]], ahead.by_acceleration[ahead.which[k]]
    gear = ahead.plant.gear
    m2, torque = turning_load(middle.angle, middle.speed, ahead.plant)
    for i in range(SIZE):
        for j in range(SIZE):
            p.transition[k, i, j] = between(table[row, i, j], table[row + 1, i, j], weight)
            p.weight[k, i, j] = 0.0
    for i in range(4):
        by_acceleration = between(accelerated[row, i], accelerated[row + 1, i], weight)
        p.offset[k, i] = gear * (p.transition[k, i, 0] * start.angle + p.transition[k, i, 1] * start.speed)
        p.offset[k, i] += by_acceleration * torque / m2
    p.offset[k, 0] -= gear * end.angle
    p.offset[k, 1] -= gear * end.speed
    p.offset[k, 4] = 0.0
    length, errors = float(ahead.lengths[k]), np.empty((4, 4))
    weights = ErrorWeights(length * ahead.error_weights.position, length * ahead.error_weights.velocity)
    p.weight[k, 4, 4] = length * ahead.torque_weight
    write_tip_errors(end.angle, end.speed, softened_sine(end.angle), ahead.plant, errors)
    add_tip_cost(p.weight[k], errors, weights)


@compiled
def _set_end(p: Problem, ahead: Horizon, end: Reference) -> None:
    """Set the final weight, and the torsion and torque about which it is: those of a steady motion at the reference."""
    row, weight = place(end.angle)
    for i in range(SIZE):
        for j in range(SIZE):
            p.final[i, j] = between(ahead.final[row, i, j], ahead.final[row + 1, i, j], weight)
    plant = ahead.plant
    m2, turning = turning_load(end.angle, end.speed, plant)
    load = m2 * end.acceleration + turning
    rigid = plant.gear * (end.acceleration / plant.inverse_motor_inertia + plant.viscous_friction * end.speed)
    p.target[0], p.target[1] = plant.gear * load / plant.stiffness, 0.0
    p.target[2], p.target[3] = load / plant.stiffness, 0.0
    p.target[4] = rigid + load * plant.inverse_gear


@compiled
def _set_up(p: Problem, ahead: Horizon, move: MoveShape, time: float, friction: float) -> None:
    """Set up the problem of an arm."""
    start = reference_at(TRAPEZOID, move, time)
    for k in range(len(ahead.lengths)):
        duration = ahead.lengths[k] * CONTROL_PERIOD
        middle = reference_at(TRAPEZOID, move, time + 0.5 * duration)
        opposed = friction * np.sign(middle.speed)
        p.low[k], p.high[k] = -ahead.plant.torque_limit - opposed, ahead.plant.torque_limit - opposed
        time += duration
        end = reference_at(TRAPEZOID, move, time)
        _set_step(p, k, ahead, start, middle, end)
        start = end
    _set_end(p, ahead, start)


@compiled
def plan(ahead: Horizon, move: MoveShape, time: float, state: Floats, friction: float, torques: Floats) -> None:
    """Write the net torques [N m] of all steps that minimise the cost over the horizon.

    Args:
        ahead: See `horizon`.
        move: Of the joint.
        time: Since the move's start [s].
        state: Estimated x (rad, rad/s) and net torque of the last sample [N m], shape (5,).
        friction: Coulomb friction that the motor has to overcome besides, while the reference moves [N m].
        torques: Shape (N,), written.
    """
    problem, first = empty_problem(len(ahead.lengths)), state.copy()
    _set_up(problem, ahead, move, time, friction)
    now = reference_at(TRAPEZOID, move, time)
    first[0] -= ahead.plant.gear * now.angle
    first[1] -= ahead.plant.gear * now.speed
    minimise(problem, ahead.change_weight, first, torques)


class MpcDesign(NamedTuple):
    """What the law for one arm knows."""

    observer: ObserverDesign
    ahead: Horizon
    lead: float  # T [s]
    opposing: float  # friction that the plan leaves room for [N m]
    friction: SmoothCompensation


@compiled
def _torque(design: MpcDesign, now: Sample, begins: bool, row: Floats) -> float:
    """Motor torque [N m], see `ObserverController`."""
    state = np.empty(SIZE)
    state[:4], state[4] = row[AHEAD], 0.0 if begins else now.last_command - row[ADDED]
    time, torques = CONTROL_PERIOD * now.step + design.lead, np.empty(len(design.ahead.lengths))
    plan(design.ahead, move_of(now), time, state, design.opposing, torques)
    row[ADDED] = smooth_friction(design.friction, state[1], torques[0]) - row[DISTURBANCE]
    return torques[0] + row[ADDED]


class MpcController(ObserverController):
    """Model predictive control on encoder observations."""

    gains_type = PreviewGains
    feedback_law = staticmethod(_torque)

    def _known(self) -> MpcDesign:
        p, g = self.params, self.gains
        observer, opposing = observer_design(p, g.noise()), g.friction_share * p.coulomb_friction
        return MpcDesign(observer, horizon(p, g.weights()), dead_time(p), opposing, g.compensation(p))
