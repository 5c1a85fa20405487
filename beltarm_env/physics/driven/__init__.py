"""Integration behind a drive as it is built: torque within a step, the step, and its events."""
