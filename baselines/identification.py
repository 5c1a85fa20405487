"""Recursive identification of an arm from its encoder, while it moves: an extended Kalman filter.

The filter's state are x of eq. (6c) and the logarithms of six constants over their nominal values:

    inertia's swing S (with it the payload), belt stiffness K_s, motor inertia M_a1, viscous friction V_a1, Coulomb
    friction tau_c, inertia M2(0)

Its prediction is the arm itself, Coulomb friction included, simulated one control period on with the constants believed
in; its Jacobian comes from simulating it again with each of the ten moved a little. So a motor that sticks tells the
filter nothing, by itself: its simulation does not depend on torsion and constants. Process noise are a torque at the
motor, a torsional acceleration, and a slow random walk of the logarithms; the encoder's rounding counts as white noise
of variance q^2 / 12. If the encoder moves by more than two counts while the simulation sticks, noise at the motor lets
it go. See L. Ljung: Asymptotic behavior of the extended Kalman filter as a parameter estimator, IEEE TAC 24, 1979.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from baselines.linear import LinearArms, at_angle, linear_arm
from baselines.observer import QUANTUM
from baselines.reading import Reading
from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env._jit import compiled
from beltarm_env.params import FIELDS
from beltarm_env.simulation import ArmSimulation, params_table

Floats = NDArray[np.float64]

IDENTIFIED = (
    "arm_inertia_swing",
    "belt_stiffness",
    "motor_inertia",
    "motor_viscous_friction",
    "coulomb_friction",
    "arm_inertia",
)
_COLUMNS = np.array([FIELDS.index(name) for name in IDENTIFIED])
_LOWEST = np.array([-0.5, -0.4, -0.3, -0.6, -0.6, -0.4])
_HIGHEST = np.array([1.4, 0.4, 0.3, 0.6, 0.6, 0.4])
"""Bounds of the logarithms: any arm that the benchmark has, and none that the simulation could not integrate."""
_LARGEST = np.array([300.0, 2000.0, 2.0, 200.0])  # of x: keeps a belief that has lost its arm finite
_MOVES = np.array([1e-2, 1e-1, 1e-4, 1e-2, *[1e-2] * len(IDENTIFIED)])  # of the ten, for the Jacobian
_SIZE = len(_MOVES)
_SLIDES = 2 * QUANTUM
_LOOSE = 1e-2  # torque noise that lets a simulated motor go [N m]


@dataclass(frozen=True, slots=True)
class Doubt:
    """Standard deviations: of the constants before anything is known, and of what the model leaves out."""

    swing: float = 0.35  # of ln S: most of it is the payload
    stiffness: float = 0.12  # of ln K_s
    motor_inertia: float = 0.06  # of ln M_a1
    friction: float = 0.17  # of ln V_a1 and ln tau_c
    inertia: float = 0.12  # of ln M2(0)
    drift: float = 0.02  # growth of all of them [1/sqrt(s)]
    torque: float = 1e-3  # at the motor, white [N m]
    acceleration: float = 1.0  # torsional, white [rad/s^2]

    def covariance(self) -> Floats:
        """Of the filter's state at the beginning, at rest where the encoder is; shape (10, 10)."""
        constants = [self.swing, self.stiffness, self.motor_inertia, self.friction, self.friction, self.inertia]
        return np.diag(np.square([QUANTUM / 12**0.5, 0.0, 1e-4, 1e-4, *constants]))


@dataclass(frozen=True)
class Belief:
    """What the filter knows of n arms."""

    state: Floats  # x, shape (n, 4)
    logs: Floats  # ln of each of IDENTIFIED over its nominal value, shape (n, 6)
    covariance: Floats  # shape (n, 10, 10)
    simulation: ArmSimulation = field(repr=False)  # room for 11 n arms; keeps nothing from call to call


@compiled
def _corrected(
    predicted: Floats,
    logs: Floats,
    covariance: Floats,
    measured: Floats,
    by_torque: Floats,
    by_acceleration: Floats,
    noise: tuple[float, float, float],
) -> tuple[Floats, Floats, Floats]:
    """Kalman filter step from simulations of shape (n, 11, 4): the first as believed, then each of the ten moved."""
    count = len(predicted)
    state, new_logs, new_covariance = np.empty((count, 4)), logs.copy(), np.empty_like(covariance)
    for arm in range(count):
        jacobian = np.eye(_SIZE)
        for j in range(_SIZE):
            for i in range(4):
                jacobian[i, j] = (predicted[arm, j + 1, i] - predicted[arm, 0, i]) / _MOVES[j]
        innovation = measured[arm] - predicted[arm, 0, 0]
        sticks = predicted[arm, 0, 1] == 0.0
        holds = sticks and abs(innovation) <= _SLIDES
        torque = (0.0 if holds else _LOOSE) if sticks else noise[0]
        prior = np.zeros((_SIZE, _SIZE))
        half = np.zeros((_SIZE, _SIZE))
        for i in range(_SIZE):
            for j in range(_SIZE):
                for m in range(_SIZE):
                    half[i, j] += jacobian[i, m] * covariance[arm, m, j]
        for i in range(_SIZE):
            for j in range(_SIZE):
                for m in range(_SIZE):
                    prior[i, j] += half[i, m] * jacobian[j, m]
        for i in range(4):
            for j in range(4):
                prior[i, j] += torque * torque * by_torque[arm, i] * by_torque[arm, j]
                prior[i, j] += noise[1] * noise[1] * by_acceleration[arm, i] * by_acceleration[arm, j]
        for i in range(4, _SIZE):
            prior[i, i] += noise[2] * noise[2] * CONTROL_PERIOD
        prior[0, 0] += QUANTUM * QUANTUM / 120  # keeps the angle open to the encoder
        total = prior[0, 0] + QUANTUM * QUANTUM / 12
        for i in range(_SIZE):
            gain = prior[i, 0] / total
            if i < 4:
                state[arm, i] = predicted[arm, 0, i] + gain * innovation
            else:
                new_logs[arm, i - 4] += gain * innovation
            for j in range(_SIZE):
                new_covariance[arm, i, j] = prior[i, j] - gain * prior[0, j]
        if holds:
            state[arm, 1] = 0.0
    return state, new_logs, new_covariance


class ArmIdentifier:
    """The filter for arms that are nominally `params`."""

    def __init__(self, params: ArmParams, doubt: Doubt | None = None) -> None:
        self.params = params
        self.doubt = doubt or Doubt()
        self._nominal = params_table([params])
        self._linear = LinearArms(*(part[0] for part in linear_arm(params)))

    def table(self, belief: Belief) -> Floats:
        """Constants of the arms as believed, columns as `ArmParams`, shape (n, 12)."""
        table = np.repeat(self._nominal, len(belief.logs), axis=0)
        table[:, _COLUMNS] *= np.exp(belief.logs)
        return table

    def update(self, belief: Belief | None, reading: Reading, begins: NDArray[np.bool_]) -> Belief:
        """Bring the belief up to this sample.

        Args:
            belief: What the last call returned; None at the beginning.
            reading: Measurements, and the torque held since the last sample.
            begins: Which arms begin an episode, at rest where their encoder is, with nothing known; shape (n,).
        """
        count = len(begins)
        at_rest = np.zeros((count, 4))
        at_rest[:, 0] = reading.motor_angle
        unknown = np.zeros((count, len(IDENTIFIED)))
        doubt = np.repeat(self.doubt.covariance()[None], count, axis=0)
        if belief is None:
            return Belief(at_rest, unknown, doubt, ArmSimulation(self.params, (_SIZE + 1) * count))
        state, logs, covariance = self._stepped(belief, reading)
        return Belief(
            np.where(begins[:, None], at_rest, state),
            np.where(begins[:, None], unknown, logs),
            np.where(begins[:, None, None], doubt, covariance),
            belief.simulation,
        )

    def _stepped(self, belief: Belief, reading: Reading) -> tuple[Floats, Floats, Floats]:
        predicted = self._simulated(belief, reading.last_torque)
        angle = predicted[:, 0, 0] / self.params.gear_ratio
        state, logs, covariance = _corrected(
            predicted,
            belief.logs,
            belief.covariance,
            reading.motor_angle,
            at_angle(self._linear.by_torque, angle),
            at_angle(self._linear.by_acceleration, angle),
            (self.doubt.torque, self.doubt.acceleration, self.doubt.drift),
        )
        return np.clip(state, -_LARGEST, _LARGEST), np.clip(logs, _LOWEST, _HIGHEST), covariance

    def _simulated(self, belief: Belief, torque: Floats) -> Floats:
        """States one period on: as believed, and with each of the ten moved; shape (n, 11, 4)."""
        count = len(torque)
        states = np.repeat(belief.state[:, None], _SIZE + 1, axis=1)
        table = np.repeat(self.table(belief)[:, None], _SIZE + 1, axis=1)
        for j in range(4):
            states[:, j + 1, j] += _MOVES[j]
        for j, column in enumerate(_COLUMNS):
            table[:, j + 5, column] *= np.exp(_MOVES[j + 4])
        belief.simulation.set_table(table.reshape(-1, table.shape[2]))
        torques = np.repeat(torque, _SIZE + 1)
        return belief.simulation.advance(states.reshape(-1, 4), torques).reshape(count, _SIZE + 1, 4)
