"""What the filter of `baselines.estimation.arm_ekf` is made of, and the room that it needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from baselines.estimation import believed_arm as z_at
from baselines.estimation.accelerometer import AXES
from baselines.estimation.believed_arm import Nominal, nominal_row
from baselines.estimation.believed_motion import Simulation, simulation_room
from baselines.models.linear import linear_arm_of
from baselines.reading import Reading, Sample
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.arm import COLUMN
from beltarm_env.arrays import Flags, Floats
from beltarm_env.engine import compiled, inlined
from beltarm_env.physics.models import LUMPED, Model
from beltarm_env.task.accelerometer import BIAS as ZERO_G

PART = 0.2
"""Mass that is believed of a part before it moves [kg]. Below the mean of `task.ranges.PART_MASS`: a plan for too light
a part costs less than one for too heavy a part (development arms, loaded moves: 302 at 0.2, 309 at the mean, 0.275). Of
a part that is there as an episode begins the mass of the design model is believed, 0.1 kg: single moves carry up to
0.2 kg, and what an episode is, no controller is told. To believe 0.2 kg there too makes `adaptive` 1.5 % cheaper on the
development set's `shift`, and 13 % dearer on its `randomized`."""
_ARM_DOUBT = 0.55  # of ln S without a part, over `Uncertainty.swing`, with which it was tuned
_FRICTION = z_at.LOGS.start + z_at.IDENTIFIED.index("motor_viscous_friction")  # the Coulomb friction follows
_PART_DOUBT = 0.75  # [kg] of a part's mass, likewise: 0.225 kg; 0.16 kg costs the same


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """Standard deviations: of the constants before anything is measured, their drift, and the process noise."""

    swing: float = 0.3  # of ln S with a part in the gripper, when an episode begins: most of it is the part
    stiffness: float = 0.3  # of ln K_s
    motor_inertia: float = 0.06  # of ln M_a1
    friction: float = 0.2  # of ln V_a1 and ln tau_c
    inertia: float = 0.12  # of ln M2(0)
    torque_constant: float = 0.06  # of ln(1 + k), which all of these have in common
    delay: float = 0.5  # of D [samples]
    lag: float = 0.2  # of T_i [samples]
    variation: float = 0.1  # of p and q
    excess: float = 0.14  # of s
    stiffening: float = 0.1  # of b
    giving: float = 1.0  # of g
    ripple: float = 1e-3  # of s_n and c_n [N m]
    drift: float = 0.01  # growth of all but the ripple's [1/sqrt(s)]
    friction_drift: float = 0.06  # further growth of ln V_a1 and ln tau_c, which drift [1/sqrt(s)]
    torque: float = 3e-3  # at the motor, white [N m]
    sticking: float = 4.0  # that of a motor that sticks and gives, over that of one that slides
    acceleration: float = 1.0  # torsional, white [rad/s^2]
    disturbance: float = 5e-4  # of d [N m]
    memory: float = 0.02  # time in which d decays [s]
    kinematic_error: float = 1.2e-4  # of e_s and e_c [rad]

    def covariance(self) -> Floats:
        """Initial covariance of z, (ACCELEROMETER_SIZE,) * 2, at rest; without that of the angle, the encoder's."""
        constants = [self.swing, self.stiffness, self.motor_inertia, self.friction, self.friction, self.inertia]
        drive = [self.delay, self.lag, self.variation, self.variation, self.excess, self.stiffening, self.giving]
        ripple = [self.ripple] * (2 * len(z_at.ORDERS))
        accelerometer = [self.kinematic_error] * 2 + [ZERO_G / 3**0.5] * AXES
        deviations = [0.0, 0.0, 1e-4, 1e-4, *constants, *drive, self.disturbance, *ripple, *accelerometer]
        result = np.diag(np.square(deviations))
        result[z_at.LOGS, z_at.LOGS] += self.torque_constant**2
        return result

    @property
    def decay(self) -> float:
        """Share of d that is left after a sample."""
        return float(np.exp(-CONTROL_PERIOD / self.memory))

    def growth(self) -> Floats:
        """Variance that each entry of z gains in a sample, but for x: shape (ACCELEROMETER_SIZE,)."""
        result = np.zeros(z_at.ACCELEROMETER_SIZE)
        result[z_at.LOGS.start : z_at.DISTURBANCE] = self.drift**2 * CONTROL_PERIOD
        result[_FRICTION : _FRICTION + 2] += self.friction_drift**2 * CONTROL_PERIOD
        result[z_at.DISTURBANCE] = (1 - self.decay**2) * self.disturbance**2
        return result


class Tracks(NamedTuple):
    """State of m filters, each of one arm."""

    mean: Floats  # z, shape (m, SIZE) or (m, ACCELEROMETER_SIZE + AXES): the last are room for predicted readings
    covariance: Floats  # of it, shape (m, SIZE, SIZE), or as wide as the mean
    surprise: Floats  # w, shape (m,)
    noise_factor: Floats  # W of the accelerometer, shape (m,); 1 without one
    holds: Flags  # whether the gripper holds a part, shape (m,)
    without_part: Floats  # mean and variance of ln S when it last held none, shape (m, 2)


class Inputs(NamedTuple):
    """What m arms tell in one sample."""

    angle: Floats  # measured [rad], shape (m,)
    command: Floats  # of the last sample [N m], shape (m,)
    begins: Flags  # whether an episode begins, shape (m,)
    moves: Flags  # whether a move begins, shape (m,)
    holds: Flags  # whether the gripper holds a part, shape (m,)
    acceleration: Floats  # of an accelerometer, see `accelerometer.unfiltered`, shape (m, AXES); or (m, 1), unused
    acceleration_variance: Floats  # of their noise, of the same shape


def inputs_of(reading: Reading, begins: Flags) -> Inputs:
    """What n arms tell beside their accelerometers, and which of them begin an episode, shape (n,)."""
    unused = np.zeros((len(begins), 1))
    moves, holds = reading.step == 0, reading.holds_part > 0.5
    return Inputs(reading.motor_angle, reading.last_command, begins, moves, holds, unused, unused)


def empty_inputs() -> Inputs:
    """Room for what one arm tells."""
    number, flag, unused = np.zeros(1), np.zeros(1, np.bool_), np.zeros((1, 1))
    return Inputs(number, number.copy(), flag, flag.copy(), flag.copy(), unused, unused.copy())


@inlined
def write_inputs(now: Sample, begins: bool, inputs: Inputs) -> None:
    """Write what one arm tells, and whether it begins an episode."""
    inputs.angle[0], inputs.command[0] = now.motor_angle, now.last_command
    inputs.begins[0], inputs.moves[0], inputs.holds[0] = begins, now.step == 0, now.holds_part > 0.5


class Design(NamedTuple):
    """What a filter is made of, from the nominal arm and `Uncertainty`."""

    nominal: Nominal  # arm believed in before anything is measured
    by_noise: Floats  # of x by a torque and by a torsional acceleration, at each of ANGLES, shape (46, 2, 4)
    growth: Floats  # variance that each entry gains in a sample, shape (ACCELEROMETER_SIZE,)
    mean: Floats  # z of an arm that begins, but for its angle, shape (SIZE or ACCELEROMETER_SIZE,)
    covariance: Floats  # of it, but for the angle's, shape (SIZE, SIZE) or (ACCELEROMETER_SIZE, ACCELEROMETER_SIZE)
    torque: float  # standard deviation of the process noise [N m]
    sticking: float  # that of a motor that sticks and gives, over it
    acceleration: float  # and of the torsion's [rad/s^2]
    doubtful: float  # standard deviation of the friction of a slow motor [N m]
    slow: float  # speed at which half of it is left [rad/s]
    decay: float  # share of d that is left after a sample
    arm_swing: float  # mean of ln S without a part before anything is measured
    arm_variance: float  # of it
    part: float  # what a part adds to S, over the nominal S: mean
    part_deviation: float  # and standard deviation


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


def room_for(count: int, accelerometer: bool = False, threads: tuple[int, ...] = ()) -> Room:
    """Room for the filters of `count` arms, at most `ARMS`; of several threads, as the first axis of all arrays."""
    size, axes = (z_at.ACCELEROMETER_SIZE, AXES) if accelerometer else (z_at.SIZE, 0)
    simulations = 1 + z_at.DIFFERENCED + (2 + 4 if accelerometer else 0)
    shapes: tuple[tuple[int, ...], ...] = (
        *((count, 4 + axes, simulations), (4 + axes, size), (4 + axes, size), (2, 4 + axes)),
        *((size + axes,), (size + axes,), (count,)),
    )
    return Room(simulation_room(size, threads), *(np.zeros(threads + shape) for shape in shapes))


@compiled
def room_of(rooms: Room, thread: int) -> Room:
    """Room of one thread, see `room_for`."""
    simulation = Simulation._make(part[thread] for part in rooms.simulation)
    return Room(simulation, *(part[thread] for part in rooms[1:]))


def _require_identifiable(params: ArmParams) -> None:
    """Refuse, by ValueError, constants that no measurement would correct, or that a filter would cut."""
    for name, most in zip(z_at.IDENTIFIED, np.exp(z_at.HIGHEST[z_at.LOGS]), strict=True):
        if getattr(params, name) == 0 and name != "coulomb_friction":  # without which a motor is taken never to stick
            raise ValueError(
                f"{name} must be positive where the arm is identified, got 0: tell a guess, for what is found is at "
                f"most {most:.2g} times as much"
            )
    longest, least_log = z_at.HIGHEST[z_at.LAG] * CONTROL_PERIOD, z_at.LOWEST[z_at.LOGS.start]
    heaviest = params.arm_inertia_swing * (np.exp(-least_log) - 1) / (4 * params.link_length**2)
    for name, most, unit in (
        ("current_loop_time_constant", longest, " s"),
        ("belt_stiffening", z_at.STIFFEST, ""),
        ("payload_mass", heaviest, " kg"),  # else ln S would be cut where the gripper holds nothing
    ):
        if getattr(params, name) > most:
            raise ValueError(
                f"{name} must be at most {most:.4g}{unit} where the arm is identified, got {getattr(params, name)!r}: "
                "take a controller that does not identify its arm, such as preview"
            )


def filter_design(
    params: ArmParams, uncertainty: Uncertainty, accelerometer: bool = False, model: Model = LUMPED
) -> Design:
    """Filter of arms that are nominally `params`, with an accelerometer on their ends if `accelerometer`.

    `model` is whose equations of motion it takes them to obey.

    Raises:
        ValueError: If a constant is beyond what the filter can correct.
    """
    _require_identifiable(params)
    nominal = nominal_row(params)
    arm = linear_arm_of(nominal, model)
    size = z_at.ACCELEROMETER_SIZE if accelerometer else z_at.SIZE
    mean = np.zeros(size)
    mean[z_at.LAG] = max(params.current_loop_time_constant / CONTROL_PERIOD, z_at.SHORTEST)
    mean[z_at.DELAY] = mean[z_at.LAG] + params.command_latency / CONTROL_PERIOD
    swing, per_mass = float(nominal[COLUMN.arm_inertia_swing]), 4 * params.link_length**2
    return Design(
        nominal=Nominal(nominal, model),
        by_noise=np.stack([arm.by_torque, arm.by_acceleration], axis=1),
        growth=uncertainty.growth(),
        mean=mean,
        covariance=uncertainty.covariance()[:size, :size].copy(),
        torque=uncertainty.torque,
        sticking=uncertainty.sticking,
        acceleration=uncertainty.acceleration,
        doubtful=params.static_friction_excess * params.coulomb_friction / 3**0.5,
        slow=params.stribeck_speed,
        decay=uncertainty.decay,
        arm_swing=float(np.log(params.arm_inertia_swing / swing)),
        arm_variance=(_ARM_DOUBT * uncertainty.swing) ** 2 + uncertainty.torque_constant**2,
        part=per_mass * PART / swing,
        part_deviation=per_mass * _PART_DOUBT * uncertainty.swing / swing,
    )
