"""Training runs: options, folder and checkpoints, validation, command line."""
