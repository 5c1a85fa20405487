"""Checks of the plant against independent solutions; `eval/convergence.py` and `eval/crosscheck.py` are commands."""
