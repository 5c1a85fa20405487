"""Laws as kernels for one arm: the torques of the controllers, bit for bit, whatever was in their memory before."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from baselines.optimal.felt import FeltPreviewController
from baselines.optimal.lqg import LqgController
from baselines.optimal.preview import PreviewController
from baselines.optimal.robust import RobustController
from baselines.reading import read, sample_of
from beltarm_env import ArmParams, BeltArmVectorEnv, design_model
from beltarm_env.task.seeds import VALIDATION

STEPS = 120


def arrays_of(memory: Any) -> Iterator[Any]:
    """Arrays in a memory of named tuples."""
    for part in memory:
        yield from arrays_of(part) if isinstance(part, tuple) else (part,)


@pytest.mark.parametrize("params", [design_model(), ArmParams()], ids=["design model", "ideal drive"])
@pytest.mark.parametrize("make", [PreviewController, LqgController, RobustController])
def test_a_law_for_one_arm_is_the_controller(make: Any, params: ArmParams):
    controller = make(params=params)
    law, design, memory = controller.kernel()
    for part in arrays_of(memory):
        part[:] = np.nan
    env = BeltArmVectorEnv(3, randomization="train", autoreset_mode="Disabled")
    for episode in range(2):
        observation, _ = env.reset(seed=VALIDATION.first + 3 * episode)
        begins, batch = np.ones(3, np.bool_), None
        for _ in range(STEPS):
            reading = read(observation, controller.params)
            torques, batch = controller.law(reading, begins, batch)
            assert law(design, sample_of(reading, 1), bool(begins[1]), memory) == torques[1]
            action = np.clip(torques / controller.params.torque_limit, -1, 1)
            observation, *_ = env.step(action.astype(np.float32)[:, None])
            begins = np.zeros(3, np.bool_)


def test_a_law_that_feels_is_none_for_one_arm():
    with pytest.raises(TypeError, match="reads the encoder alone: take the kernel of PreviewController"):
        FeltPreviewController().kernel()
