"""Servo controllers: the paper's, the same retuned, PID along shaped or smooth motions, disturbance observer."""
