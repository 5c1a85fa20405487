"""Residual action on a base controller: what the agent is told, how it acts, the task as environments."""
