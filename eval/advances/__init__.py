"""What each step from the paper's controller to the best classical one brings; `eval/from_1991.py` is the command."""
