"""Parts of all training commands: options, run folders, the provenance of results."""
# Imports no other room.
