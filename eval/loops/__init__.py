"""Linear loops, costs, times and limits of every classical controller; `eval/baselines.py` is the command."""
