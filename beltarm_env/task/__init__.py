"""Task given to the arm: moves, references, sensors, cost, training ranges, seeds."""
