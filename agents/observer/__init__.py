"""Learned observer: a virtual sensor for what the encoder does not show, and for how far it can be believed."""
