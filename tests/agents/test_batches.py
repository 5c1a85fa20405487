"""Every method drives an arm the same way alone, in a batch of 24 and in one of 200, bit for bit."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from agents.policy.bundle import FELT_POLICIES, POLICIES, load_controller
from baselines import CONTROLLERS
from baselines.registry import FELT
from beltarm_env import BeltArmVectorEnv
from beltarm_env.arrays import Singles
from beltarm_env.rollout import Controller
from beltarm_env.task.seeds import VALIDATION

STEPS = 160  # of an episode: the arm sets out, and what differs by a rounding has time to grow
METHODS: dict[str, tuple[Callable[[], Controller], str]] = {
    **{name: (make, "encoder") for name, make in CONTROLLERS.items()},
    **{f"{name}, accelerometer": (make, "accelerometer") for name, make in FELT.items()},
}
for _shipped, _sensors in ((POLICIES, "encoder"), (FELT_POLICIES, "accelerometer")):
    for _folder in sorted(_shipped.glob("*/seed0")):
        METHODS[f"{_folder.parent.name} policy, {_sensors}"] = (lambda at=_folder: load_controller(at), _sensors)


def torques(make: Callable[[], Controller], sensors: Any, first: int, count: int) -> Singles:
    """Torques of `count` arms from the `first` one on, shape (STEPS, count)."""
    arms = BeltArmVectorEnv(count, randomization="train", sensors=sensors, autoreset_mode="Disabled")
    observation, _ = arms.reset(seed=VALIDATION.first + first)
    controller, memory, start, taken = make(), None, np.ones(count, np.bool_), []
    for _ in range(STEPS):
        action, memory = controller.predict(observation, memory, start)
        taken.append(action[:, 0].copy())
        observation, *_ = arms.step(action)
        start = np.zeros(count, np.bool_)
    return np.stack(taken)


@pytest.mark.parametrize("name", METHODS)
def test_an_arm_is_driven_the_same_way_alone_and_in_batches(name: str):
    make, sensors = METHODS[name]
    many = torques(make, sensors, 0, 200)
    assert np.abs(np.diff(many, axis=0)).max() > 0.01, "it moves"
    np.testing.assert_array_equal(torques(make, sensors, 0, 24), many[:, :24])
    np.testing.assert_array_equal(torques(make, sensors, 17, 1), many[:, 17:18])
