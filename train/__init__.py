"""Training scripts, one per algorithm."""
