"""Learned observers beside the filter: how well each sees what the encoder does not show."""
