"""Modules shared by the training commands: options, run folders, provenance of results."""
