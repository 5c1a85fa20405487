"""What controllers know of their arm: rigid and linear models, vibration modes, planned motions, friction."""
