"""Robustness maps: a challenger against a classical controller, over arms that differ in two properties at a time.

The arms are nominal but for those two properties. The moves are drawn from a seed of their own, and are the same in all
cells, so that a cell differs from its neighbour by the arm alone.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from beltarm_env import ArmParams, BeltArmVectorEnv
from beltarm_env.moves import MOVE_FIELDS
from beltarm_env.rollout import rollout
from eval.estimates import interquartile_mean
from eval.report.scenes import Map, challengers, main_split
from eval.results import Comparison, Outcome

SEED = 8_500_000  # neither trained, tuned, validated nor tested on
ARMS = 8
_STIFFNESS = [0.5, 0.65, 0.8, 1.0, 1.2]
_PAYLOAD = [0.0, 0.1, 0.2, 0.35, 0.5]
_FRICTION = [0.5, 0.75, 1.0, 1.4, 1.8]
_DELAY = [0.0, 1.0, 2.0]
Costs = Callable[[Outcome], list[list[float]]]


def robustness_maps(comparison: Comparison) -> list[Map]:
    """Stiffness by payload and friction by delay; none without a challenger and a classical controller."""
    split = main_split(comparison)
    rivals, best = challengers(comparison, split), comparison.best_classical(split)
    if not rivals or best is None:
        return []
    return [
        _map(rivals[0], best, "belt stiffness over nominal", "payload (kg)", (_STIFFNESS, _PAYLOAD), _of_plants),
        _map(rivals[0], best, "Coulomb friction over nominal", "delay (samples)", (_FRICTION, _DELAY), _of_delays),
    ]


def _map(
    rival: Outcome, best: Outcome, x_label: str, y_label: str, grid: tuple[list[float], list[float]], costs: Costs
) -> Map:
    ratio = np.array(costs(rival)) / np.array(costs(best))
    names = rival.method.name, best.method.name
    return Map(x_label, y_label, *grid, ratio.tolist(), *names, ARMS, SEED)


def _of_plants(outcome: Outcome) -> list[list[float]]:
    nominal = ArmParams()
    stiffness, payload = (values.ravel() for values in np.meshgrid(_STIFFNESS, _PAYLOAD))
    params = {"belt_stiffness": nominal.belt_stiffness * stiffness, "payload_mass": payload}
    return _cells(outcome, params, len(stiffness), 0).reshape(len(_PAYLOAD), len(_STIFFNESS)).tolist()


def _of_delays(outcome: Outcome) -> list[list[float]]:
    params = {"coulomb_friction": ArmParams().coulomb_friction * np.array(_FRICTION)}
    return [_cells(outcome, params, len(_FRICTION), int(delay)).tolist() for delay in _DELAY]


def _cells(outcome: Outcome, params: dict[str, np.ndarray], cells: int, delay: int) -> np.ndarray:
    """Interquartile mean of the cost in each cell, over its arms and all training seeds."""
    drawn = BeltArmVectorEnv(ARMS)
    drawn.reset(seed=SEED)
    move = {name: np.tile(values, cells) for name, values in zip(MOVE_FIELDS, drawn.moves.T, strict=True)}
    options = {"params": {name: np.repeat(values, ARMS) for name, values in params.items()}, "move": move}
    costs = []
    for seed in range(outcome.seeds):
        controller = outcome.method.controller(seed, [])
        run = rollout(controller, cells * ARMS, seed=SEED, options=options, delay=delay)
        costs.append(run.cost.reshape(cells, ARMS))
    return np.array([interquartile_mean(np.stack(costs)[:, cell]) for cell in range(cells)])
