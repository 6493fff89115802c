"""Modules shared by the training commands: options, run folders, provenance of results."""
# Import rule: modules here import no other subpackage of training.
