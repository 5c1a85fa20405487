"""What identification is worth arm by arm: `adaptive` over the same controller that believes in the design model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beltarm_env.arrays import Floats
from eval.advances.study import BESIDE
from eval.loops.costs import blind, built_arms, run_arms

IDENTIFYING = BESIDE.name
"""Name of the controller that is asked about."""
WORSE = 1.2
"""Cost over that without identification from which an arm counts as worse."""


@dataclass(frozen=True)
class Worth:
    """Costs of the same arms."""

    identified: Floats  # shape (n,)
    believed: Floats  # with nothing identified

    @property
    def worse(self) -> int:
        """Number of arms that cost over `WORSE` times as much."""
        return int((self.identified > WORSE * self.believed).sum())

    @property
    def worst(self) -> float:
        """Largest ratio of one arm's costs."""
        return float(np.max(self.identified / self.believed))


def worth(identified: Floats) -> Worth:
    """Run the controller without identification on as many arms as it has run on with it, the same ones."""
    assert BESIDE.make is not None
    return Worth(identified, run_arms(blind(BESIDE.make()), built_arms(len(identified))).cost)
