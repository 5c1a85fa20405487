"""Robustness maps: a challenger against every classical controller, over arms that differ in two properties at a time.

The arms are nominal but for those two properties. The moves are drawn from a seed of their own, and are the same in all
cells, so that a cell differs from its neighbour by the arm alone.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from beltarm_env import ArmParams, BeltArmVectorEnv
from beltarm_env.rollout import rollout
from beltarm_env.task.moves import MOVE_FIELDS
from beltarm_env.task.seeds import MAPS
from eval.comparison.failures import Failure, run_controller
from eval.comparison.results import Comparison, MethodOutcome
from eval.comparison.statistics import interquartile_mean
from eval.report.scenes import Map

_STIFFNESS = [0.5, 0.65, 0.8, 1.0, 1.2]
_PAYLOAD = [0.0, 0.1, 0.2, 0.35, 0.5]
_FRICTION = [0.5, 0.75, 1.0, 1.4, 1.8]
_DELAY = [0.0, 1.0, 2.0]
Floats = NDArray[np.float64]


def robustness_maps(comparison: Comparison) -> tuple[list[Map], list[Failure]]:
    """Stiffness by payload and friction by delay, of the best challenger over every classical controller, best first.

    Also what failed; there are no maps without a challenger and a classical controller.
    """
    rivals = comparison.challengers(comparison.main_split)[:1]
    found = [outcome for outcome in comparison.on(comparison.main_split) if outcome.method.kind == "classical"]
    classical = sorted(found, key=lambda outcome: outcome.estimates["cost"].iqm)
    if not rivals or not classical:
        return [], []
    costs = {o.method.name: run_controller(o.method, "maps", partial(_costs, o)) for o in [*rivals, *classical]}
    failures = [of_method for of_method in costs.values() if isinstance(of_method, Failure)]
    done = {name: of_method for name, of_method in costs.items() if not isinstance(of_method, Failure)}
    rival = rivals[0].method.name
    opponents = [name for name in done if name != rival] if rival in done else []
    return [found for name in opponents for found in _against(rival, name, done)], failures


def _against(rival: str, classical: str, costs: dict[str, tuple[Floats, Floats]]) -> list[Map]:
    """Make the maps of a pair of methods from their averages: interquartile means first, then means."""
    (plants, plant_means), (delays, delay_means) = (
        (one / other).tolist() for one, other in zip(costs[rival], costs[classical], strict=True)
    )
    names = rival, classical, MAPS.size, MAPS.first
    return [
        Map("belt stiffness over nominal", "payload (kg)", _STIFFNESS, _PAYLOAD, plants, plant_means, *names),
        Map("Coulomb friction over nominal", "delay (samples)", _FRICTION, _DELAY, delays, delay_means, *names),
    ]


def _costs(outcome: MethodOutcome) -> tuple[Floats, Floats]:
    return _of_plants(outcome), _of_delays(outcome)


def _of_plants(outcome: MethodOutcome) -> Floats:
    nominal = ArmParams()
    stiffness, payload = (values.ravel() for values in np.meshgrid(_STIFFNESS, _PAYLOAD))
    params = {"belt_stiffness": nominal.belt_stiffness * stiffness, "payload_mass": payload}
    return _cells(outcome, params, len(stiffness), 0).reshape(2, len(_PAYLOAD), len(_STIFFNESS))


def _of_delays(outcome: MethodOutcome) -> Floats:
    params = {"coulomb_friction": ArmParams().coulomb_friction * np.array(_FRICTION)}
    return np.stack([_cells(outcome, params, len(_FRICTION), int(delay)) for delay in _DELAY], axis=1)


def _cells(outcome: MethodOutcome, params: dict[str, np.ndarray], cells: int, delay: int) -> np.ndarray:
    """Interquartile mean and mean of the cost in each cell, over its arms and all training seeds, shape (2, cells)."""
    drawn = BeltArmVectorEnv(MAPS.size)
    drawn.reset(seed=MAPS.first)
    move = {name: np.tile(values, cells) for name, values in zip(MOVE_FIELDS, drawn.moves.T, strict=True)}
    columns = {name: np.repeat(values, MAPS.size) for name, values in params.items()}
    options = {"params": {**columns, "command_latency": outcome.latency}, "move": move}
    costs = []
    for seed in range(outcome.seeds):
        controller = outcome.method.controller(seed, [])
        run = rollout(controller, cells * MAPS.size, seed=MAPS.first, options=options, delay=delay)
        costs.append(run.cost.reshape(cells, MAPS.size))
    of_cells = np.stack(costs).swapaxes(0, 1)
    return np.array([[average(of_cell) for of_cell in of_cells] for average in (interquartile_mean, np.mean)])
