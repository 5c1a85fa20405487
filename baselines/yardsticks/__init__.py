"""Yardsticks that know what no controller does; never ranked."""
