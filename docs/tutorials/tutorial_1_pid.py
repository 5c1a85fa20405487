"""
A PID of your own in ten minutes
================================

Write a controller, measure it on fifty arms, improve it three times, and see what a servo on the
motor cannot do.
"""

# %%
# What a controller sees
# ----------------------
# Once per sample, every 1.5 ms, a controller gets the observation: what the encoder measures, and
# what a drive is told of the move. ``decode`` turns it into physical units. Every entry is an array
# with one number per arm, because a controller drives many arms at once.

import gymnasium

from beltarm_env import CONTROL_PERIOD, ArmParams
from beltarm_env.observation import decode

env = gymnasium.make("BeltArm-v0")
observation, info = env.reset(seed=0)
for name, value in decode(observation[None]).items():
    print(f"{name:36}{value[0]:10.3f}")

# %%
# A first controller
# ------------------
# A controller is a class with a method ``predict``, called as Stable-Baselines3 calls a policy. It
# returns the torque over its limit, 0.3 N m, and what it wants to remember. This one has a
# proportional and a derivative gain, and may remember an integral. Gains are at the motor: 88 rad
# there are 1 rad at the joint.

import numpy as np

from beltarm_env.rollout import rollout

ARM = ArmParams()  # the paper's arm


class Pid:
    """PID on the motor; `known` is a function that adds what is known beforehand."""

    def __init__(self, angle, speed=0.0, integral=0.0, known=lambda now: 0.0):
        self.angle, self.speed, self.integral = angle, speed, integral
        self.known = known

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        now = decode(observation)
        total = np.zeros(len(observation)) if state is None else state
        if episode_start is not None:
            total = np.where(episode_start, 0.0, total)
        total = total + CONTROL_PERIOD * now["motor_angle_error"]
        torque = self.known(now) + self.integral * total
        torque = torque + self.angle * now["motor_angle_error"]
        torque = torque + self.speed * now["motor_speed_error"]
        share = (torque / ARM.torque_limit).clip(-1, 1)
        return share[:, None].astype(np.float32), total


# %%
# ``rollout`` runs it on fifty randomized arms, each with a move of its own. Lower cost is
# better. The controller of 1991 costs about 2000 on such arms, the best ones an eighth of that.


def measured(controller):
    return rollout(controller, 50, seed=0, randomization="train")


runs = {"P": measured(Pid(0.02))}
print(runs["P"])

# %%
# Three improvements
# ------------------
# **Friction.** The motor sticks: 32 mN m of its 300 are friction. Adding them in the direction of
# the reference is the first thing that a drive engineer would do.


def friction(now):
    return ARM.coulomb_friction * np.sign(now["reference_speed"])


runs["+ friction"] = measured(Pid(0.02, known=friction))

# %%
# **Damping**, by the error of the speed:

runs["+ D"] = measured(Pid(0.02, 0.0015, known=friction))

# %%
# **Feed-forward.** The reference's acceleration is known, and so is the inertia that the motor
# sees: its own, and that of the links behind the gear.


def feed_forward(now):
    swing = np.sin(now["reference_angle"]) ** 2
    links = ARM.arm_inertia + ARM.arm_inertia_swing * swing
    inertia = ARM.motor_inertia * ARM.gear_ratio + links / ARM.gear_ratio
    viscous = ARM.motor_viscous_friction * ARM.gear_ratio
    torque = inertia * now["reference_acceleration"] + viscous * now["reference_speed"]
    return friction(now) + torque


runs["+ feed-forward"] = measured(Pid(0.02, 0.0015, known=feed_forward))
runs["+ I, five times as stiff"] = measured(Pid(0.1, 0.004, 0.5, known=feed_forward))

for name, run in runs.items():
    vibration = np.median(run.metrics()["residual_pp_mm"])
    print(f"{name:24} cost {np.median(run.cost):5.0f}   vibration {vibration:4.1f} mm")

# %%
# What is left
# ------------
# The last step makes the servo five times as stiff, and the cost stays where it was. The picture
# says why.

import matplotlib.pyplot as plt

arm = runs["+ feed-forward"].arm(0)
figure, (error, torsion) = plt.subplots(2, 1, figsize=(7.5, 5), sharex=True)
error.plot(arm.time, 1e3 * np.hypot(*arm.tip_error[:, 0].T))
torsion.plot(arm.time, 1e3 * arm.state[:, 0, 2])
error.set(ylabel="error of the arm's end (mm)", ylim=(0, None))
torsion.set(ylabel="torsion of the belt (mrad)", xlabel="time (s)")
for axes in (error, torsion):
    axes.axvspan(0, arm.moves[0, 2], color="0.5", alpha=0.12, lw=0)
    axes.grid(alpha=0.3)

# %%
# While the shaded move lasts the motor accelerates and brakes. Both set the elastic belt ringing,
# and after the move the arm's end swings on. The encoder sits on the motor and sees next to nothing
# of it; a stiffer servo only holds the motor stiller. ``arm.plot()`` draws a picture like this one
# by itself, in a notebook too.
#
# What helps is not to excite the belt. The shipped controllers do that in different ways, with the
# same encoder:

from baselines import CONTROLLERS

for name in ("paper", "zvd", "flat", "adaptive"):
    run = measured(CONTROLLERS[name]())
    vibration = np.median(run.metrics()["residual_pp_mm"])
    print(f"{name:10} cost {np.median(run.cost):5.0f}   vibration {vibration:4.1f} mm")

# %%
# ``zvd`` shapes the reference so that vibrations cancel, ``flat`` leads the motor by the torsion
# that the move needs, and ``adaptive`` finds out which arm it has. :doc:`The methods' pages
# </benchmark/methods/index>` explain them.
#
# Into the comparison
# -------------------
# Save a class that is made without arguments in a file, check it, and compare it:
#
# .. code-block:: sh
#
#    python eval/check_controller.py mine.py:MyController
#    make compare ARGS="--add mine.py:MyController --methods adaptive --scenarios development --out results/my-pid"
#
# ``docs/examples/my_controller.py`` is such a file.
