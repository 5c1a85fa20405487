"""Optimal plans of known moves: what they minimise, how they are found, and made anew while the arm moves."""
