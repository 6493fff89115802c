"""Common parts of training commands: their options, run folders, and the provenance of results."""
