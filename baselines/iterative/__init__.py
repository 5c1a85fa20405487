"""Iterative learning of one move on one arm: a track of its own, not ranked."""
