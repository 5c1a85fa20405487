"""Clairvoyant optimum: the torques that minimise the environment's episode cost for the true arm.

With x_k the state of eq. (6c) at sample k and tau_k the torque held after it, the planner solves

    min  sum_k  |e_p| / 10 mm + |e_v| / 200 mm/s + 0.1 |tau_k - tau_(k-1)| / limit        (beltarm_env/task/cost.py)
    s.t. x_(k+1) = F(x_k, tau_k, d_k),   |tau_k| <= limit,   x_0 at rest at the start

as one sparse nonlinear program (direct multiple shooting; Bock and Plitt, IFAC 1984) with CasADi and IPOPT (Andersson
et al. 2019; Waechter and Biegler 2006). F is the environment's own Runge-Kutta step, traced with symbols instead of
numbers, so there is no second copy of the arm here. The caps of the cost are far from its optimum and left out.

Coulomb friction makes F depend on the mode d_k: sliding forward (+1), backward (-1), or sticking (0). Two stages:

1. Implicit smooth friction tau_c w / sqrt(w^2 + s^2) in the speed w = omega_a at the *end* of each sample, which may
   be as steep as wanted without being stiff; s is lowered from solution to solution. Its result shows where the motor
   slides and where it rests.
2. That sequence of modes is fixed and friction is exact: d_k omega_a >= 0 at both ends of a sliding sample, omega_a = 0
   and |tau_m - tau_b / G| <= tau_c at both ends of a sticking one, which is what the environment's motor does.

The norms |e| become sqrt(|e|^2 + w^2), with w lowered likewise, and |tau_k - tau_(k-1)| a slack from above. Modes
change at samples only, and a nonlinear program has local optima: the result is an attainable cost, close to the least,
rather than a proven bound. (Stopping the motor 8 samples earlier or later, or letting it slide back afterwards, changes
the cost by less than 0.3 % where that was tried.)
"""

from __future__ import annotations

from types import FunctionType, ModuleType, SimpleNamespace
from typing import Any, NamedTuple

import casadi
import numpy as np
from numpy.typing import NDArray

from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS, ArmParams
from beltarm_env.arm import Plant
from beltarm_env.arrays import Floats
from beltarm_env.physics.integrator import rk4_step
from beltarm_env.physics.kinematics import reference_tip, tip_motion
from beltarm_env.physics.models import LUMPED, driving_torque
from beltarm_env.physics.state import ArmState
from beltarm_env.physics.substeps import integration_substeps
from beltarm_env.task.cost import POSITION_SCALE, TORQUE_RATE_WEIGHT, VELOCITY_SCALE
from beltarm_env.task.reference import TRAPEZOID, MoveShape, reference_at

_UNITS = np.array([100.0, 100.0, 0.01, 0.5])  # of the states in the program, to make them of order 1
_SMOOTHING = ((10.0, 0.1), (3.0, 0.03), (1.0, 0.01))  # stage 1: of friction [rad/s], of the norms
_SHARPENING = (0.01, 0.001)  # stage 2: of the norms
_RESTING = 3.0  # a motor slower than this many widths of the smooth friction rests
_SECURE = 1e-3  # share of tau_c by which sticking keeps from breaking away
_IPOPT = {
    "print_time": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.max_iter": 500,
    "ipopt.tol": 1e-6,
    "ipopt.mu_strategy": "adaptive",
}


class Optimum(NamedTuple):
    """Solution of the planner."""

    torque: Floats  # [N m], shape (steps,)
    modes: NDArray[np.int8]  # friction mode of each sample: -1, 0, +1
    cost: float  # by the program, with smooth norms
    converged: bool  # whether IPOPT met its tolerance


def plain(function: Any, known: dict[Any, Any] | None = None) -> Any:
    """Python function behind a compiled one, and behind all that it calls, which can be traced with symbols.

    Args:
        function: A compiled function, or one of the package's modules.
        known: Functions traced already.
    """
    known = {} if known is None else known
    if function not in known:
        source = getattr(function, "py_func", function)
        if isinstance(source, ModuleType):
            known[function] = traced = SimpleNamespace()
            scope, names = vars(traced), vars(source)
        else:
            scope = dict(source.__globals__)
            known[function] = FunctionType(source.__code__, scope, source.__name__, source.__defaults__)
            names = {name: scope[name] for name in source.__code__.co_names if name in scope}
        for name, value in names.items():
            ours = isinstance(value, ModuleType) and value.__name__.startswith("beltarm_env")
            scope[name] = plain(value, known) if ours or hasattr(value, "py_func") else value
    return known[function]


class _Program:
    """Nonlinear program of one arm and move; `exact` or smooth friction.

    Unknowns are the states x_1 ... x_N (in `_UNITS`), the actions tau / limit, and the slacks above their changes.
    """

    def __init__(self, plant: Plant, tips: Floats, exact: bool) -> None:
        steps = len(tips)
        self._steps, self._exact = steps, exact
        x, actions, slack, modes = (_unknown(rows, steps) for rows in (4, 1, 1, 1))
        start, widths = _unknown(4), _unknown(2)
        before = casadi.horzcat(start, x[:, :-1])
        change = actions - casadi.horzcat(0, actions[:, :-1])
        width = casadi.repmat(widths, 1, steps)
        moved, cost = _step(plant, exact).map(steps), _tip_cost(plant).map(steps)
        constraints = [casadi.vec(moved(before, x, actions, modes, width[0, :]))]
        constraints += [casadi.vec(slack - change), casadi.vec(slack + change)]
        if exact:
            drive = _drive(plant).map(steps)
            constraints += [casadi.vec(drive(before, actions)), casadi.vec(drive(x, actions))]
        objective = casadi.sum2(cost(x, tips.T, width[1, :])) + TORQUE_RATE_WEIGHT * casadi.sum2(slack)
        problem = {
            "x": casadi.vertcat(casadi.vec(x), casadi.vec(actions), casadi.vec(slack)),
            "p": casadi.vertcat(start, casadi.vec(modes), widths),
            "f": objective,
            "g": casadi.vertcat(*constraints),
        }
        self._solver = casadi.nlpsol("clairvoyant", "ipopt", problem, _IPOPT)

    def solve(
        self, start: Floats, modes: NDArray[np.int8], widths: tuple[float, float], guess: Floats
    ) -> tuple[Floats, float]:
        """Unknowns and cost at the optimum, from a guess.

        Args:
            start: State at the beginning.
            modes: Of every sample; only exact friction has them.
            widths: Of the smooth friction [rad/s] and of the norms.
            guess: Of the unknowns.
        """
        n = self._steps
        slowest, fastest = np.full(n, -np.inf), np.full(n, np.inf)
        zeros, free = np.zeros(n), np.full(n, np.inf)
        low, high = [np.zeros(4 * n), zeros, zeros], [np.zeros(4 * n), free, free]
        if self._exact:
            following = np.append(modes[1:], modes[-1])
            slowest[(modes >= 0) | (following >= 0)] = 0.0
            fastest[(modes <= 0) | (following <= 0)] = 0.0
            held = np.where(modes == 0, 1.0 - _SECURE, np.inf)
            low, high = [*low, -held, -held], [*high, held, held]
        lowest, highest = np.full((n, 4), -np.inf), np.full((n, 4), np.inf)
        lowest[:, 1], highest[:, 1] = slowest, fastest
        found = self._solver(
            x0=guess,
            p=np.concatenate([start / _UNITS, modes, widths]),
            lbx=np.concatenate([lowest.ravel(), np.full(n, -1.0), zeros]),
            ubx=np.concatenate([highest.ravel(), np.full(n, 1.0), free]),
            lbg=np.concatenate(low),
            ubg=np.concatenate(high),
        )
        return np.asarray(found["x"])[:, 0], float(found["f"])

    def converged(self) -> bool:
        """Whether the last solution met the tolerance."""
        return bool(self._solver.stats()["success"])


def _unknown(rows: int, columns: int = 1) -> Any:
    return casadi.MX.sym("unknown", rows, columns)


def _state(scaled: Any) -> ArmState:
    return ArmState(*(float(unit) * scaled[i] for i, unit in enumerate(_UNITS)))


def _step(plant: Plant, exact: bool) -> Any:
    """Defect of a sample: the state after it minus the one that the integration leads to, in `_UNITS`."""
    x, y, action, mode, width = (casadi.SX.sym("symbol", rows) for rows in (4, 4, 1, 1, 1))
    torque = action * plant.torque_limit
    sliding, direction = plant, mode
    if not exact:
        speed = _state(y).motor_speed
        torque = torque - plant.coulomb_friction * speed / casadi.sqrt(speed * speed + width * width)
        sliding, direction = plant._replace(coulomb_friction=0.0), 1.0
    substeps = int(integration_substeps(plant, LUMPED))
    state = _state(x)
    for _ in range(substeps):
        state = plain(rk4_step)(state, torque, direction, CONTROL_PERIOD / substeps, sliding, LUMPED)
    return casadi.Function("step", [x, y, action, mode, width], [y - casadi.vertcat(*state) / _UNITS])


def _tip_cost(plant: Plant) -> Any:
    """Position and velocity terms of the cost, with smooth norms."""
    x, wanted, width = (casadi.SX.sym("symbol", rows) for rows in (4, 2, 1))
    tip = plain(tip_motion)(_state(x), plant)

    def norm(along: Any, across: Any, scale: float) -> Any:
        return casadi.sqrt((along * along + across * across) / scale**2 + width * width)

    position = norm(tip.x - wanted[0], tip.y, POSITION_SCALE)
    velocity = norm(tip.x_speed - wanted[1], tip.y_speed, VELOCITY_SCALE)
    return casadi.Function("cost", [x, wanted, width], [position + velocity])


def _drive(plant: Plant) -> Any:
    """Torque on a motor at rest over tau_c."""
    x, action = (casadi.SX.sym("symbol", rows) for rows in (4, 1))
    drive = plain(driving_torque)(_state(x), action * plant.torque_limit, plant, LUMPED) / plant.coulomb_friction
    return casadi.Function("drive", [x, action], [drive])


def optimum(params: ArmParams, move: MoveShape, steps: int = EPISODE_STEPS) -> Optimum:
    """Torques of least cost for this arm and move, over the first `steps` samples.

    Raises:
        ValueError: If the arm has no Coulomb friction, which the modes are about.
    """
    if params.coulomb_friction == 0:
        raise ValueError("coulomb_friction must be positive for the modes to mean anything, got 0: use 1e-6, say")
    plant = params.plant()
    references = [reference_at(TRAPEZOID, move, (k + 1) * CONTROL_PERIOD) for k in range(steps)]
    tips = np.array([reference_tip(r.angle, r.speed, plant) for r in references])
    rigid = np.array([[plant.gear * r.angle, plant.gear * r.speed, 0.0, 0.0] for r in references])
    start = np.array([plant.gear * move.start, 0.0, 0.0, 0.0])
    unknowns = np.concatenate([(rigid / _UNITS).ravel(), np.zeros(2 * steps)])
    modes = np.ones(steps, np.int8)
    smooth = _Program(plant, tips, exact=False)
    for widths in _SMOOTHING:
        unknowns, _ = smooth.solve(start, modes, widths, unknowns)
    modes = _modes(unknowns[1 : 4 * steps : 4] * _UNITS[1])
    exact, cost = _Program(plant, tips, exact=True), np.nan
    for width in _SHARPENING:
        unknowns, cost = exact.solve(start, modes, (0.0, width), unknowns)
    torque = np.clip(unknowns[4 * steps : 5 * steps], -1, 1) * plant.torque_limit
    return Optimum(torque, modes, cost, exact.converged())


def _modes(speeds: Floats) -> NDArray[np.int8]:
    """Mode of every sample, from the motor's speeds at their ends under smooth friction [rad/s]."""
    before = np.append(0.0, speeds[:-1])
    resting = np.maximum(np.abs(before), np.abs(speeds)) < _RESTING * _SMOOTHING[-1][0]
    return np.where(resting, 0, np.sign(before + speeds)).astype(np.int8)
