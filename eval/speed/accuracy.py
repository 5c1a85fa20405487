"""Accuracy of the integrator in closed loop, beside an integrator that locates every event."""

from __future__ import annotations

import gymnasium as gym
import numpy as np

import beltarm_env
from baselines import PaperController
from eval.reference.event_located import EventLocatedArm, tip
from eval.speed.timing import Row

_EPISODES = 5


def accuracy_row() -> Row:
    """Largest tip distance to the event-located reference over stick-slip moves, and their changes of mode."""
    worst, changes = 0.0, 0
    for seed in range(_EPISODES):
        env = gym.make("BeltArm-v0", randomization="train")
        arm = env.unwrapped
        assert isinstance(arm, beltarm_env.BeltArmEnv)
        observation, _ = env.reset(seed=seed)
        reference = EventLocatedArm(arm.params, arm.state)
        controller, memory = PaperController(), None
        over = False
        while not over:
            action, memory = controller.predict(observation[None], memory)
            observation, _, terminated, over, _ = env.step(action[0])
            assert not terminated
            reference.sample(float(np.clip(action[0, 0], -1, 1)) * arm.params.torque_limit)
            distance = np.linalg.norm(tip(arm.params, arm.state) - tip(reference.params, reference.state))
            worst = max(worst, float(distance))
        changes += len(reference.mode_changes)
    what = f"tip error of {_EPISODES} stick-slip episodes, {changes} mode changes"
    return Row(what, f"{1e6 * worst:.4f} um", "event-located DOP853")
