"""What is in a dataset: who acts on which arms, and what it says of itself."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from baselines.tools.provenance import software
from beltarm_env.observation import LAYOUT
from beltarm_env.task.ranges import EDITION
from eval.comparison.methods import Method, methods_side_by_side
from eval.offline.disturbance import GAP, KINDS, LARGEST, MEMORY, STRETCH
from eval.offline.episodes import Episode, in_turn
from eval.offline.scores import EXPERT, reference_scores
from eval.offline.writing import About, Place, metadata_of
from eval.report.text import markdown_table

_USUAL = ("paper", "adaptive")


@dataclass(frozen=True)
class Mixture:
    """Controllers that take turns, some of their episodes disturbed."""

    methods: Mapping[str, Method]
    disturbed: float  # share of episodes
    settings: Mapping[str, Any]  # of the environment

    @staticmethod
    def of(
        controllers: Sequence[str], policies: Sequence[Path], disturbed: float, settings: Mapping[str, Any]
    ) -> Mixture:
        """Make the mixture of what was named; without any name, of `paper`, `adaptive` and the shipped student.

        Raises:
            ValueError: If a name is unknown, a controller or policy cannot be loaded, or the share is none.
        """
        if not 0 <= disturbed <= 1:
            raise ValueError(f"--disturbed must lie within 0 and 1, got {disturbed:g}")
        if not controllers and not policies:
            controllers, policies = _USUAL, (EXPERT,)
        return Mixture(dict(methods_side_by_side(controllers, policies)), disturbed, settings)

    def episodes(self, first: int, count: int, done: Callable[[int, int], object]) -> Iterator[list[Episode]]:
        """Run the controllers in turn on the arms from seed `first` on, and yield pieces.

        Args:
            first: Seed of the first episode.
            count: Number of episodes.
            done: Called with the number of episodes that have been written, and `count`.
        """
        controllers = {name: method.controller(0, []) for name, method in self.methods.items()}
        ready = 0
        for piece in in_turn(controllers, first, count, self.disturbed, **self.settings):
            yield piece
            ready += len(piece)
            done(ready, count)

    def about(self, seed: int) -> About:
        """Say what a dataset of this seed is; measures the scores that its returns are related to."""
        names = ", ".join(self.methods)
        share = f"{100 * self.disturbed:g} %"
        return About(
            settings=self.settings,
            algorithm=f"{names}; {share} of the episodes disturbed by random torques",
            description=_DESCRIPTION.format(names=names, share=share),
            scores=reference_scores(**self.settings),
            more={
                "beltarm": {
                    "edition": EDITION,
                    "layout": LAYOUT,
                    "seed": seed,
                    "controllers": {name: method.identity for name, method in self.methods.items()},
                    "disturbed": self.disturbed,
                    "noise": {"memory": MEMORY, "largest_size": LARGEST, "mean_gap": GAP, "stretch": STRETCH},
                    "software": software("gymnasium", "h5py", "minari", "numba", "numpy", "torch"),
                }
            },
        )


_DESCRIPTION = """\
Moves of a belt-driven flexible arm with friction, every one on an arm of its own. Controllers take turns: {names}. \
{share} of the episodes are disturbed by smooth random torques: half of these all along ("noise"), half in stretches \
in which the controller is not asked ("stretches"). An episode's metadata has its controller, its disturbance with the \
standard deviation noise_size, its cost, and seed and options that recreate it: env.reset(seed=seed, options=options). \
infos["not_observed"] has what no controller sees: the true state (motor angle, motor speed, torsion, its rate; rad \
and rad/s) and the error of the arm's end (m). infos["behaviour"] says how an action came about: it is \
clip(controller_action * (not alone) + noise, -1, 1). All infos have a row per observation; row k + 1 belongs to \
action k. Scores: 0 is the mean return of uniform random actions, 1 that of the shipped student."""


def table(place: Place) -> str:
    """Episodes and mean costs in a dataset, by controller and disturbance, in Markdown."""
    costs: dict[str, dict[str, list[float]]] = {}
    for told in metadata_of(place):
        costs.setdefault(told["controller"], {kind: [] for kind in KINDS})[told["disturbance"]].append(told["cost"])
    rows = [
        [name, *(f"{np.mean(found):.0f} ({len(found)})" if found else "–" for found in of_kind.values())]
        for name, of_kind in costs.items()
    ]
    return markdown_table(("mean cost (episodes)", *KINDS), rows)
