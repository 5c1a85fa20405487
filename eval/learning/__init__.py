"""Learning curves and ablations of the training."""
