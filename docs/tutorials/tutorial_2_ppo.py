"""
PPO of Stable-Baselines3, from scratch
======================================

Train an agent without any base controller, find out why the obvious way fails, and what makes it
work in a minute.
"""

# %%
# The obvious way
# ---------------
# ``BeltArm-v0`` is a Gymnasium environment, so Stable-Baselines3 takes it as it is. Ten thousand
# samples are eight episodes.

import torch
from stable_baselines3 import PPO

from beltarm_env import BeltArmVectorEnv
from beltarm_env.rollout import rollout
from beltarm_env.task.seeds import VALIDATION

torch.set_num_threads(1)
model = PPO("MlpPolicy", "BeltArm-v0", seed=0, device="cpu")
model.learn(10_000)

# %%
# A model has ``predict``, so it is a controller, and ``rollout`` runs it on many arms. These are
# the first fifty arms that validation draws from; training never sees them.

ARMS = {"seed": VALIDATION.first, "randomization": "train"}
print(rollout(model, 50, **ARMS))

# %%
# What is that worth? An agent that does nothing at all tells:

from agents.residual.bases import NoController

print(rollout(NoController(), 50, **ARMS))

# %%
# So it has learned next to nothing. Three things are in its way:
#
# - **Few arms.** Eight episodes are too few for any gradient. A batch of arms costs hardly more
#   than one, for one compiled loop steps them all.
# - **A torque every 1.5 ms.** Random torques that change so fast cancel, and the motor's friction
#   swallows what is left. An action that is held for a few samples moves the arm.
# - **The scale of the reward.** An arm far off its reference loses 20 in every sample, and a value
#   function of order 1 is easier to learn.
#
# The better way
# --------------
# ``ResidualVecEnv`` steps a batch for Stable-Baselines3, holds actions, and scales rewards. It is
# made for residuals on a base controller; with a base that does nothing, the agent learns from
# scratch.

from agents.residual.controller import ResidualController, ResidualSettings
from agents.residual.env import ResidualVecEnv

settings = ResidualSettings(limit=1.0, hold=4, knowledge="none")
arms = BeltArmVectorEnv(128, randomization="train", autoreset_mode="SameStep")
nothing = NoController()

model = PPO(
    "MlpPolicy",
    ResidualVecEnv(arms, nothing, settings, reward_scale=0.01, torque_price=5),
    n_steps=32,
    batch_size=2048,
    n_epochs=6,
    gamma=0.98,
    learning_rate=1e-3,
    policy_kwargs={"net_arch": [64, 64], "log_std_init": -1.5},
    seed=0,
    device="cpu",
)

# %%
# We train in five parts, and look at the cost on validation arms after each. ``ResidualController``
# makes a controller of the agent, which holds its actions as in training.

import numpy as np

costs = []
for _ in range(5):
    model.learn(80_000, reset_num_timesteps=False)
    agent = ResidualController(nothing, model, settings)
    run = rollout(agent, 50, **ARMS)
    costs.append(np.median(run.cost))
print(run)

# %%
import matplotlib.pyplot as plt

from baselines import PaperController

paper = rollout(PaperController(), 50, **ARMS)
figure, axes = plt.subplots(figsize=(7, 3.5))
axes.plot(80 * np.arange(1, 6), costs, "o-", label="PPO from scratch")
axes.axhline(np.median(paper.cost), color="0.5", ls="--", label="controller of 1991")
axes.set(xlabel="agent steps (thousands)", ylabel="median cost of 50 arms", yscale="log")
axes.legend()
axes.grid(alpha=0.3)

# %%
# That is one seed and a minute's work, so take nothing from it but that it learns. A whole training
# has fifteen times as many steps and five seeds, is scored on other arms, and begins with a base
# controller: :doc:`a residual agent <tutorial_3_residual>`.
#
# Into the comparison
# -------------------
# ``python train/ppo.py --base none --knowledge none`` trains from scratch, can be interrupted and
# resumed, and writes a policy bundle that the comparison takes with ``--policy``. :doc:`Training
# </science/training>` explains it.
