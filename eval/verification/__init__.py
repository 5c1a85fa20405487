"""Checks of the plant against independent solutions."""
