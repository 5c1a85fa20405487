"""Okabe and Ito's colours, which colour-blind people can tell apart."""

from __future__ import annotations

COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9")
BLUE, ORANGE, GREEN, PINK, VERMILION, SKY = COLOURS
OF_KIND = {"classical": BLUE, "learned": ORANGE, "added": GREEN, "privileged": "0.55"}
"""Of a method of the comparison, by its kind."""
