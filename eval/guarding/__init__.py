"""What a guard is worth where something breaks, by faults injected into the loop; `eval/faults.py` is the command."""
