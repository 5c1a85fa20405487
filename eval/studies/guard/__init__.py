"""What a guard between controller and motor is worth while something breaks, and what it costs while nothing does.

Learned and classical controllers run with and without the guard, on arms with injected faults and on the development
set.
"""

from eval.studies.guard.measurement import QUICK, Options, measure
from eval.studies.guard.presentation import pictures, tables

__all__ = ["QUICK", "Options", "measure", "pictures", "tables"]
