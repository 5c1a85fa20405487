"""What the filter of `baselines.estimation.arm_ekf` is made of, and the room that it needs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from baselines.estimation.believed_arm import DELAY, DIFFERENCED, FELT_SIZE, LAG, SHORTEST, SIZE, nominal_row
from baselines.estimation.believed_motion import Simulation, simulation_room
from baselines.estimation.felt import AXES
from baselines.estimation.uncertainty import Uncertainty
from baselines.models.linear import linear_arms
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arrays import Floats


class Tracks(NamedTuple):
    """State of m filters, each of one arm, along the last axis: kernels process many of them side by side."""

    mean: Floats  # z, shape (SIZE or FELT_SIZE, m)
    covariance: Floats  # of it, shape (SIZE, SIZE, m) or (FELT_SIZE, FELT_SIZE, m)
    surprise: Floats  # w, shape (m,)
    unrest: Floats  # W of the accelerometer, shape (m,); 1 without one


class Design(NamedTuple):
    """What a filter is made of, from the nominal arm and `Uncertainty`."""

    nominal: Floats  # from `nominal_row`
    by_noise: Floats  # of x by a torque and by a torsional acceleration, at each of ANGLES, shape (46, 2, 4)
    growth: Floats  # variance that each entry gains in a sample, shape (FELT_SIZE,)
    mean: Floats  # z of an arm that begins, but for its angle, shape (SIZE or FELT_SIZE,)
    covariance: Floats  # of it, but for the angle's, shape (SIZE, SIZE) or (FELT_SIZE, FELT_SIZE)
    torque: float  # standard deviation of the process noise [N m]
    acceleration: float  # and of the torsion's [rad/s^2]
    doubtful: float  # standard deviation of the friction of a slow motor [N m]
    slow: float  # speed at which half of it is left [rad/s]
    kept: float  # share of d that is left after a sample


class Room(NamedTuple):
    """Room for `step`, for m arms; what it holds between two calls does not matter, but `felt` and `felt_variance`."""

    simulation: Simulation
    predicted: Floats  # as `simulate` writes it
    jacobian: Floats  # shape (rows, size, m) with 4 rows, or 4 + AXES with an accelerometer
    half: Floats  # its product with the covariance, shape (rows, size, m)
    noise: Floats  # shape (2, rows, m)
    row: Floats  # of the covariance, shape (size + axes, m)
    gain: Floats  # shape (size + axes, m)
    innovation: Floats  # shape (m,)
    total: Floats  # variance of it, shape (m,)
    unrest: Floats  # shape (m,)
    holds: Floats  # whether the motor does not move: 1 or 0; shape (m,)
    felt: Floats  # readings of an accelerometer from `felt.unfiltered`, shape (AXES, m); or (1, m), unused
    felt_variance: Floats  # of their noise, of the same shape


def room_for(count: int, felt: bool = False) -> Room:
    """Room for the filters of `count` arms."""
    size, axes = (FELT_SIZE, AXES) if felt else (SIZE, 0)
    simulations = 1 + DIFFERENCED + (2 + 4 if felt else 0)
    shapes = (
        *((simulations, 4 + axes), (4 + axes, size), (4 + axes, size), (2, 4 + axes), (size + axes,)),
        *((size + axes,), (), (), (), (), (max(axes, 1),), (max(axes, 1),)),
    )
    return Room(simulation_room(size), *(np.zeros((*shape, count)) for shape in shapes))


def filter_design(params: ArmParams, uncertainty: Uncertainty, felt: bool = False) -> Design:
    """Filter of arms that are nominally `params`, with an accelerometer on their ends if `felt`."""
    nominal = nominal_row(params)
    arm = linear_arms(nominal[None])
    mean = np.zeros(FELT_SIZE if felt else SIZE)
    mean[LAG] = max(params.current_loop_time_constant / CONTROL_PERIOD, SHORTEST)
    mean[DELAY] = mean[LAG] + params.command_latency / CONTROL_PERIOD
    return Design(
        nominal=nominal,
        by_noise=np.stack([arm.by_torque[0], arm.by_acceleration[0]], axis=1),
        growth=uncertainty.growth(),
        mean=mean,
        covariance=uncertainty.covariance_felt() if felt else uncertainty.covariance(),
        torque=uncertainty.torque,
        acceleration=uncertainty.acceleration,
        doubtful=params.static_friction_excess * params.coulomb_friction / 3**0.5,
        slow=params.stribeck_speed,
        kept=uncertainty.kept,
    )
