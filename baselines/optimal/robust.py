"""Robust LQ: the gain that costs least over the corners of the training ranges, with an observer that errs on them.

The law is that of `baselines.optimal.lqg`, along the same smoothed move and with the same observer:

    tau_m = tau_flat + v - d + tau_f,    v = -K(theta_1,ref) [x - x_flat; v_last]

There, K is best for the design model whose state is known. Here, at each joint angle, one K is best for the arms that
may come instead, with the state as the observer of the *design model* has it, which is wrong on all of them but one. It
minimises the mean over the corners c of `baselines.models.corners` of

    J_c(K) = E |e_p / 10 mm|^2 + w_v |e_v / 200 mm/s|^2 + rho v^2 + R (tau - tau_last)^2

in the loop of arm c behind its own drive: with s = [arm and drive; estimate; d; v; tau_last; rounding; unknown torque],

    s+ = A_c(K) s + w,    w ~ (0, W_c),    X = A X A' + W,    Y = A'Y A + Q,    J_c = tr(Q X),    dJ_c/dA = 2 Y A X

where w is the process noise that the filter counts on, the encoder's rounding, the growth of a torque that nobody knows
and that is forgotten after 0.3 s, and steps of the motor's angle, as of one that friction stops, which the observer
sees. A is linear in K, and J is descended from the gain of LQG
(L-BFGS) until its slope is zero: where a descent gives up before that depends on how a processor rounds. A loop that is
unstable on one arm costs infinitely much, so K holds all of them at once. The late corners count a second time with one
sample more of latency, which is the delay that tuned loops have to bear. Where the design has changed, `write_gains()`
writes `robust.json` anew.

Levine and Athans 1970 (gains for a state that is not all measured, by two Lyapunov equations); Ackermann 1980 and Ly,
Bryson and Cannon 1985 (one gain for several arms). H-infinity synthesis would bound what is unknown by discs around the
response; here it is a handful of constants with known ranges, and the corners say more.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize, root

from baselines.estimation.observer import QUANTUM, Noise, kalman_gains, with_disturbance
from baselines.gains import tunable, tuned
from baselines.models.corners import CORNERS, LOOP_FIELDS
from baselines.models.linear import ANGLES, dead_time, linear_arm
from baselines.optimal.lqg import LqgController, LqgGains, feedback_gains
from baselines.planning.plan import Weights
from baselines.planning.tip_error import add_tip_cost, bounded_sine, error_weights, write_tip_errors
from baselines.tools.files import read_text, write_text
from beltarm_env import CONTROL_PERIOD, ArmParams, sampled_state_space
from beltarm_env.arrays import Floats
from beltarm_env.task.ranges import design_model
from beltarm_env.timing import LATENCY_SAMPLES

FILE = Path(__file__).with_name("robust.json")
"""Gains for the tuned weights: to find them takes longer than all else that a controller needs at its start."""
_PLACES = list(range(0, len(ANGLES), 5))  # of `ANGLES`, at which gains are found; between them they are interpolated
_FORGOTTEN = 0.3  # [s]  time constant of the unknown torque
_DOUBLINGS = 40  # of the time that a Lyapunov sum covers: 2^40 samples, unless it has converged before
_CONVERGED, _DIVERGED = 1e-15, 1e30
_TRIES, _BEYOND = 10, 1e-3  # to stabilise all loops; distance of the largest pole to 1 after A was shrunk
_FLAT = 1e-12  # slope of J where a descent ends, over J


@dataclass(frozen=True)
class RobustGains(LqgGains):
    """Gains as of LQG, and how far off its place the motor comes to stand."""

    first_spread: float = tunable(0.2, 0.02, 2.0, log=True)  # [periods]  of the first corner
    spread: float = tunable(0.7, 0.02, 4.0, log=True)  # [periods]  of the others
    torque_weight: float = tunable(100.0, 1e-2, 1e4, log=True)  # rho     [1/(N m)^2]
    change_weight: float = tunable(200.0, 1e-2, 1e5, log=True)  # R     [1/(N m)^2]
    torque_noise: float = tunable(0.01, 1e-4, 0.1, log=True)  # [N m]      process noise at the motor
    acceleration_noise: float = tunable(2.0, 0.01, 300.0, log=True)  # [rad/s^2]  process noise of the torsion
    rest_width: float = tunable(0.08, 0.0001, 0.3, log=True)  # [N m]     torque that decides it while the motor rests
    angle_noise: float = tunable(0.1, 0.001, 10.0, log=True)  # sigma_0  [rad/sqrt(s)]  of the motor's angle


class Loops(NamedTuple):
    """Loops of m arms with one observer, but for K: s+ = A s + b v+, v+ = -K F s, with n states of a loop."""

    transition: Floats  # A, shape (m, n, n)
    fed_back: Floats  # F: [x when the command acts, as estimated; v], shape (m, 5, n)
    noise: Floats  # W, shape (m, n, n)
    cost: Floats  # Q, shape (n, n)
    push: int  # row of v


def arms_around(params: ArmParams) -> list[ArmParams]:
    """Arms as far from `params` as the corners are from the middle of the training ranges.

    Raises:
        ValueError: If one is no arm.
    """
    middle, latest = design_model(), LATENCY_SAMPLES * CONTROL_PERIOD
    arms = []
    for corner in CORNERS.values():
        moved = {name: getattr(params, name) + getattr(corner, name) - getattr(middle, name) for name in LOOP_FIELDS}
        moved |= {name: max(0.0, value) for name, value in moved.items() if name != "torque_constant_error"}
        late = moved["command_latency"] + CONTROL_PERIOD
        try:
            arms.append(replace(params, **moved | {"command_latency": min(moved["command_latency"], latest)}))
        except ValueError as error:
            words = f"a corner of the training ranges, moved to params, is no arm: {error}"
            raise ValueError(f"{words}: take a controller that has no corners, such as lqg") from error
        if corner.command_latency > middle.command_latency:
            arms.append(replace(arms[-1], command_latency=min(late, latest)))
    return arms


def loops_at(params: ArmParams, k: int, weights: Weights, noise: Noise, stopped: float) -> Loops:
    """Loops of `arms_around` a design model at `ANGLES[k]` with the observer of the design model."""
    angle, arms = float(ANGLES[k]), arms_around(params)
    model, by_command, _ = sampled_state_space(params, angle)
    sampled = [sampled_state_space(arm, angle)[:2] for arm in arms]
    first = max(len(a) for a, _ in sampled)  # states of arm and drive; then come those of the estimate
    size = first + len(model) + 5
    estimate, (d, v, last, rounding, unknown) = slice(first, size - 5), range(size - 5, size)
    transition, spectra = np.zeros((len(arms), size, size)), np.zeros((len(arms), size, size))
    for matrix, spectrum, arm, (a, b) in zip(transition, spectra, arms, sampled, strict=True):
        own, linear = len(a), linear_arm(arm).at(k)
        matrix[:own, :own], matrix[:own, v], matrix[:own, d] = a, b[:, 0], -b[:, 0]
        matrix[:4, unknown] = linear.by_torque
        _, covariance = with_disturbance(linear, noise.torque, noise.acceleration, 1.0)
        spectrum[:4, :4] = covariance[:4, :4]
    spectra[:, rounding, rounding] = QUANTUM**2 / 12
    for row, column in product((0, first), repeat=2):  # the arm is elsewhere, and the estimate follows
        spectra[:, row, column] += stopped**2 * CONTROL_PERIOD
    spectra[:, unknown, unknown] = noise.disturbance**2 * CONTROL_PERIOD
    transition[:, unknown, unknown] = 1 - CONTROL_PERIOD / _FORGOTTEN
    transition[:, last, v], transition[:, last, d] = 1.0, -1.0
    # The observer: [estimate; d]+ = its prediction under the torque tau_last + d = v, and L times the innovation.
    filter_gain = kalman_gains(params, noise)[k]
    innovation = transition[:, 0].copy()
    innovation[:, rounding] += 1.0
    innovation[:, estimate] -= model[0]
    innovation[:, v] -= by_command[0, 0]
    transition[:, estimate, estimate], transition[:, estimate, v], transition[:, d, d] = model, by_command[:, 0], 1.0
    transition[:, first : first + 4] += filter_gain[:4, None] * innovation[:, None]
    transition[:, d] += filter_gain[4] * innovation
    return Loops(
        transition,
        _fed_back(transition, estimate, model, by_command[:, 0], dead_time(params) / CONTROL_PERIOD),
        spectra,
        _cost(params, angle, weights, size),
        v,
    )


def _fed_back(transition: Floats, estimate: slice, model: Floats, by_command: Floats, delay: float) -> Floats:
    """F: the estimate, predicted over a delay [samples] under the torque that is held, and v."""
    count, size = transition.shape[:2]
    d, v = size - 5, size - 4
    held = transition[:, d].copy()  # tau_last + d, with d as corrected
    held[:, d] -= 1.0
    held[:, v] += 1.0
    ahead = transition[:, estimate].copy()
    whole, rest = divmod(delay, 1.0)
    for share in (*[1.0] * int(whole), rest):
        ahead += share * (model @ ahead + by_command[:, None] * held[:, None] - ahead)
    fed_back = np.zeros((count, 5, size))
    fed_back[:, :4], fed_back[:, 4, v] = ahead[:, :4], 1.0
    return fed_back


def _cost(params: ArmParams, angle: float, weights: Weights, size: int) -> Floats:
    """Q: of the tip's errors, of v, and of the torque's change, with tau = v - d."""
    d, v, last = size - 5, size - 4, size - 3
    cost, change, errors = np.zeros((size, size)), np.zeros(size), np.empty((4, 4))
    write_tip_errors(angle, 0.0, bounded_sine(angle), params.plant(), errors)
    add_tip_cost(cost, errors, error_weights(weights.velocity))
    change[[v, d, last]] = 1.0, -1.0, -1.0
    cost += weights.change * np.outer(change, change)
    cost[v, v] += weights.torque
    return cost


def lyapunov(a: Floats, w: Floats) -> Floats | None:
    """Solution X of X = A X A' + W, by doubling; None if it does not exist. Leading axes are of several equations."""
    x, power = w, a
    for _ in range(_DOUBLINGS):
        step = power @ x @ power.swapaxes(-1, -2)
        x = x + step
        more, all_of_it = (np.diagonal(matrix, axis1=-2, axis2=-1) for matrix in (step, x))
        if np.all(more <= _CONVERGED * all_of_it):  # of each state by itself: they differ by many orders
            return x
        if not more.max() < _DIVERGED:
            break
        power = power @ power
    return None


def mean_cost(gain: Floats, loops: Loops, shrunk: float = 1.0) -> tuple[float, Floats]:
    """Mean of J over the arms and its slope in K, shape (5,); infinite where a loop is unstable.

    Args:
        gain: K, shape (5,).
        loops: Of the arms.
        shrunk: What A is multiplied by: a loop with poles up to 1 / `shrunk` is then stable.
    """
    a = shrunk * closed(gain, loops)
    x = lyapunov(a, loops.noise)
    y = None if x is None else lyapunov(a.swapaxes(-1, -2), loops.cost)
    if x is None or y is None:
        return np.inf, np.zeros(5)
    of_push = 2 * shrunk * (y[:, loops.push, None] @ a @ x)[:, 0]
    slope = -(loops.fed_back @ of_push[:, :, None])[:, :, 0].mean(axis=0)
    return float((loops.cost * x).sum() / len(a)), slope


def closed(gain: Floats, loops: Loops) -> Floats:
    """A of the loops with a gain K of shape (5,), shape (m, n, n)."""
    a = loops.transition.copy()
    a[:, loops.push] = -gain @ loops.fed_back
    return a


def least_cost_gain(start: Floats, loops: Loops) -> Floats:
    """Gain K that costs least over the arms of some loops, shape (5,), by descent from another.

    Where that one leaves loops unstable, their A is shrunk until they are not, J is descended, and A shrunk less.

    Raises:
        ValueError: If no gain is found that holds all arms.
    """
    gain, scale = start, np.abs(start)
    for _ in range(_TRIES):
        radius = float(np.abs(np.linalg.eigvals(closed(gain, loops))).max())
        if radius < 1:
            return _descended(gain, scale, loops, 1.0)
        gain = _descended(gain, scale, loops, 1 / (radius + _BEYOND))
    raise ValueError("no gain found that holds all corners: give the observer less noise of the torsion")


def _descended(start: Floats, scale: Floats, loops: Loops, shrunk: float) -> Floats:
    first, _ = mean_cost(start, loops, shrunk)

    def relative(change: Floats) -> tuple[float, Floats]:
        cost, slope = mean_cost(start + scale * change, loops, shrunk)
        return (cost / first, scale * slope / first) if np.isfinite(cost) else (1e3, np.zeros(5))

    near = minimize(relative, np.zeros(5), jac=True, method="L-BFGS-B").x
    least = root(lambda change: relative(change)[1], near, tol=_FLAT)
    holds = np.isfinite(mean_cost(start + scale * least.x, loops, shrunk)[0])  # else the slope is none, and zero
    return start + scale * (least.x if least.success and holds else near)


class Design(NamedTuple):
    """All that the gains depend on."""

    params: ArmParams  # the design model
    weights: Weights
    noise: Noise
    stopped: float  # see `loops_at`

    def content(self) -> dict[str, Any]:
        """Return the same as JSON holds it, with the corners and the angles at which gains are found."""
        parts = {"params": asdict(self.params), "weights": self.weights._asdict(), "noise": self.noise._asdict()}
        corners = [[getattr(corner, name) for name in LOOP_FIELDS] for corner in CORNERS.values()]
        parts |= {"stopped": self.stopped, "forgotten": _FORGOTTEN, "corners": corners}
        return {**parts, "angles": ANGLES[_PLACES].tolist()}

    def gains(self) -> Floats:
        """Find the gains at these angles, shape (places, 5)."""
        start = feedback_gains(self.params, LqgGains().weights())
        return np.array([least_cost_gain(start[k], loops_at(self.params, k, *self[1:])) for k in _PLACES])


@lru_cache(maxsize=64)
def robust_gains(design: Design) -> Floats:
    """Gains K on [x - x_ref; v_last] at each of `ANGLES`, shape (46, 5): those of `FILE` if they are of this design."""
    stored = json.loads(read_text(FILE))
    found = np.array(stored["gains"]) if stored["design"] == design.content() else design.gains()
    return np.column_stack([np.interp(ANGLES, ANGLES[_PLACES], column) for column in found.T])


def write_gains(path: Path = FILE) -> None:
    """Find the gains with the tuned weights and write them, with all that they are found for."""
    design = RobustController(tuned("robust", RobustGains)).design
    content = {"design": design.content(), "gains": design.gains().tolist()}
    write_text(path, json.dumps(content, indent=1) + "\n")


class RobustController(LqgController):
    """Flatness feed-forward and robust LQ on encoder observations; the corners lie about the design model."""

    gains_type = RobustGains

    @property
    def design(self) -> Design:
        """What its feedback gains are found for."""
        return Design(self.params, self.gains.weights(), self.gains.noise(), self.gains.angle_noise)

    def feedback(self) -> Floats:
        """Gains K at each of `ANGLES`, shape (46, 5)."""
        return robust_gains(self.design)
