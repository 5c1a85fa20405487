"""Files, provenance, command lines, and running things side by side: nothing of control."""
