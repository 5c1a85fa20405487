"""Iterative learning over repeated moves; `eval/iterative.py` is the command."""
