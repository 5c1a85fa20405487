"""Controllers as programs for a drive's processor, and the arm as a program for other simulators."""
