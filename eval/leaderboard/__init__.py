"""Leaderboard: submissions by hash, their verification, the table of those that were verified, and the sealed set."""
