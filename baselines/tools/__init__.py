"""Tools of all commands: files, provenance, command lines, progress, and tasks side by side."""
