"""
Reading a report
================

Make the numbers of a comparison yourself, for two methods on forty scenarios, and see what each
says and what it hides.
"""

# %%
# Costs of two methods
# --------------------
# ``make compare`` runs every method on the same scenarios. Here are forty single moves, of the split
# ``randomized`` of the development set, with the best classical and the best learned method. The
# main split is ``shift``, with six moves of each arm.

import numpy as np

from agents.policy.bundle import POLICIES, load_controller
from baselines import CONTROLLERS
from beltarm_env.rollout import rollout
from eval.comparison.sets import development_set

split = development_set().splits["randomized"]
scenarios = split.arguments(slice(0, 40))
adaptive = rollout(CONTROLLERS["adaptive"](), 40, **scenarios)
student = rollout(load_controller(POLICIES / "student" / "seed0"), 40, **scenarios)
print("adaptive", adaptive)
print("student ", student)

# %%
# The cost of an episode is what every method is made to lower. It differs more between arms than
# between good methods:

import matplotlib.pyplot as plt

figure, axes = plt.subplots(figsize=(7, 3.5))
order = np.argsort(adaptive.cost)
axes.plot(adaptive.cost[order], "o", ms=4, label="adaptive")
axes.plot(student.cost[order], "x", ms=5, label="student")
axes.set(xlabel="scenario, sorted by the cost of adaptive", ylabel="cost", ylim=(0, None))
axes.legend()
axes.grid(alpha=0.3)

# %%
# One number for many episodes
# ----------------------------
# Tables show the *interquartile mean*, the mean of the middle half. It is steady, and says nothing
# about the worst arms. The *mean* and the *worst 5 %* do; look at both before you believe in a
# method. The table has them in "Mean and tail".

from eval.comparison.statistics import interquartile_mean, worst_mean

for name, run in (("adaptive", adaptive), ("student", student)):
    middle, tail = interquartile_mean(run.cost), worst_mean(run.cost)
    print(f"{name:9} IQM {middle:.0f}   mean {run.cost.mean():.0f}   worst 5 % {tail:.0f}")

# %%
# Intervals
# ---------
# Other scenarios would have given other numbers. The 95 % interval, in brackets in the tables, says
# how different. It comes from drawing the forty scenarios again and again with replacement. The
# rows of a table of values are training seeds, here one.

from eval.comparison.statistics import estimate

for name, run in (("adaptive", adaptive), ("student", student)):
    value = estimate(run.cost[None, :])
    print(f"{name:9} {value.iqm:.0f} [{value.low:.0f}, {value.high:.0f}]")

# %%
# Paired differences
# ------------------
# Two intervals that overlap do not say that two methods are alike. Both ran the same scenarios, so
# they can be compared one by one, and what makes a scenario hard for both drops out. That interval
# is narrower. It decides, together with a p value; fewer than twenty scenarios decide nothing:

from eval.comparison.statistics import holm, paired

pair = paired(student.cost[None, :], adaptive.cost[None, :])
value = pair.difference
print(f"student minus adaptive: {value.iqm:.0f} [{value.low:.0f}, {value.high:.0f}]")
print(f"student costs less on {100 * pair.win_rate.iqm:.0f} % of the scenarios")
print(f"by itself: {pair.verdict}, p = {pair.p:.3f}")

# %%
# Many comparisons
# ----------------
# A report compares many pairs. Among twenty comparisons of methods that are alike, one looks
# significant by chance. Holm's correction multiplies the smallest p value by their number, the next
# by one less, and so on. A difference is *shown* if its corrected p value is below 0.05:

p_values = [pair.p, 0.02, 0.04, 0.3]  # the last three are made up
for p, corrected in zip(p_values, holm(p_values), strict=True):
    print(f"{p:.3f} becomes {corrected:.3f}")

# %%
# Not only the cost
# -----------------
# A method may be cheap and hammer the motor, or be precise and ring on. Read the cost beside the
# vibration that is left after the move, and the torques. They say something only of arms that arrive:
# one that never moves does not vibrate.

first, second = adaptive.metrics(), student.metrics()
for name in ("not_arrived_share", "residual_pp_mm", "tip_rms_mm", "torque_rate_rms", "failure_share"):
    means = first[name].mean(), second[name].mean()
    print(f"{name:17} adaptive {means[0]:6.2f}   student {means[1]:6.2f}")

# %%
# What to look at, in this order
# ------------------------------
# 1. **Which scenarios?** A result on the development set is no test result, for methods were chosen
#    on it. A quick run shows less than a full one.
# 2. **The verdict** on the main split, and on how many splits it holds.
# 3. **Mean and tail** beside the interquartile mean: do they agree?
# 4. **The other splits.** Where does the order change? That is what the winner relies on.
# 5. **Vibration, torques, time per action**: what the lower cost is paid with.
# 6. **The motions.** A picture shows at once what a number means.
#
# A full report is made by ``make compare`` in ``results/compare/report.html``; :doc:`one page
# </results/comparison/page>` has the committed one as text, and :doc:`the benchmark
# </benchmark/comparison>` the rules.
