"""What is asked of the arm and charged: moves, references, sensors, cost, training ranges, seeds."""
