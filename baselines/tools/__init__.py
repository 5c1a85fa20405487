"""Tools of all commands: files, schemas, provenance, options, progress."""
