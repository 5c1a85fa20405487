"""Controllers over the size of each effect of the drive; `eval/drive.py` is the command."""
