"""Controllers from linear-quadratic optimisation: LQG, preview, predictive, adaptive."""
