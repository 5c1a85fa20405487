"""Fit a learned observer: `python train/observer.py`.

An observer is a virtual sensor. From what an agent sees, it estimates torsion, the tip's errors and the constants of
the arm, and how far off each estimate may be (`agents/observer/network.py` has the equations). It is fitted to episodes
of several controllers on arms of the training ranges. They are simulated first (`agents/observer/run.py`); after
an interruption, the same command continues with the episodes that it has.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import run_command, stop_without

try:
    from agents.observer.run import ObserverConfig, run
except ModuleNotFoundError as error:
    stop_without("train/observer.py", error)

if __name__ == "__main__":
    run_command(__file__, ObserverConfig, run, __doc__)
