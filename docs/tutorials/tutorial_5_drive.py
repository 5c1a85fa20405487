"""
What the faults of a drive do
=============================

Between a command and the arm there is an amplifier, a motor with friction, and a gear. Switch their
effects on one by one, and see what each does to the arm and to two controllers.
"""

# %%
# One arm, one move, one torque
# -----------------------------
# The same torque, a short push and pull, is given to arms that differ in one constant. Their motors
# answer differently.

import matplotlib.pyplot as plt
import numpy as np

from beltarm_env import TRAIN_RANGES
from beltarm_env.rollout import rollout


class PushAndPull:
    """Push, then pull; the memory is the number of the sample."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        step = 0 if state is None else state
        torque = 0.4 * np.sin(2 * np.pi * step / 200) if step < 200 else 0.0
        return np.full((len(observation), 1), torque, np.float32), step + 1


MOVE = {"start": 0.8, "goal": 1.5, "duration": 0.8, "ramp_time": 0.12}
EFFECTS = {
    "ideal": {},
    "current loop 1 ms": {"current_loop_time_constant": 0.001},
    "latency 2.25 ms": {"command_latency": TRAIN_RANGES["command_latency"][1]},
    "breakaway +50 %": {"static_friction_excess": 0.5},
    "friction over the turn ±25 %": {"friction_variation": 0.25},
    "torque ripple 6 mN m": {"torque_ripple": 0.006},
    "kinematic error 0.3 mrad": {"kinematic_error": 0.0003},
    "stiffening belt ±25 %": {"belt_stiffening": 0.25},
}


def motion(effect):
    return rollout(PushAndPull(), 1, options={"params": effect, "move": MOVE})


ideal = motion(EFFECTS["ideal"])
figure, grid = plt.subplots(4, 2, figsize=(8, 8), sharex=True)
for axes, (name, effect) in zip(grid.flat, EFFECTS.items(), strict=True):
    run = motion(effect)
    if name == "ideal":
        axes.plot(run.time, run.state[:, 0, 1], color="0.3")
        axes.set_ylabel("motor (rad/s)")
    else:
        axes.plot(run.time, run.state[:, 0, 1] - ideal.state[:, 0, 1])
        axes.set_ylabel("change (rad/s)")
    axes.set_title(name, fontsize=10)
    axes.grid(alpha=0.3)
for axes in grid[-1]:
    axes.set_xlabel("time (s)")

# %%
# The first panel is the speed of the motor with an ideal drive, the others by how much each effect
# changes it. A lag delays the motor as long as it accelerates. Ripple and friction over the turn
# come and go with its angle. The kinematic error hardly reaches the motor at all: it moves the
# *arm*, which no encoder on the motor can tell.
#
# What it costs
# -------------
# Now under feedback, on thirty arms of the training ranges. Each has one effect at the upper end of
# its range, and the same move and constants otherwise. ``paper`` is the controller of 1991,
# ``adaptive`` the best classical one.

from baselines import CONTROLLERS


def cost(controller, effect):
    arms = {"seed": 0, "randomization": "ideal", "options": {"params": effect}}
    return np.median(rollout(controller, 30, **arms).cost)


controllers = {name: CONTROLLERS[name]() for name in ("paper", "adaptive")}
costs = {}
for name, controller in controllers.items():
    costs[name] = [cost(controller, effect) for effect in EFFECTS.values()]

print(f"{'':30}{'paper':>8}{'adaptive':>10}")
for k, effect in enumerate(EFFECTS):
    print(f"{effect:30}{costs['paper'][k]:8.0f}{costs['adaptive'][k]:10.0f}")

# %%
# As shares of the cost with an ideal drive:

figure, axes = plt.subplots(figsize=(7.5, 3.8))
place = np.arange(len(EFFECTS) - 1)
for k, (name, values) in enumerate(costs.items()):
    change = 100 * (np.array(values[1:]) / values[0] - 1)
    axes.barh(place + 0.4 * k - 0.2, change, 0.38, label=name)
axes.set_yticks(place, list(EFFECTS)[1:])
axes.invert_yaxis()
axes.axvline(0, color="0.3", lw=0.8)
axes.set_xlabel("change of the median cost (%)")
axes.legend()
axes.grid(alpha=0.3, axis="x")

# %%
# Differences of a few per cent between medians of thirty arms are chance. What stays: single
# effects cost ``adaptive`` little, because it identifies them, but for the kinematic error, which
# it cannot see. A belt that stiffens even helps ``paper``.
#
# All of them at once
# -------------------
# A drive has all effects together, and every one differently. ``randomization="train"`` draws
# them:

for name, controller in controllers.items():
    real = rollout(controller, 30, seed=0, randomization="train")
    print(f"{name:10} ideal {costs[name][0]:5.0f}   real {np.median(real.cost):5.0f}")

# %%
# :doc:`The plant </science/physics>` has the equations of each effect and where its size is from, and
# :doc:`the study </results/drive/page>` has every controller over every size.
