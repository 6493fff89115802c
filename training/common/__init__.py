"""Shared parts of the training commands: options, run folders, provenance of results."""
# Imports no other subpackage of training.
