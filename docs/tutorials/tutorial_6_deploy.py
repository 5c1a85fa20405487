"""
A controller as a program
=========================

Write a controller as C, compile it, and let it drive simulated arms over a pipe. Its torques are those of
the comparison, to the last bit.
"""

# %%
# Export
# ------
# ``eval/export.py c`` is the command. It does what follows here in single steps, with ``adaptive``, the
# best classical controller, and the guard behind it:

import tempfile
from pathlib import Path

from eval.exports.program import controller_of, loop_of, write_program

folder = Path(tempfile.mkdtemp()) / "adaptive"
loop = loop_of("adaptive", guard=True)
write_program(folder, loop)
for file in sorted(folder.iterdir()):
    print(f"{file.name:16}{file.stat().st_size / 1024:8.1f} kB")

# %%
# ``adaptive.c`` and ``adaptive.h`` are all that a drive's processor needs. They are translated from the
# kernels that Python runs. The header says how they are called:

header = (folder / "adaptive.h").read_text()
print(header[header.index("/* Set up") : header.rindex("#ifdef")])

# %%
# Software in the loop
# --------------------
# ``InTheLoop`` compiles the folder with this machine's C compiler and starts the program. It is a
# controller like any other, so ``rollout`` runs it. From each observation it takes the encoder's count
# and sends it over a pipe, and at a move's start whether the gripper holds a part; the program answers with a
# torque.

from beltarm_env.rollout import rollout
from eval.comparison.sets import development_set
from eval.exports.compilers import native
from eval.exports.in_the_loop import InTheLoop

ARMS = 4
split = development_set().splits["randomized"]
arms = split.arguments(slice(ARMS))  # their constants, moves and sensors

python = rollout(controller_of("adaptive", guard=True), ARMS, **arms)
with InTheLoop(folder, loop, split.moves[:ARMS], native(), 4000) as program:
    compiled = rollout(program, ARMS, **arms)
    times = program.times()

print("arm   cost in Python   cost in C")
for arm in range(ARMS):
    print(f"{arm:3}{python.cost[arm]:17.6f}{compiled.cost[arm]:12.6f}")
equal = (python.torque == compiled.torque).sum()
print(f"{equal} of {python.torque.size} torques are equal to the last bit")

# %%
# Not nearly equal: equal. Both sides add, multiply and round in the same order, and neither asks a maths
# library for a sine. So a test of the C code needs no tolerance, and what the comparison found holds for
# the program.
#
# Time
# ----
# The period is 1500 µs. On the processor that built this page, a sample takes

print(f"{times.median:6.0f} us (median)")
print(f"{times.longest:6.0f} us at most: a new plan, made while the arm moves")
print(f"{times.longest_reset:6.0f} us for a reset, before the move")

# %%
# A drive's processor is slower by one or two orders of magnitude. Measure there.
#
# When something breaks
# ---------------------
# The guard is in the program too. Here the encoder's cable breaks after 0.3 s: the count stays what it
# was. The same program without the guard pushes on.

import matplotlib.pyplot as plt


class Broken:
    """Controller behind an encoder that stops to count."""

    def __init__(self, controller, after):
        self.controller, self.after = controller, after
        self.params, self.profile = loop.params, "trapezoid"

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        step, own, last = (0, None, None) if state is None else state
        if step >= self.after:
            observation = last
        action, own = self.controller.predict(observation, own, episode_start)
        return action, (step + 1, own, observation.copy())


figure, (torque, angle) = plt.subplots(2, 1, figsize=(7.5, 5), sharex=True)
for guard in (False, True):
    made = folder.with_name("guarded" if guard else "bare")
    write_program(made, loop_of("adaptive", guard))
    with InTheLoop(made, loop, split.moves[:1], native(), 4000) as program:
        run = rollout(Broken(program, 200), 1, **split.arguments(slice(1)))
    name = "with the guard" if guard else "without"
    torque.plot(run.time[: len(run.torque)], 1e3 * run.torque[:, 0], label=name)
    angle.plot(run.time, run.state[:, 0, 0] / loop.params.gear_ratio, label=name)
    print(f"{name:16} cost {run.cost[0]:6.0f}")
torque.set(ylabel="torque (mN m)")
angle.set(ylabel="joint angle (rad)", xlabel="time (s)")
torque.legend()
for axes in (torque, angle):
    axes.axvline(0.3, color="0.5", lw=0.8)
    axes.grid(alpha=0.3)

# %%
# No motor can have stood still like that under such a torque. The guard lets the torque go, and friction
# stops the motor. :doc:`The guard's study </results/guard/page>` has eight faults.
#
# :doc:`From the comparison to the motor </guide/export>` goes on from here: the interrupt of a drive, what to
# check before a motor is connected, and the arm itself for other simulators.
