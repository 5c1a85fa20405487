"""Print a SHA-256 of ten trajectories: `python tests/trajectories.py`, with nothing but the wheel installed.

The bits of an arm's motion are the same on every machine. `--check` compares with those that are written down here.
"""

import hashlib
import sys
from itertools import product

import gymnasium as gym
import numpy as np

EXPECTED = "eec0a79319656e830a9e58949b11bc3dc43ab92e0374941e9ce9f1a34e12cdec"
SETTINGS = tuple(product(("lumped", "lagrangian"), ("off", "train"), ("encoder", "accelerometer")))[:8]


def main() -> None:
    total = hashlib.sha256()
    actions = (np.arange(400) * 37 % 101 / 50 - 1).astype(np.float32)[:, None]
    for seed, (model, randomization, sensors) in enumerate(SETTINGS):
        env = gym.make("beltarm_env:BeltArm-v0", model=model, randomization=randomization, sensors=sensors)
        observation, _ = env.reset(seed=seed)
        arm = env.unwrapped
        for action in actions:
            total.update(observation.tobytes())
            observation, reward, terminated, truncated, _ = env.step(action)
            total.update(np.float64(reward).tobytes() + arm.state.tobytes())  # pyright: ignore[reportAttributeAccessIssue]
            if terminated or truncated:
                break
    arms = gym.make_vec("beltarm_env:BeltArm-v0", num_envs=2, randomization="train")
    observations, _ = arms.reset(seed=8)
    for action in actions:
        total.update(observations.tobytes())
        observations, rewards, *_ = arms.step(np.tile(action, (2, 1)))
        total.update(rewards.tobytes())
    found = total.hexdigest()
    print(found)
    if "--check" in sys.argv and found != EXPECTED:
        sys.exit(f"the trajectories are others than {EXPECTED}")


if __name__ == "__main__":
    main()
