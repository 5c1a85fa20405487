"""Evaluation: the comparison, studies, exports, and measurements of speed."""
