"""Search for gains, the same for all controllers."""
