"""Exports for other programs: controllers as C, the arm as an FMU, policies for the Hugging Face Hub, datasets."""
