"""A siege of the project: every part attacks one promise, counts its attacks and tells what it found."""
