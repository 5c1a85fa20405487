"""Models of the arm for control: rigid and linear models, vibration modes, planned motions, friction."""
