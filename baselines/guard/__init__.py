"""Guard between a controller and its motor: limits, monitors, and safer torques to fall back to."""
