"""What `eval/baselines.py` shows of every classical controller: linear loops, costs, times, and where it breaks."""
