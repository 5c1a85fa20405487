"""The comparison, and what its scripts share."""
