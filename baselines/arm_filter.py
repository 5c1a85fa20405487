"""One step of an extended Kalman filter for an arm whose constants are not known, from its encoder's angle and torque.

The filter's state are x of eq. (6c) and the logarithms of six constants over their nominal values:

    inertia's swing S (with it the payload), belt stiffness K_s, motor inertia M_a1, viscous friction V_a1, Coulomb
    friction tau_c, inertia M2(0)

Its prediction is the arm itself, Coulomb friction included, simulated one control period on with the constants believed
in; its Jacobian comes from simulating it again with each of the ten moved a little. So a motor that sticks tells the
filter nothing, by itself: its simulation does not depend on torsion and constants. Process noise are a torque at the
motor, a torsional acceleration, and a slow random walk of the logarithms; the encoder's rounding to counts of q counts
as white noise of variance q^2 / 12. If the encoder moves by more than two counts while the simulation sticks, noise at
the motor lets it go. See L. Ljung: Asymptotic behavior of the extended Kalman filter as a parameter estimator, IEEE TAC
24, 1979.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.linear import at_angle, linear_arm
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
_SLIDES = 2  # counts that a motor at rest cannot move by
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

    def covariance(self, count: float) -> Floats:
        """Of the filter's state at the beginning, at rest where an encoder of counts of so many rad is; (10, 10)."""
        constants = [self.swing, self.stiffness, self.motor_inertia, self.friction, self.friction, self.inertia]
        return np.diag(np.square([count / 12**0.5, 0.0, 1e-4, 1e-4, *constants]))


class Tracks(NamedTuple):
    """What m filters believe, each of one arm."""

    state: Floats  # x, shape (m, 4)
    logs: Floats  # ln of each of IDENTIFIED over its nominal value, shape (m, 6)
    covariance: Floats  # of both, shape (m, 10, 10)
    evidence: Floats  # ln of the likelihood of all that the encoder has shown, shape (m,)

    def of(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> Tracks:
        """Some of them."""
        return Tracks(*(part[rows] for part in self))


@compiled
def _prior(predicted: Floats, covariance: Floats, by_torque: Floats, by_acceleration: Floats, prior: Floats) -> None:
    """Covariance before the measurement, into `prior`: F P F' + Q, where F is the unit matrix but for its rows of x.

    Args:
        predicted: Simulations of one arm, shape (11, 4): the first as believed, then each of the ten moved.
        covariance: P, shape (10, 10).
        by_torque: What the torque's noise does to x, its standard deviation included, shape (4,).
        by_acceleration: The same of the torsional acceleration's.
        prior: Shape (10, 10).
    """
    jacobian, half = np.empty((4, _SIZE)), np.zeros((4, _SIZE))
    for j in range(_SIZE):
        for i in range(4):
            jacobian[i, j] = (predicted[j + 1, i] - predicted[0, i]) / _MOVES[j]
    for i in range(4):
        for m in range(_SIZE):
            for j in range(_SIZE):
                half[i, j] += jacobian[i, m] * covariance[m, j]
    prior[:] = covariance
    for i in range(4):
        for j in range(4):
            prior[i, j] = by_torque[i] * by_torque[j] + by_acceleration[i] * by_acceleration[j]
            for m in range(_SIZE):
                prior[i, j] += half[i, m] * jacobian[j, m]
        for j in range(4, _SIZE):
            prior[i, j] = prior[j, i] = half[i, j]


@compiled
def _corrected(
    predicted: Floats,
    tracks: Tracks,
    measured: Floats,
    count: Floats,
    by_noise: Floats,
    noise: tuple[float, float, float],
) -> tuple[Floats, Floats, Floats, Floats]:
    """Kalman filter step from simulations of shape (m, 11, 4): the first as believed, then each of the ten moved."""
    _, logs, covariance, evidence = tracks
    state, new_logs, new_covariance = np.empty((len(predicted), 4)), logs.copy(), np.empty_like(covariance)
    new_evidence, prior = evidence.copy(), np.empty((_SIZE, _SIZE))
    for arm in range(len(predicted)):
        innovation = measured[arm] - predicted[arm, 0, 0]
        sticks = predicted[arm, 0, 1] == 0.0
        holds = sticks and abs(innovation) <= _SLIDES * count[arm]
        torque = (0.0 if holds else _LOOSE) if sticks else noise[0]
        _prior(predicted[arm], covariance[arm], torque * by_noise[arm, 0], noise[1] * by_noise[arm, 1], prior)
        for i in range(4, _SIZE):
            prior[i, i] += noise[2] * noise[2] * CONTROL_PERIOD
        rounding = count[arm] * count[arm]
        prior[0, 0] += rounding / 120  # keeps the angle open to the encoder
        total = prior[0, 0] + rounding / 12
        new_evidence[arm] -= 0.5 * (innovation * innovation / total + np.log(total))
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
    return state, new_logs, new_covariance, new_evidence


@compiled
def _moved(state: Floats, table: Floats) -> tuple[Floats, Floats]:
    """States (11 m, 4) and constants (11 m, 12) of all simulations: as believed, then with each of the ten moved."""
    states, tables = np.empty(((_SIZE + 1) * len(state), 4)), np.empty(((_SIZE + 1) * len(table), table.shape[1]))
    factors = np.exp(_MOVES)
    for arm in range(len(state)):
        first = arm * (_SIZE + 1)
        for row in range(first, first + _SIZE + 1):
            for i in range(4):
                states[row, i] = state[arm, i]
            for i in range(table.shape[1]):
                tables[row, i] = table[arm, i]
        for j in range(4):
            states[first + 1 + j, j] += _MOVES[j]
        for j in range(4, _SIZE):
            tables[first + 1 + j, _COLUMNS[j - 4]] *= factors[j]
    return states, tables


class ArmFilter:
    """Filters for arms that are nominally `params`."""

    def __init__(self, params: ArmParams, doubt: Doubt) -> None:
        self.params = params
        self.doubt = doubt
        self._nominal = params_table([params])
        arm = linear_arm(params)
        self._by_noise = np.stack([arm.by_torque[0], arm.by_acceleration[0]], axis=1)  # shape (46, 2, 4)

    def begun(self, angles: Floats, count: float) -> Tracks:
        """Filters of nominal arms at rest at these motor angles, shape (m,), read in counts of so many rad."""
        state = np.zeros((len(angles), 4))
        state[:, 0] = angles
        covariance = np.repeat(self.doubt.covariance(count)[None], len(angles), axis=0)
        return Tracks(state, np.zeros((len(angles), len(IDENTIFIED))), covariance, np.zeros(len(angles)))

    def room(self, count: int) -> ArmSimulation:
        """A simulation for up to so many filters."""
        return ArmSimulation(self.params, (_SIZE + 1) * count)

    def table(self, logs: Floats) -> Floats:
        """Constants of the arms as believed, columns as `ArmParams`, shape (m, 12)."""
        table = np.repeat(self._nominal, len(logs), axis=0)
        table[:, _COLUMNS] *= np.exp(logs)
        return table

    def stepped(
        self, tracks: Tracks, torque: Floats, measured: Floats, count: Floats, simulation: ArmSimulation
    ) -> Tracks:
        """The filters one sample on.

        Args:
            tracks: The filters.
            torque: Held over the period up to this sample [N m], shape (m,).
            measured: Motor angle [rad], shape (m,).
            count: The encoder's resolution [rad], shape (m,).
            simulation: With room for them.
        """
        predicted = self._predicted(tracks, torque, simulation)
        angle = predicted[:, 0, 0] / self.params.gear_ratio
        by_noise = at_angle(self._by_noise, angle)
        noise = self.doubt.torque, self.doubt.acceleration, self.doubt.drift
        new = Tracks(*_corrected(predicted, tracks, measured, count, by_noise, noise))
        state, logs = np.clip(new.state, -_LARGEST, _LARGEST), np.clip(new.logs, _LOWEST, _HIGHEST)
        return new._replace(state=state, logs=logs)

    def ahead(self, state: Floats, logs: Floats, torque: Floats, simulation: ArmSimulation) -> Floats:
        """States one sample on of arms as believed, under torques [N m] of shape (m,)."""
        simulation.set_table(self.table(logs))
        return simulation.advance(state, torque)

    def _predicted(self, tracks: Tracks, torque: Floats, simulation: ArmSimulation) -> Floats:
        """States one period on: as believed, and with each of the ten moved; shape (m, 11, 4)."""
        states, table = _moved(tracks.state, self.table(tracks.logs))
        simulation.set_table(table)
        torques = np.repeat(torque, _SIZE + 1)
        return simulation.advance(states, torques).reshape(len(torque), _SIZE + 1, 4)
