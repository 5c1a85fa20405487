"""Pictures of the arm, drawn by pygame."""
