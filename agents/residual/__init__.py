"""Residual action on a base controller: what the agent observes, how it acts, the task as environments."""
