"""
A servo law of your own
=======================

Write a law in one file. Compare it, read it as C, and let the C drive simulated arms: the program for a
drive's processor gives the torques that were compared, to the last bit.
"""

# %%
# The law
# -------
# ``docs/examples/my_servo.py`` is all of it. The law is a function for one arm and one sample, marked
# ``compiled``. What it knows is a named tuple, and what it remembers is a row of numbers:
#
# .. literalinclude:: ../examples/my_servo.py
#    :language: python
#    :start-at: SPEED_ERROR = 0
#
# Try it
# ------
# ``path/to/file.py:Class`` names the controller for every command. In Python, it is made like this:

from pathlib import Path

import numpy as np

import eval as commands
from baselines import CONTROLLERS
from beltarm_env.rollout import rollout
from eval.exports.program import controller_of, loop_of, write_program

FILE = Path(commands.__file__).parents[1] / "docs" / "examples" / "my_servo.py"
MINE = f"{FILE}:MyServo"

for name, controller in {"paper": CONTROLLERS["paper"](), "mine": controller_of(MINE, guard=False)}.items():
    run = rollout(controller, 50, seed=0, randomization="train")
    print(f"{name:6} median cost {np.median(run.cost):5.0f}")

# %%
# While you work on the law, ``BELTARM_ENGINE=plain`` runs it as Python, for a debugger. A law that cannot
# be translated runs in plain Python anyway, and one line says why.
#
# Compare it
# ----------
#
# .. code-block:: sh
#
#    python eval/check_controller.py docs/examples/my_servo.py:MyServo
#    python eval/compare.py --add docs/examples/my_servo.py:MyServo --methods flat \
#        --scenarios development --out results/my-law
#
# Export it
# ---------
# ``eval/export.py c docs/examples/my_servo.py:MyServo --out results/my-servo`` does what follows here:

import tempfile

folder = Path(tempfile.mkdtemp()) / "my-servo"
loop = loop_of(MINE)
write_program(folder, loop)
source = (folder / "my_servo.c").read_text()
begin = source.index("static real k_my_law")
print(source[begin : source.index("\n}", begin) + 2])

# %%
# These are the lines of the law. The arm and the gains have become numbers, for a drive has one of each.
# The sign and the sine are the project's own, since those of a maths library differ from drive to drive.
#
# Software in the loop
# --------------------
# The program is compiled, and drives simulated arms beside the controller in Python. Both have the guard
# behind them:

from eval.comparison.sets import development_set
from eval.exports.compilers import native
from eval.exports.in_the_loop import InTheLoop

ARMS = 4
split = development_set().splits["randomized"]
arms = split.arguments(slice(ARMS))  # their constants, moves and sensors
python = rollout(controller_of(MINE), ARMS, **arms)
with InTheLoop(folder, loop, split.moves[:ARMS], native(), 4000) as program:
    in_c = rollout(program, ARMS, **arms)
    times = program.times()
print(f"{(python.torque == in_c.torque).sum()} of {python.torque.size} torques are equal to the last bit")
print(f"a sample takes {times.median:.1f} us (median) of 1500")

# %%
# :doc:`From an equation to machine code </guide/engine>` says why they are equal, and what a law may be made
# of. :doc:`From the comparison to the motor </guide/export>` has what comes next: the interrupt of a drive,
# and what to check before a motor is connected.
