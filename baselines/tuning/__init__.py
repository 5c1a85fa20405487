"""The search for gains, the same for all controllers."""
