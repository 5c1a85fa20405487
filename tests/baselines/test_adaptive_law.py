"""Law of `adaptive` for one arm, as a kernel."""

from typing import Any

import numpy as np
import pytest

from baselines import CONTROLLERS
from baselines.optimal.adaptive_law import begun, renewed, torque
from baselines.reading import read, sample_of
from baselines.registry import FELT
from beltarm_env import EPISODE_STEPS, BeltArmVectorEnv
from beltarm_env.rollout import rollout

SEED = 5_000_000


def spoilt(memory: Any) -> Any:
    """Memory in which nothing is of any use."""
    for part in memory:
        if isinstance(part, tuple):
            spoilt(part)
        else:
            part[...] = True if part.dtype == np.bool_ else np.nan
    return memory


@pytest.mark.slow  # the same law is in every program of `adaptive` and `student`, which `test_export` runs
@pytest.mark.parametrize("apart", [False, True])
def test_one_arm_alone_is_bit_for_bit_as_in_a_batch(apart: bool):
    controller = CONTROLLERS["adaptive"]()
    law, design, memory = controller.kernel()
    spoilt(memory)
    env = BeltArmVectorEnv(1, autoreset_mode="Disabled", randomization="train")
    limit = controller.params.torque_limit
    for seed in (SEED, SEED + 1):
        together = rollout(CONTROLLERS["adaptive"](), 2, seed=seed, randomization="train").torque[:, 0] / limit
        observations, _ = env.reset(seed=seed)
        for k in range(EPISODE_STEPS):
            now = sample_of(read(observations, controller.params), 0)
            if apart:
                begun(design, now, k == 0, memory)
                found = torque(design, now, memory)
                renewed(design, now, memory)
            else:
                found = law(design, now, k == 0, memory)
            action = np.float32(min(max(found / limit, -1.0), 1.0))
            assert action == np.float32(together[k]), k
            observations, *_ = env.step(np.full((1, 1), action))


def test_an_accelerometer_is_refused():
    with pytest.raises(TypeError, match="encoder alone"):
        FELT["adaptive"]().kernel()
