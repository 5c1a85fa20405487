"""Compiled loops over blocks of arms: memory layout, motion, sensing, observation, one step of an environment."""
