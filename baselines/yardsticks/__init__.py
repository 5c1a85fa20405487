"""Yardsticks with privileged information; never ranked."""
