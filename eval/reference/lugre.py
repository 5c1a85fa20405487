"""The lumped arm behind its drive with LuGre friction, as the engine of an `ArmBatch`.

A bristle of deflection z takes the place of the friction that is located as events; with omega the motor's speed:

    dz/dt = omega - sigma_0 |omega| z / g(omega)
    tau_f = sigma_0 z + sigma_1(omega) dz/dt                                    beside V omega, which stays as it is
    g(omega) = level (1 + s / (1 + (omega / omega_s)^2))                        the located friction while sliding

so that both have the same steady sliding and breakaway torque. `level` is tau_c with its variation over the turn and
its drift. The motor breaks away once it has turned by g(0) / sigma_0, the *deflection*, which this engine is made with.

Damping is sigma_1(omega) = sigma_1 / (1 + sigma_1 |omega| / (4 g)), at rest half of the stuck motor's critical one.
With a constant one the model can create energy: with sigma_0 z^2 / 2 stored in the bristle, what friction takes is

    tau_f omega - sigma_0 z dz/dt = sigma_0^2 |omega| z^2 / g + sigma_1 (dz/dt)^2 + sigma_0 sigma_1 |omega| z dz/dt / g

which is never negative if sigma_1 <= 4 g / |omega|.

Model: C. Canudas de Wit, H. Olsson, K. J. Astrom, P. Lischinsky, A New Model for Control of Systems with Friction, IEEE
Transactions on Automatic Control 40(3), 1995.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beltarm_env.arm import COLUMN
from beltarm_env.arrays import Floats, Integers
from beltarm_env.batch import ArmBatch
from beltarm_env.engine import compiled, inlined
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.layout import LANES, load_drive, load_plant, load_state, store_state
from beltarm_env.physics import lumped
from beltarm_env.physics.drive import angles_of, coupling
from beltarm_env.physics.models import LUMPED, Arm
from beltarm_env.physics.state import ArmState
from beltarm_env.physics.step import moved, weighted
from beltarm_env.physics.trigonometry import exponential
from beltarm_env.timing import CONTROL_PERIOD, LATENCY_SAMPLES

STEPS = 60
"""Least number of steps per control period."""
SHARE_OF_CRITICAL = 0.5
_LARGEST_STEP = 1.5  # over the bristle's time constant; RK4 is stable up to 2.78


class Bristle(NamedTuple):
    """Constants of an arm's bristle."""

    stiffness: float  # sigma_0 [N m/rad]
    damping: float  # sigma_1 at rest [N m s/rad]
    level: float  # friction of the fast motor now, without its variation over the turn [N m]


@inlined
def _relaxation(x: ArmState, bristle: Bristle, arm: Arm) -> tuple[float, float]:
    """Return g [N m] and the rate at which the bristle follows the speed, sigma_0 |omega| / g [1/s]."""
    g = bristle.level * coupling(x, angles_of(x, arm.plant, arm.drive), arm.plant, arm.drive).friction
    return g, bristle.stiffness * abs(x.motor_speed) / g


@inlined
def _slope(x: ArmState, z: float, torque: float, bristle: Bristle, arm: Arm) -> tuple[ArmState, float]:
    plant, drive, _ = arm
    g, rate = _relaxation(x, bristle, arm)
    z_dot = x.motor_speed - rate * z
    damping = bristle.damping / (1 + 0.25 * bristle.damping * abs(x.motor_speed) / g)
    net = torque - bristle.stiffness * z - damping * z_dot
    # The plant has no Coulomb friction of its own here, so the direction in which it slides does not matter.
    motor, torsional, _ = lumped.accelerations(x, angles_of(x, plant, drive), net, 1.0, plant, drive)
    return ArmState(x.motor_speed, motor, x.torsion_speed, torsional), z_dot


@inlined
def _rk4_step(
    x: ArmState, z: float, torques: tuple[float, float, float], dt: float, bristle: Bristle, arm: Arm
) -> tuple[ArmState, float]:
    """Take a classical Runge-Kutta step, with the motor's torque at its beginning, middle and end."""
    first, middle, last = torques
    k1, z1 = _slope(x, z, first, bristle, arm)
    k2, z2 = _slope(moved(x, 0.5 * dt, k1), z + 0.5 * dt * z1, middle, bristle, arm)
    k3, z3 = _slope(moved(x, 0.5 * dt, k2), z + 0.5 * dt * z2, middle, bristle, arm)
    k4, z4 = _slope(moved(x, dt, k3), z + dt * z3, last, bristle, arm)
    return moved(x, dt / 6, weighted(k1, k2, k3, k4)), z + dt / 6 * (z1 + 2 * (z2 + z3) + z4)


@compiled
def advance_bristles(
    blocks: Floats, bristles: Floats, constants: Floats, actions: Floats, sample: NDArray[np.int64], least: int
) -> None:
    """Move all arms by one control period, in place.

    Args:
        blocks: The arms, as `layout` describes.
        bristles: z [rad], shape (N,); in place.
        constants: sigma_0 [N m/rad] and sigma_1 at rest [N m s/rad], shape (2, N).
        actions: Torques commanded, over their limits, shape (N,).
        sample: Samples since the episodes' start, shape (N,); in place.
        least: Steps per control period, or more where the bristle is quick.
    """
    for arm in range(len(actions)):
        block, j = blocks[arm // LANES], arm % LANES
        for k in range(LATENCY_SAMPLES, 0, -1):
            block[(at.TARGETS + k) * LANES + j] = block[(at.TARGETS + k - 1) * LANES + j]
        block[at.TARGETS * LANES + j] = actions[arm] * load_plant(block, j).torque_limit * block[at.GAIN * LANES + j]
        worn = 1 + block[at.DRIFT * LANES + j] * (sample[arm] + 0.5)
        block[(at.PLANT + 2) * LANES + j] = block[at.VISCOUS * LANES + j] * worn
        block[(at.PLANT + 3) * LANES + j] = 0.0
        bristle = Bristle(constants[0, arm], constants[1, arm], block[at.COULOMB * LANES + j] * worn)
        moving = Arm(load_plant(block, j), load_drive(block, j), LUMPED)
        x, z = load_state(block, at.STATE, j), bristles[arm]
        late, split = int(block[at.LATE * LANES + j]), block[at.SPLIT * LANES + j]
        lag = block[at.LAG_RATE * LANES + j]
        torque = block[at.TORQUE * LANES + j]
        for piece in range(2):
            remaining = split if piece == 0 else CONTROL_PERIOD - split
            target = block[(at.TARGETS + late + 1 - piece) * LANES + j]
            while remaining > 0.0:
                _, rate = _relaxation(x, bristle, moving)
                longest = min(CONTROL_PERIOD / least, _LARGEST_STEP / max(rate, 1e-9))
                count = math.ceil(remaining / longest - 1e-9)
                dt = remaining / count if count > 1 else remaining
                half = exponential(-0.5 * lag * dt) if lag > 0.0 else 0.0
                torque = torque if lag > 0.0 else target
                middle, last = target + (torque - target) * half, target + (torque - target) * half * half
                x, z = _rk4_step(x, z, (torque, middle, last), dt, bristle, moving)
                torque = last
                remaining = remaining - dt if count > 1 else 0.0
        store_state(block, at.STATE, j, x)
        block[at.TORQUE * LANES + j] = torque
        bristles[arm] = z
        sample[arm] += 1


class LuGreArms:
    """Engine that moves the arms of a batch with LuGre friction.

    Args:
        batch: The arms, of the lumped model; to become its `engine`.
        deflection: Angle of the motor at which it breaks away, of the mean friction at the episode's start [rad].
        steps: Least number of steps per control period.
    """

    def __init__(self, batch: ArmBatch, deflection: float, steps: int = STEPS) -> None:
        self._blocks = batch.blocks
        self._num_arms, self._deflection, self._steps = batch.num_arms, deflection, steps
        self._bristles, self._constants = np.zeros(batch.num_arms), np.zeros((2, batch.num_arms))
        self._sample = np.zeros(batch.num_arms, np.int64)

    def check(self, table: Floats) -> None:
        """Take all arms."""

    def begin(self, arms: Integers, table: Floats, states: Floats | None) -> None:
        """Begin new episodes for arms with parameters (n, fields), without deflection; without states further moves."""
        if states is not None:
            self._bristles[arms] = 0.0
        breakaway = table[:, COLUMN.coulomb_friction] * (1 + table[:, COLUMN.static_friction_excess])
        stiffness = breakaway / self._deflection
        self._constants[0, arms], self._sample[arms] = stiffness, 0
        self._constants[1, arms] = SHARE_OF_CRITICAL * 2 * np.sqrt(stiffness * table[:, COLUMN.motor_inertia])

    def advance(self, actions: Floats) -> Floats:
        """Hold torques over their limits, shape (num_arms,), for one control period; states, shape (num_arms, 4)."""
        advance_bristles(self._blocks, self._bristles, self._constants, actions, self._sample, self._steps)
        return at.rows(self._blocks, at.STATE, 4, self._num_arms)

    def torques(self) -> Floats:
        """Torques of the motors now [N m], shape (num_arms,)."""
        return at.rows(self._blocks, at.TORQUE, 1, self._num_arms)[:, 0]
