"""The comparison: scenarios, methods, runs, statistics, results."""
