"""What the filter of `baselines.estimation.arm_ekf` is made of, and the room that it needs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from baselines.estimation.accelerometer import AXES
from baselines.estimation.believed_arm import (
    ACCELEROMETER_SIZE,
    ARMS,
    DELAY,
    DIFFERENCED,
    LAG,
    SHORTEST,
    SIZE,
    nominal_row,
)
from baselines.estimation.simulation_lanes import Simulation, simulation_room
from baselines.estimation.uncertainty import Uncertainty
from baselines.models.linear import linear_arms
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arrays import Flags, Floats
from beltarm_env.engine import compiled


class Tracks(NamedTuple):
    """State of m filters, each of one arm."""

    mean: Floats  # z, shape (m, SIZE) or (m, ACCELEROMETER_SIZE)
    covariance: Floats  # of it, shape (m, SIZE, SIZE) or (m, ACCELEROMETER_SIZE, ACCELEROMETER_SIZE)
    surprise: Floats  # w, shape (m,)
    noise_factor: Floats  # W of the accelerometer, shape (m,); 1 without one


class Inputs(NamedTuple):
    """What m arms tell in one sample."""

    angle: Floats  # measured [rad], shape (m,)
    command: Floats  # of the last sample [N m], shape (m,)
    begins: Flags  # whether an episode begins, shape (m,)
    acceleration: Floats  # of an accelerometer, see `accelerometer.unfiltered`, shape (m, AXES); or (m, 1), unused
    acceleration_variance: Floats  # of their noise, of the same shape


def inputs_of(angle: Floats, command: Floats, begins: Flags) -> Inputs:
    """What arms without accelerometers tell; arguments of shape (m,)."""
    unused = np.zeros((len(angle), 1))
    return Inputs(angle, command, begins, unused, unused)


class Design(NamedTuple):
    """What a filter is made of, from the nominal arm and `Uncertainty`."""

    nominal: Floats  # from `nominal_row`
    by_noise: Floats  # of x by a torque and by a torsional acceleration, at each of ANGLES, shape (46, 2, 4)
    growth: Floats  # variance that each entry gains in a sample, shape (ACCELEROMETER_SIZE,)
    mean: Floats  # z of an arm that begins, but for its angle, shape (SIZE or ACCELEROMETER_SIZE,)
    covariance: Floats  # of it, but for the angle's, shape (SIZE, SIZE) or (ACCELEROMETER_SIZE, ACCELEROMETER_SIZE)
    torque: float  # standard deviation of the process noise [N m]
    acceleration: float  # and of the torsion's [rad/s^2]
    doubtful: float  # standard deviation of the friction of a slow motor [N m]
    slow: float  # speed at which half of it is left [rad/s]
    decay: float  # share of d that is left after a sample


class Room(NamedTuple):
    """Room for prediction and correction; what it holds between two calls does not matter."""

    simulation: Simulation
    predicted: Floats  # as `simulate` writes it
    jacobian: Floats  # from here on of one arm, shape (rows, size) with 4 rows, or 4 + AXES with an accelerometer
    half: Floats  # its product with the covariance, shape (rows, size)
    noise: Floats  # shape (2, rows)
    row: Floats  # of the covariance, shape (size + axes,)
    gain: Floats  # shape (size + axes,)
    resolution: Floats  # of each arm's encoder [rad], shape (arms,)


def room_for(count: int, accelerometer: bool = False) -> Room:
    """Room for the filters of `count` arms, at most `ARMS`."""
    size, axes = (ACCELEROMETER_SIZE, AXES) if accelerometer else (SIZE, 0)
    simulations = 1 + DIFFERENCED + (2 + 4 if accelerometer else 0)
    shapes = (
        *((count, 4 + axes, simulations), (4 + axes, size), (4 + axes, size), (2, 4 + axes)),
        *(size + axes, size + axes, count),
    )
    return Room(simulation_room(size), *map(np.zeros, shapes))


def rooms_for(threads: int, accelerometer: bool) -> Room:
    """Room for the filters of `ARMS` arms in each of several threads, which are the first axis of all arrays."""
    room = room_for(ARMS, accelerometer)
    simulation, parts = ([np.zeros((threads, *part.shape)) for part in of] for of in (room.simulation, room[1:]))
    return Room(Simulation(*simulation), *parts)


@compiled
def room_of(rooms: Room, thread: int) -> Room:
    """Room of one thread, see `rooms_for`."""
    simulation = Simulation._make(part[thread] for part in rooms.simulation)
    return Room(simulation, *(part[thread] for part in rooms[1:]))


def filter_design(params: ArmParams, uncertainty: Uncertainty, accelerometer: bool = False) -> Design:
    """Filter of arms that are nominally `params`, with an accelerometer on their ends if `accelerometer`."""
    nominal = nominal_row(params)
    arm = linear_arms(nominal[None])
    mean = np.zeros(ACCELEROMETER_SIZE if accelerometer else SIZE)
    mean[LAG] = max(params.current_loop_time_constant / CONTROL_PERIOD, SHORTEST)
    mean[DELAY] = mean[LAG] + params.command_latency / CONTROL_PERIOD
    return Design(
        nominal=nominal,
        by_noise=np.stack([arm.by_torque[0], arm.by_acceleration[0]], axis=1),
        growth=uncertainty.growth(),
        mean=mean,
        covariance=uncertainty.accelerometer_covariance() if accelerometer else uncertainty.covariance(),
        torque=uncertainty.torque,
        acceleration=uncertainty.acceleration,
        doubtful=params.static_friction_excess * params.coulomb_friction / 3**0.5,
        slow=params.stribeck_speed,
        decay=uncertainty.decay,
    )
