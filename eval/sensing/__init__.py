"""What an accelerometer on the arm's end is worth to a controller; `eval/sensors.py` is the command."""
