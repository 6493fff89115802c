"""Modules shared by the training commands: options, run folders, provenance of results."""
# Imports no other subpackage of training.
