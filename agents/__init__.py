"""Learned policies: residual torques on top of a classical controller, trained with Stable-Baselines3."""
