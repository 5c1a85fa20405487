"""Iterative learning measured: the same moves again and again."""
