"""Learning algorithms: reinforcement learning with Stable-Baselines3, imitation, search for hyper-parameters."""
