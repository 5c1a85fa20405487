"""
A residual agent
================

Let a controller do what it can, and train an agent to correct its torque.
"""

# %%
# The idea
# --------
# The base controller acts at every sample. The agent adds a residual to its torque, held for four
# samples: ``action = clip(base + limit * residual)``. Untrained, it changes next to nothing, so
# that training begins where the base is. The base here is the controller of 1991.

import torch
from stable_baselines3 import PPO

from agents.residual.controller import ResidualController, ResidualSettings
from agents.residual.env import ResidualVecEnv
from agents.residual.knowledge import ENTRIES
from baselines import PaperController
from beltarm_env import BeltArmVectorEnv
from beltarm_env.rollout import rollout
from beltarm_env.task.seeds import VALIDATION

torch.set_num_threads(1)
base = PaperController()
settings = ResidualSettings(limit=1.0, hold=4, knowledge="belief")

# %%
# With ``knowledge="belief"`` the agent is also told what a Kalman filter believes about arm and
# drive, and how much of it is in doubt. These are the entries beside the environment's own:

print(*(entry.name for entry in ENTRIES["belief"]), sep="\n")

# %%
# Training
# --------
# Eighty thousand steps on 64 arms. The filter runs on every arm, and takes most of the time.

arms = BeltArmVectorEnv(64, randomization="train", autoreset_mode="SameStep")
env = ResidualVecEnv(arms, base, settings, reward_scale=0.01, torque_price=5)
model = PPO(
    "MlpPolicy",
    env,
    n_steps=32,
    batch_size=1024,
    n_epochs=10,
    gamma=0.98,
    learning_rate=1e-3,
    policy_kwargs={"net_arch": [64, 64], "log_std_init": -1.0},
    seed=0,
    device="cpu",
)
model.learn(80_000)

# %%
# What it has learned
# -------------------
# All on the same fifty arms, which training never saw: base, our agent, and the shipped agents
# after a whole training. These two correct ``adaptive``, the best classical controller.

from agents.policy.bundle import POLICIES, load_controller

ARMS = {"seed": VALIDATION.first, "randomization": "train"}
agents = {
    "base": base,
    "ours": ResidualController(base, model, settings),
    "ppo": load_controller(POLICIES / "ppo" / "seed0"),
    "student": load_controller(POLICIES / "student" / "seed0"),
}
runs = {name: rollout(agent, 50, **ARMS) for name, agent in agents.items()}
for name, run in runs.items():
    print(f"{name:8} {run}")

# %%
import matplotlib.pyplot as plt
import numpy as np

figure, (error, torque) = plt.subplots(2, 1, figsize=(7.5, 5), sharex=True)
for name in ("base", "ours", "student"):
    run = runs[name].arm(0)
    error.plot(run.time, 1e3 * np.hypot(*run.tip_error[:, 0].T), label=name)
    torque.plot(run.time, run.torque[:, 0], lw=0.8)
error.set(ylabel="error of the arm's end (mm)", title="first of the fifty arms")
torque.set(ylabel="commanded torque (N m)", xlabel="time (s)")
error.legend()
for axes in (error, torque):
    axes.grid(alpha=0.3)

# %%
# Half a minute takes most of the base's cost away. What is left is the harder part: every
# improvement of a good controller is a small torque at the right instant, and trial and error finds
# it slowly. :doc:`What makes learning work </science/learning>` says why the student has a teacher instead.
#
# In earnest
# ----------
# .. code-block:: sh
#
#    make train ARGS="--base paper"     # PPO on `paper`, saved in runs/ppo
#    make compare ARGS="--policy runs/ppo/best --scenarios development --out results/my-residual"
#    python train/student.py --seeds 5 --jobs 2     # a student on `adaptive`
