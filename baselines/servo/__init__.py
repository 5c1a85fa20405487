"""Servo controllers: the paper's, its retuned form, PID along shaped or smooth motions, disturbance observer."""
